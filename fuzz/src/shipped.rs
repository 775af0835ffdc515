//! Shipped devices and scenes for the requests, read once.

use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_host::device_file::DeviceFile;
use haptic_host::scene_file::SceneFile;
use std::sync::OnceLock;

/// A device with scenes for it.
pub struct ShippedDevice {
    pub device: Device<f32>,
    pub scenes: Vec<Scene<f32>>,
}

macro_rules! shipped {
    ($($device:literal: $($scene:literal)*;)*) => {
        [$(ShippedDevice::read(
            include_str!(concat!("../../devices/", $device, ".toml")),
            &[$(include_str!(concat!("../../devices/scenes/", $device, "/", $scene, ".toml"))),*],
        )),*]
    };
}

/// Returns devices with one, two and three joints, serial and parallel.
pub fn shipped_devices() -> &'static [ShippedDevice; 5] {
    static SHIPPED: OnceLock<[ShippedDevice; 5]> = OnceLock::new();
    SHIPPED.get_or_init(|| {
        shipped! {
            "hapkit-paddle": "wall" "detent";
            "coupled-five-bar": "wall" "wall-full";
            "haply-2diy": "disc" "groove" "wall-stiff";
            "phantom-premium-1.5": "edge" "table";
            "serial-3r": "wall";
        }
    })
}

impl ShippedDevice {
    fn read(device: &str, scenes: &[&str]) -> Self {
        let file = DeviceFile::parse(device, "device.toml").expect("a valid device");
        let scene = |text: &&str| {
            let file = SceneFile::parse(text, "scene.toml", file.spec().task).expect("a valid scene");
            file.scene().expect("a valid scene")
        };
        Self {
            device: Device::new(&file.name, &file.description).expect("a valid device"),
            scenes: scenes.iter().map(scene).collect(),
        }
    }
}
