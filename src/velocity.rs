//! Velocity from positions: backward difference, then a low-pass; and the washout's high-pass.
//!
//! The filters are trapezoidal state-variable (topology-preserving) forms: the bilinear transform prewarped at the
//! cutoff, so the very transfer function of the usual digital `butter` design, but with states that keep their
//! accuracy in f32 when the cutoff is a thousandth of the rate. (A direct form's gain is off by 1e-3 at
//! 20 Hz/20 kHz, this by 4e-6; tests/velocity.rs.) Cost: one difference and nine multiply-adds a step.

use crate::math::Real;

/// How wall velocities are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// Backward difference and a 2nd-order Butterworth low-pass: the paper's.
    #[default]
    Butterworth,
    /// Backward difference and a 1st-order low-pass: less lag, less smoothing.
    FirstOrder,
    /// Backward difference alone; the cutoff is not used.
    BackwardDifference,
}

/// A cutoff that is not between zero and half the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadCutoff;

impl core::fmt::Display for BadCutoff {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a filter's cutoff must be greater than zero and below half the control rate")
    }
}

impl core::error::Error for BadCutoff {}

/// The prewarped gain tan(π cutoff/rate).
fn warped(cutoff_hz: f64, rate_hz: f64) -> Result<f64, BadCutoff> {
    let valid = rate_hz.is_finite() && cutoff_hz > 0.0 && cutoff_hz < 0.5 * rate_hz;
    if valid { Ok(tangent(core::f64::consts::PI * (cutoff_hz / rate_hz))) } else { Err(BadCutoff) }
}

/// The tangent of an angle from 0 to π/2, to a few units in the last place: the quotient of the two power series, above
/// π/4 that of the complement. Small, because the board designs its filters itself.
fn tangent(angle: f64) -> f64 {
    let complement = core::f64::consts::FRAC_PI_2 - angle;
    if angle > complement {
        return 1.0 / tangent(complement);
    }
    let square = angle * angle;
    let (mut sine, mut cosine) = (angle, 1.0);
    let (mut term, mut n) = (1.0_f64, 1.0);
    while term.abs() > 1.0e-20 {
        term *= -square / (n * (n + 1.0));
        cosine += term;
        sine += term * angle / (n + 2.0);
        n += 2.0;
    }
    sine / cosine
}

/// An estimator's coefficients, made when a scene or its gains are set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients<T> {
    /// Control rate, Hz.
    rate: T,
    kind: Estimator,
    a1: T,
    a2: T,
    a3: T,
    /// Of a first-order low-pass at the same cutoff (1 where there is none).
    first: T,
}

impl<T: Real> Coefficients<T> {
    /// For a control rate and a cutoff in Hz. The cutoff must lie between 0 and half the rate, except for
    /// [`Estimator::BackwardDifference`], which has none.
    pub fn new(kind: Estimator, rate_hz: f64, cutoff_hz: f64) -> Result<Self, BadCutoff> {
        let g = match kind {
            Estimator::Butterworth | Estimator::FirstOrder => warped(cutoff_hz, rate_hz)?,
            Estimator::BackwardDifference => 1.0,
        };
        let first = g / (1.0 + g);
        let (a1, a2, a3) = match kind {
            Estimator::Butterworth => {
                let a1 = 1.0 / (1.0 + g * (g + core::f64::consts::SQRT_2));
                (a1, g * a1, g * g * a1)
            }
            Estimator::FirstOrder => (first, 0.0, 0.0),
            Estimator::BackwardDifference => (0.0, 0.0, 0.0),
        };
        let r = T::from_f64;
        Ok(Self { rate: r(rate_hz), kind, a1: r(a1), a2: r(a2), a3: r(a3), first: r(first) })
    }

    /// Control rate, Hz.
    pub fn rate(&self) -> T {
        self.rate
    }

    /// The gain of [`LowPass::step_first_order`] at the same cutoff.
    pub fn first_order_gain(&self) -> T {
        self.first
    }
}

/// A low-pass's two states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowPass<T> {
    band: T,
    low: T,
}

impl<T: Real> LowPass<T> {
    /// One step.
    #[inline(always)]
    pub fn step(&mut self, coefficients: &Coefficients<T>, input: T) -> T {
        match coefficients.kind {
            Estimator::Butterworth => {
                let high = input - self.low;
                let band = coefficients.a1 * self.band + coefficients.a2 * high;
                let rise = coefficients.a2 * self.band + coefficients.a3 * high;
                let low = self.low + rise;
                self.band = band + band - self.band;
                self.low = low + rise;
                low
            }
            Estimator::FirstOrder => self.step_first_order(coefficients.a1, input),
            Estimator::BackwardDifference => input,
        }
    }

    /// One step of a first-order low-pass.
    #[inline(always)]
    pub fn step_first_order(&mut self, gain: T, input: T) -> T {
        let rise = gain * (input - self.low);
        let low = self.low + rise;
        self.low = low + rise;
        low
    }
}

/// A velocity estimator for one position signal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity<T> {
    last: T,
    primed: bool,
    filter: LowPass<T>,
}

impl<T: Real> Velocity<T> {
    /// The velocity (per second) after this sample of the position; zero at the first.
    #[inline(always)]
    pub fn step(&mut self, coefficients: &Coefficients<T>, position: T) -> T {
        let difference = self.moved(position);
        self.last = position;
        self.primed = true;
        self.filter.step(coefficients, difference * coefficients.rate)
    }

    /// How far `position` is from the last sample; zero before the first. Call before [`Velocity::step`].
    #[inline(always)]
    pub fn moved(&self, position: T) -> T {
        if self.primed { position - self.last } else { T::zero() }
    }

    /// Forgets the last sample, so that a position that is set anew (homing) is not a motion.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}

/// The washout: a first-order high-pass of the wall force, whose output is what the feed-forward shapes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Washout<T> {
    gain: T,
    low: T,
    /// What rounding has kept out of `low` so far: at 0.2 Hz and 50 kHz a step moves `low` by less than its last digit.
    rest: T,
}

impl<T: Real> Washout<T> {
    /// Bilinear, prewarped at `washout_hz` (between zero and half the rate), started at zero.
    pub fn new(washout_hz: f64, rate_hz: f64) -> Result<Self, BadCutoff> {
        let g = warped(washout_hz, rate_hz)?;
        Ok(Self { gain: T::from_f64(g / (1.0 + g)), low: T::zero(), rest: T::zero() })
    }

    /// The high-passed force.
    #[inline(always)]
    pub fn step(&mut self, force: T) -> T {
        let rise = self.gain * (force - self.low);
        let high = force - self.low - rise;
        let step = rise + rise + self.rest;
        let low = self.low + step;
        self.rest = step - (low - self.low);
        self.low = low;
        high
    }

    /// Takes new coefficients and keeps the state.
    pub fn retune(&mut self, other: &Self) {
        self.gain = other.gain;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_is_that_of_libm_up_to_a_quarter_turn() {
        for i in 0..1571 {
            let angle = f64::from(i) * 1.0e-3;
            let exact = libm::tan(angle);
            // The complement's own rounding counts where the tangent is steep.
            assert!((tangent(angle) - exact).abs() <= 4.0e-16 * exact * (4.0 + exact), "{angle}");
        }
    }
}
