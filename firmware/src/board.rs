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

use core::sync::atomic::{AtomicU8, AtomicU16, Ordering};

use embassy_stm32::Peri;
use embassy_stm32::peripherals::{FLASH, IWDG, PA11, PA12, USB_OTG_FS};
use embassy_time::{Duration, block_for};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;

use crate::adc;

/// Readings of one crest.
#[derive(Clone, Copy)]
pub struct Analog {
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Current of each axis, A, positive for positive duty.
    pub current_a: [f32; MAX_JOINTS],
    /// What the two sensors of each axis differ by, A; 0 where there is one.
    pub imbalance_a: [f32; MAX_JOINTS],
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
    /// So many counts of current flow though the bridges are off.
    Stray(u16),
}

impl GateError {
    /// What a fault record keeps of it.
    pub fn value(self) -> f32 {
        match self {
            Self::Bus | Self::Readback => 0.0,
            Self::Fault(status, _) => f32::from(status),
            Self::Offset(counts) | Self::Stray(counts) => f32::from(counts) * AMPERES_PER_COUNT,
        }
    }

    /// Which fault it is.
    pub fn fault(self) -> Fault {
        match self {
            Self::Bus | Self::Readback | Self::Fault(..) => Fault::GateDriver,
            Self::Offset(_) | Self::Stray(_) => Fault::StrayCurrent,
        }
    }
}

/// Weight of one reading in a current sensor's zero, learned while no current flows: settled after a hundred readings.
const ZERO_WEIGHT: f32 = 1.0 / 32.0;

/// Time for the zeros to settle, ms: at least 200 carrier periods.
const ZERO_MS: u64 = 12;

/// Current that may seem to flow once the zeros are learned and the bridges are still off, A: noise, and an amplifier
/// whose inputs are no longer shorted.
#[cfg_attr(not(feature = "odrive-v3"), expect(dead_code, reason = "only an amplifier can be shorted"))]
const STRAY_A: f32 = 0.5;

/// What the control interrupt does with readings while the bridges are off.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Zeroing {
    /// Nothing.
    No,
    /// Takes them for zeros.
    Learn,
    /// Looks what is left of them beyond the zeros.
    #[cfg_attr(not(feature = "odrive-v3"), expect(dead_code, reason = "only an amplifier can be shorted"))]
    Check,
}

/// Which it is.
static ZEROING: AtomicU8 = AtomicU8::new(Zeroing::No as u8);

/// Farthest zero from the middle, or farthest reading from its zero, counts, as the control interrupt last saw it.
static ZERO_WORST: AtomicU16 = AtomicU16::new(0);

/// The zeros of a board's current sensors, and what their readings have been beyond them.
struct Zeros<const N: usize>([f32; N], [f32; N]);

impl<const N: usize> Zeros<N> {
    const fn new() -> Self {
        Self([adc::FULL_SCALE / 2.0; N], [0.0; N])
    }

    /// Whether readings are for [`Zeros::take`].
    #[inline(always)]
    fn wanted() -> bool {
        ZEROING.load(Ordering::Relaxed) != Zeroing::No as u8
    }

    /// A sensor's reading less its zero, counts.
    #[inline(always)]
    fn less(&self, sensor: usize, raw: u16) -> f32 {
        f32::from(raw) - self.0[sensor]
    }

    /// Takes readings while the bridges are off for zeros, or sees what they are beyond them.
    #[cold]
    #[inline(never)]
    fn take(&mut self, raw: [u16; N]) {
        let learn = ZEROING.load(Ordering::Relaxed) == Zeroing::Learn as u8;
        let mut worst = 0.0_f32;
        for ((raw, zero), beyond) in raw.into_iter().zip(&mut self.0).zip(&mut self.1) {
            let left = f32::from(raw) - *zero;
            if learn {
                *zero += left * ZERO_WEIGHT;
                *beyond = 0.0;
                worst = worst.max((*zero - adc::FULL_SCALE / 2.0).abs());
            } else {
                *beyond += (left - *beyond) * ZERO_WEIGHT;
                worst = worst.max(beyond.abs());
            }
        }
        ZERO_WORST.store(worst as u16, Ordering::Relaxed);
    }
}

/// Has the control interrupt look at the current sensors while the bridges are off, for as long as their zeros take to
/// settle; the farthest it saw, counts.
fn settle(how: Zeroing) -> u16 {
    ZERO_WORST.store(0, Ordering::Relaxed);
    ZEROING.store(how as u8, Ordering::Relaxed);
    block_for(Duration::from_millis(ZERO_MS));
    ZEROING.store(Zeroing::No as u8, Ordering::Relaxed);
    ZERO_WORST.load(Ordering::Relaxed)
}
