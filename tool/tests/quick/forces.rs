//! Force of the motors at the tip in random scenes; the deep part `lies` runs more scenes.

use crate::common::forces::runs_beyond_limit;

#[test]
fn no_shipped_device_pushes_harder_than_its_limit() {
    let wrong = runs_beyond_limit(0..3);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
