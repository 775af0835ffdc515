//! Force of the motors at the tip in random scenes; the deep part `lies` runs more scenes.

use crate::common::forces::too_hard;

#[test]
fn no_shipped_device_pushes_harder_than_its_limit() {
    let wrong = too_hard(0..3);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
