//! What the motors really push with at the tip: `deep` draws more of it.

use crate::common::all_shipped;
use crate::common::forces::largest;
use haptic_bridge::safety::limits::GENTLE_FORCE;

#[test]
fn no_shipped_device_pushes_harder_than_its_limit_allows_whatever_scene_and_hand() {
    let count = std::env::var("HAPTIC_SEQUENCES").ok().and_then(|text| text.parse().ok()).unwrap_or(3);
    let mut wrong = Vec::new();
    for file in all_shipped() {
        for seed in 0..count {
            let (most, what) = largest(&file, seed);
            if most > 1.1 * f64::from(GENTLE_FORCE) {
                wrong.push(what);
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
