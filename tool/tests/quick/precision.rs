//! A device is the same in either precision: rounded from double it is what the board lumps from the file.

use crate::common::all_shipped;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::device::Device;

#[test]
fn a_device_that_is_rounded_is_the_one_that_is_made_in_single_precision() {
    let mut seen = Vec::new();
    for file in all_shipped() {
        let (wide, single): (Device<f64>, Device<f32>) = (file.device().unwrap(), file.device().unwrap());
        assert_eq!(wide.cast::<f32>(), single, "{}", file.name);
        assert_eq!(single.cast::<f64>().cast::<f32>(), single, "{}", file.name);
        assert_eq!(wide.cast::<f64>(), wide, "{}", file.name);
        assert_ne!(single.cast::<f64>(), wide, "{}: it tells nothing", file.name);
        seen.push(wide.mechanism.kind());
    }
    assert!(Kind::ALL.iter().all(|kind| seen.contains(kind)), "{seen:?}");
}
