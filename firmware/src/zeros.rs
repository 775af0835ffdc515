//! The zeros of the current sensors, which the control interrupt learns while the bridges are off and a task waits.

use core::sync::atomic::{AtomicU8, AtomicU16, Ordering};

use embassy_time::{Duration, block_for};

use crate::adc;

/// Weight of one reading in a sensor's zero, which settles after a hundred readings.
const ZERO_WEIGHT: f32 = 1.0 / 32.0;
/// Time for the zeros to settle, ms: at least 200 carrier periods.
const ZERO_SETTLING_MS: u64 = 12;

/// Use of the readings while the bridges are off.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Zeroing {
    /// The readings are not used.
    No,
    /// The readings become the zeros.
    Learn,
    /// The readings are compared with the zeros.
    #[allow(dead_code, reason = "only an amplifier can be shorted, and not every board has one")]
    Check,
}

static ZEROING: AtomicU8 = AtomicU8::new(Zeroing::No as u8);
/// Largest distance of a zero from the middle of the range, or of a reading from its zero, counts.
static WORST_ZERO_DISTANCE: AtomicU16 = AtomicU16::new(0);

/// The zeros of a board's current sensors, and the mean distance of the readings from the zeros, counts.
pub struct Zeros<const N: usize>([f32; N], [f32; N]);

impl<const N: usize> Zeros<N> {
    /// Creates zeros in the middle of the converter's range.
    pub const fn new() -> Self {
        Self([adc::FULL_SCALE / 2.0; N], [0.0; N])
    }

    /// Returns each sensor's zero, counts.
    pub fn get(&self) -> &[f32; N] {
        &self.0
    }

    /// Learns or checks the zeros with readings while the bridges are off, as the waiting task requests.
    #[inline(never)]
    pub fn update(&mut self, raw: [i32; N]) {
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
        WORST_ZERO_DISTANCE.store(worst as u16, Ordering::Relaxed);
    }
}

/// Lets the control interrupt learn or check the zeros, with the bridges off, until they settle. Returns the largest
/// distance, counts, see [`WORST_ZERO_DISTANCE`].
pub fn learn_or_check_zeros(how: Zeroing) -> u16 {
    WORST_ZERO_DISTANCE.store(0, Ordering::Relaxed);
    ZEROING.store(how as u8, Ordering::Relaxed);
    block_for(Duration::from_millis(ZERO_SETTLING_MS));
    ZEROING.store(Zeroing::No as u8, Ordering::Relaxed);
    WORST_ZERO_DISTANCE.load(Ordering::Relaxed)
}
