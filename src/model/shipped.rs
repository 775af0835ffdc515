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
/// A redundant arm.
pub const SERIAL_3R: &str = include_str!("../../devices/serial-3r.toml");
