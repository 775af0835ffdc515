//! The shipped device files, as text for `haptic-host`.

/// A five-bar with strong coupling: the device of the demo and of a simulated board.
pub const COUPLED_FIVE_BAR: &str = include_str!("../../devices/coupled-five-bar.toml");
/// A paddle with one joint.
pub const HAPKIT_PADDLE: &str = include_str!("../../devices/hapkit-paddle.toml");
/// A five-bar in a plane.
pub const HAPLY_2DIY: &str = include_str!("../../devices/haply-2diy.toml");
/// A five-bar on a turret.
pub const FICTIVE_FIVE_BAR_TURRET: &str = include_str!("../../devices/fictive-five-bar-turret.toml");
/// A parallelogram arm on a turret.
pub const PHANTOM_PREMIUM: &str = include_str!("../../devices/phantom-premium-1.5.toml");
/// A delta.
pub const FALCON_LIKE: &str = include_str!("../../devices/falcon-like.toml");
/// A redundant arm.
pub const SERIAL_3R: &str = include_str!("../../devices/serial-3r.toml");

/// A shipped device in front of the walls of a scene.
#[derive(Clone, Copy, Debug)]
pub struct ShippedWorld {
    /// Name of the device, with the name of the scene after a slash, and a description after a colon.
    pub name: &'static str,
    /// Text of the device file.
    pub device: &'static str,
    /// Name and text of the scene file; `None` for one wall in front of the tip.
    pub scene: Option<(&'static str, &'static str)>,
}

macro_rules! shipped {
    ($device:literal: $words:literal) => {
        ShippedWorld {
            name: concat!($device, ": ", $words),
            device: include_str!(concat!("../../devices/", $device, ".toml")),
            scene: None,
        }
    };
    ($device:literal / $scene:literal: $words:literal) => {
        ShippedWorld {
            name: concat!($device, "/", $scene, ": ", $words),
            scene: Some(($scene, include_str!(concat!("../../devices/scenes/", $device, "/", $scene, ".toml")))),
            ..shipped!($device: $words)
        }
    };
}

/// The devices that a page offers beside the demo's.
pub const WORLDS: [ShippedWorld; 7] = [
    shipped!("haply-2diy" / "disc": "a disc"),
    shipped!("haply-2diy" / "groove": "a groove"),
    shipped!("pantograph-mk2" / "corner": "a corner"),
    shipped!("hapkit-paddle" / "wall": "a wall"),
    shipped!("hapkit-paddle" / "slow": "a wall at 1 kHz"),
    shipped!("woodenhaptics": "a wall"),
    shipped!("phantom-premium-1.5": "a wall"),
];
