//! Force of the motors at the tip in random scenes; the deep part `lies` runs more scenes.

use crate::common::forces::runs_beyond_limit;

#[test]
fn no_shipped_device_pushes_harder_than_its_limit() {
    let failed_runs = runs_beyond_limit(0..3);
    assert!(failed_runs.is_empty(), "{}", failed_runs.join("\n"));
}
