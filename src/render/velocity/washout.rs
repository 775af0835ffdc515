//! The high-pass of a wall's force for the washout.

use super::cutoff::{BadCutoff, prewarped_gain};
use crate::math::Real;

/// The washout: a first-order high-pass of the wall force. The feed-forward acts on the output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Washout<T> {
    gain: T,
    low: T,
    /// Rounding error of `low`, because a step at 0.2 Hz and 50 kHz changes `low` by less than its last digit.
    rounding: T,
}

impl<T: Real> Washout<T> {
    /// Makes a bilinear filter, prewarped at `washout_hz` (between zero and half the rate), with a state of zero.
    pub fn new(washout_hz: T, rate_hz: T) -> Result<Self, BadCutoff> {
        let g = prewarped_gain(washout_hz, rate_hz)?;
        Ok(Self { gain: g / (T::one() + g), low: T::zero(), rounding: T::zero() })
    }

    /// Returns the high-passed force.
    #[inline(always)]
    pub fn step(&mut self, force: T) -> T {
        let rise = self.gain * (force - self.low);
        let high = force - self.low - rise;
        let step = rise + rise + self.rounding;
        let low = self.low + step;
        self.rounding = step - (low - self.low);
        self.low = low;
        high
    }

    /// Takes the coefficients of `other` and keeps the state.
    pub fn retune(&mut self, other: &Self) {
        self.gain = other.gain;
    }
}
