//! The zeros of current sensors, learned by the control interrupt while the bridges are off and a task waits.

use core::sync::atomic::{AtomicU8, AtomicU16, Ordering};

use embassy_time::{Duration, block_for};

use crate::adc;

/// Weight of one reading in a current sensor's zero, learned while no current flows: settled after a hundred readings.
const ZERO_WEIGHT: f32 = 1.0 / 32.0;

/// Time for the zeros to settle, ms: at least 200 carrier periods.
const ZERO_MS: u64 = 12;

/// The use of readings while the bridges are off.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Zeroing {
    /// Nothing.
    No,
    /// Takes them for zeros.
    Learn,
    /// Looks what is left of them beyond the zeros.
    #[allow(dead_code, reason = "only an amplifier can be shorted, and not every board has one")]
    Check,
}

/// Which it is.
static ZEROING: AtomicU8 = AtomicU8::new(Zeroing::No as u8);

/// Farthest zero from the middle, or farthest reading from its zero, counts, as the control interrupt last saw it.
static ZERO_WORST: AtomicU16 = AtomicU16::new(0);

/// The zeros of a board's current sensors, and what their readings have been beyond them.
pub struct Zeros<const N: usize>([f32; N], [f32; N]);

impl<const N: usize> Zeros<N> {
    /// Zeros in the middle of the converter's range.
    pub const fn new() -> Self {
        Self([adc::FULL_SCALE / 2.0; N], [0.0; N])
    }

    /// Each sensor's zero, counts.
    pub fn get(&self) -> &[f32; N] {
        &self.0
    }

    /// Takes readings while the bridges are off for zeros, or sees what they are beyond them, where a task waits for that.
    #[inline(never)]
    pub fn take(&mut self, raw: [i32; N]) {
        let how = ZEROING.load(Ordering::Relaxed);
        if how == Zeroing::No as u8 {
            return;
        }
        let learn = how == Zeroing::Learn as u8;
        let mut worst = 0.0_f32;
        for ((raw, zero), beyond) in raw.into_iter().zip(&mut self.0).zip(&mut self.1) {
            let left = raw as f32 - *zero;
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
pub fn settle(how: Zeroing) -> u16 {
    ZERO_WORST.store(0, Ordering::Relaxed);
    ZEROING.store(how as u8, Ordering::Relaxed);
    block_for(Duration::from_millis(ZERO_MS));
    ZEROING.store(Zeroing::No as u8, Ordering::Relaxed);
    ZERO_WORST.load(Ordering::Relaxed)
}
