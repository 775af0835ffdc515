//! A device is the same in either precision: rounded from double it is what the board lumps from the file.

use haptic::device_file::DeviceFile;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::device::Device;
use std::path::Path;

#[test]
fn a_device_that_is_rounded_is_the_one_that_is_made_in_single_precision() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../devices");
    let mut seen = Vec::new();
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|end| end != "toml") {
            continue;
        }
        let file = DeviceFile::load(&path).unwrap();
        let (wide, single): (Device<f64>, Device<f32>) = (file.device().unwrap(), file.device().unwrap());
        assert_eq!(wide.cast::<f32>(), single, "{}", path.display());
        assert_eq!(single.cast::<f64>().cast::<f32>(), single, "{}", path.display());
        assert_eq!(wide.cast::<f64>(), wide, "{}", path.display());
        assert_ne!(single.cast::<f64>(), wide, "{}: it tells nothing", path.display());
        seen.push(wide.mechanism.kind());
    }
    assert!(Kind::ALL.iter().all(|kind| seen.contains(kind)), "{seen:?}");
}
