//! A device computed in double precision and rounded equals the device computed in single precision.

use crate::common::all_shipped_devices;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::device::Device;

#[test]
fn a_rounded_device_equals_one_made_in_single_precision() {
    let mut kinds = Vec::new();
    for file in all_shipped_devices() {
        let (wide, single): (Device<f64>, Device<f32>) = (file.device().unwrap(), file.device().unwrap());
        assert_eq!(wide.cast::<f32>(), single, "{}", file.name);
        assert_eq!(single.cast::<f64>().cast::<f32>(), single, "{}", file.name);
        assert_eq!(wide.cast::<f64>(), wide, "{}", file.name);
        assert_ne!(single.cast::<f64>(), wide, "{}: rounding changes nothing, so the test has no effect", file.name);
        kinds.push(wide.mechanism.kind());
    }
    let names: Vec<&str> = kinds.iter().map(|kind| kind.spec().name).collect();
    assert!(Kind::ALL.iter().all(|kind| names.contains(&kind.spec().name)), "{names:?}");
}
