//! Backward difference followed by a low-pass.
//!
//! The filters are trapezoidal state-variable (topology-preserving) forms: the bilinear transform, prewarped at the
//! cutoff. The transfer function equals the usual digital `butter` design, but the f32 states keep their accuracy even
//! if the cutoff is a thousandth of the rate. (At 20 Hz/20 kHz a direct form's gain is off by 1e-3, this gain by 4e-6;
//! tests/velocity.rs.) Cost: one difference and nine multiply-adds per step.

use super::Coefficients;
use crate::math::Real;

/// The two states of a low-pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowPass<T> {
    band: T,
    low: T,
}

impl<T: Real> LowPass<T> {
    /// Computes one step of the filter that the coefficients select: the low-pass alone, or after a joint estimator.
    #[inline(always)]
    pub fn step(&mut self, coefficients: &Coefficients<T>, input: T) -> T {
        if coefficients.unfiltered { input } else { self.step_low_pass(coefficients, input) }
    }

    /// Computes one step of the second-order low-pass, for coefficients of a low-pass.
    #[inline(always)]
    pub fn step_low_pass(&mut self, coefficients: &Coefficients<T>, input: T) -> T {
        let high = input - self.low;
        let gain = coefficients.a2 * high - coefficients.loss * self.band;
        let rise = coefficients.a2 * self.band + coefficients.a3 * high;
        let low = self.low + rise;
        self.band += gain + gain;
        self.low = low + rise;
        low
    }

    /// Computes one step of a first-order low-pass.
    #[inline(always)]
    pub fn step_first_order(&mut self, gain: T, input: T) -> T {
        let rise = gain * (input - self.low);
        let low = self.low + rise;
        self.low = low + rise;
        low
    }

    /// Returns the last output.
    pub fn low(&self) -> T {
        self.low
    }
}

/// A velocity estimator for one position signal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity<T> {
    last_position: T,
    filter: LowPass<T>,
}

impl<T: Real> Velocity<T> {
    /// Makes an estimator at rest at this position.
    pub fn resting_at(position: T) -> Self {
        Self { last_position: position, filter: LowPass::default() }
    }

    /// Returns the velocity (per second) after this sample of the position.
    #[inline(always)]
    pub fn step(&mut self, coefficients: &Coefficients<T>, position: T) -> T {
        let difference = self.moved(position);
        self.last_position = position;
        self.filter.step(coefficients, difference * coefficients.rate)
    }

    /// Returns the velocity (per second) after this sample, for coefficients of a low-pass.
    #[inline(always)]
    pub fn step_low_pass(&mut self, coefficients: &Coefficients<T>, position: T) -> T {
        let difference = self.moved(position);
        self.last_position = position;
        self.filter.step_low_pass(coefficients, difference * coefficients.rate)
    }

    /// Sets the state to a position and a velocity (per second) from another estimator, and returns the velocity.
    pub fn follow(&mut self, position: T, velocity: T) -> T {
        self.last_position = position;
        self.filter = LowPass { band: T::zero(), low: velocity };
        velocity
    }

    /// Returns the distance of `position` from the last sample.
    #[inline(always)]
    fn moved(&self, position: T) -> T {
        position - self.last_position
    }
}
