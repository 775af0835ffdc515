//! The text of the shipped device and scene files that crates of this workspace use. A published crate can include only
//! files of its own package, so the texts are here.

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
/// A redundant arm.
pub const SERIAL_3R: &str = include_str!("../../devices/serial-3r.toml");
/// A five-bar (Campion, Wang and Hayward 2005).
pub const PANTOGRAPH_MK2: &str = include_str!("../../devices/pantograph-mk2.toml");
/// An open parallelogram arm on a turret.
pub const WOODENHAPTICS: &str = include_str!("../../devices/woodenhaptics.toml");

/// A disc in front of the Haply 2DIY.
pub const DISC: &str = include_str!("../../devices/scenes/haply-2diy/disc.toml");
/// A groove in front of the Haply 2DIY.
pub const GROOVE: &str = include_str!("../../devices/scenes/haply-2diy/groove.toml");
/// A corner in front of the Pantograph Mk-II.
pub const CORNER: &str = include_str!("../../devices/scenes/pantograph-mk2/corner.toml");
/// A wall in front of the Hapkit.
pub const PADDLE_WALL: &str = include_str!("../../devices/scenes/hapkit-paddle/wall.toml");
/// A wall in front of the Hapkit, at a control rate of 1 kHz.
pub const PADDLE_WALL_1_KHZ: &str = include_str!("../../devices/scenes/hapkit-paddle/slow.toml");
