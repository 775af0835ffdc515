//! The board this image is for. One file per board, one Cargo feature each; a board offers
//!
//! - `NAME`, `AXES`, and what its power stage is like,
//! - `off()`: bridges off by plain register writes, callable from anywhere, even a fault handler,
//! - `Io`: what the control interrupt owns (encoders, conversions, duties),
//! - `Gate`: what tasks own (raising the gate drivers or the enable line, checking them),
//! - `split()`: the chip's peripherals divided among these and the tasks.

#[cfg(all(feature = "odrive-v3", feature = "h-bridge-f405"))]
compile_error!("choose one board: `odrive-v3` or `h-bridge-f405`, not both");
#[cfg(not(any(feature = "odrive-v3", feature = "h-bridge-f405")))]
compile_error!("choose a board: `--features odrive-v3` or `--features h-bridge-f405`");

#[cfg(all(feature = "h-bridge-f405", not(feature = "odrive-v3")))]
mod h_bridge_f405;
#[cfg(all(feature = "h-bridge-f405", not(feature = "odrive-v3")))]
pub use h_bridge_f405::*;

#[cfg(feature = "odrive-v3")]
mod odrive_v3;
#[cfg(feature = "odrive-v3")]
pub use odrive_v3::*;

use embassy_stm32::Peri;
use embassy_stm32::peripherals::{FLASH, IWDG, PA11, PA12, USB_OTG_FS};

/// Readings of one crest.
#[derive(Clone, Copy)]
pub struct Analog {
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Current of each axis, A, positive for positive duty.
    pub current_a: [f32; AXES],
    /// Whether the conversions came.
    pub fresh: bool,
}

/// What every board hands to its tasks.
pub struct Common {
    /// The USB device and its two pins.
    pub usb: (Peri<'static, USB_OTG_FS>, Peri<'static, PA12>, Peri<'static, PA11>),
    /// Flash, for the settings.
    pub flash: Peri<'static, FLASH>,
    /// The watchdog.
    pub watchdog: Peri<'static, IWDG>,
}

/// What can go wrong while the gate drivers are set up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum GateError {
    /// The transfer itself failed.
    Bus,
    /// A control register did not read back as written: no driver there, or no supply.
    Readback,
    /// The driver reports a fault; the status registers as read.
    Fault(u16, u16),
}
