//! What the motors really push with at the tip: the deep part `lies` draws more of it.

use crate::common::forces::too_hard;

#[test]
fn no_shipped_device_pushes_harder_than_its_limit_allows_whatever_scene_and_hand() {
    let wrong = too_hard(0..3);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
