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

use core::sync::atomic::{AtomicU16, Ordering};

use embassy_stm32::Peri;
use embassy_stm32::peripherals::{FLASH, IWDG, PA11, PA12, USB_OTG_FS};
use embassy_time::{Duration, block_for};
use haptic_bridge::model::catalogue::MAX_JOINTS;

use crate::{adc, servo};

/// Readings of one crest.
#[derive(Clone, Copy)]
pub struct Analog {
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Current of each axis, A, positive for positive duty.
    pub current_a: [f32; MAX_JOINTS],
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

/// What can go wrong while the power stage is readied.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
#[cfg_attr(
    not(feature = "odrive-v3"),
    expect(dead_code, reason = "a board without gate drivers has fewer ways to fail")
)]
pub enum GateError {
    /// The transfer itself failed.
    Bus,
    /// A control register did not read back as written: no driver there, or no supply.
    Readback,
    /// The driver reports a fault; its status registers.
    Fault(u16, u16),
    /// The current sensors' zero is this many counts from the middle of their range.
    Offset(u16),
}

impl GateError {
    /// What a fault record keeps of it.
    pub fn value(self) -> f32 {
        match self {
            Self::Bus | Self::Readback => 0.0,
            Self::Fault(status, _) => f32::from(status),
            Self::Offset(counts) => f32::from(counts),
        }
    }
}

/// Weight of one reading in a current sensor's zero, learned while no current flows: settled after a hundred readings.
const ZERO_WEIGHT: f32 = 1.0 / 32.0;

/// Farthest that a zero may be from the middle of the converter's range, counts.
const ZERO_MAX: u16 = 512;

/// Time for the zeros to settle, ms: at least 200 carrier periods.
const ZERO_MS: u64 = 12;

/// Farthest zero from the middle, counts, as the control interrupt last saw it.
static ZERO_WORST: AtomicU16 = AtomicU16::new(0);

/// The zeros of a board's current sensors.
struct Zeros<const N: usize>([f32; N]);

impl<const N: usize> Zeros<N> {
    const fn new() -> Self {
        Self([adc::FULL_SCALE / 2.0; N])
    }

    /// A sensor's reading less its zero, counts.
    #[inline(always)]
    fn less(&self, sensor: usize, raw: u16) -> f32 {
        f32::from(raw) - self.0[sensor]
    }

    /// Takes readings without current for zeros.
    #[cold]
    #[inline(never)]
    fn learn(&mut self, raw: [u16; N]) {
        let mut worst = 0.0_f32;
        for (raw, zero) in raw.into_iter().zip(&mut self.0) {
            *zero += (f32::from(raw) - *zero) * ZERO_WEIGHT;
            worst = worst.max((*zero - adc::FULL_SCALE / 2.0).abs());
        }
        ZERO_WORST.store(worst as u16, Ordering::Relaxed);
    }
}

/// Says that no current can flow and waits until the zeros are learned; an error when one is far off.
fn learn_zeros() -> Result<(), GateError> {
    ZERO_WORST.store(0, Ordering::Relaxed);
    servo::GATE_READY.store(true, Ordering::Relaxed);
    block_for(Duration::from_millis(ZERO_MS));
    match ZERO_WORST.load(Ordering::Relaxed) {
        ..=ZERO_MAX => Ok(()),
        far => {
            servo::GATE_READY.store(false, Ordering::Relaxed);
            off();
            Err(GateError::Offset(far))
        }
    }
}
