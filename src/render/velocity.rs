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

impl Estimator {
    /// Every estimator with its name in scene files and on the command line.
    pub const ALL: [(&'static str, Self); 3] = [
        ("butterworth", Self::Butterworth),
        ("first-order", Self::FirstOrder),
        ("backward-difference", Self::BackwardDifference),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
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
fn warped<T: Real>(cutoff_hz: T, rate_hz: T) -> Result<T, BadCutoff> {
    let ratio = cutoff_hz / rate_hz;
    let valid = rate_hz.is_finite() && ratio > T::zero() && ratio < T::from_f64(0.5);
    if valid { Ok(tangent(ratio)) } else { Err(BadCutoff) }
}

/// The tangent of π times a ratio from 0 to 1/2, to a few units in the last place: the quotient of the two power
/// series, above π/4 that of the complement. Small, because the board designs its filters itself, in its own precision.
fn tangent<T: Real>(ratio: T) -> T {
    let complement = T::from_f64(0.5) - ratio;
    if ratio > complement {
        return T::one() / tangent(complement);
    }
    let angle = ratio * T::from_f64(core::f64::consts::PI);
    let square = angle * angle;
    let (mut sine, mut cosine) = (angle, T::one());
    let (mut term, mut n) = (T::one(), T::one());
    while term.abs() > T::EPSILON * T::EPSILON {
        term *= -square / (n * (n + T::one()));
        cosine += term;
        n += T::one() + T::one();
        sine += term * angle / n;
    }
    sine / cosine
}

/// An estimator's coefficients, made when a scene or its gains are set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients<T> {
    /// Control rate, Hz.
    rate: T,
    kind: Estimator,
    /// What the band-pass state loses in half a step, 1 - a₁: small where the cutoff is, so it keeps its digits there.
    loss: T,
    a2: T,
    a3: T,
    /// Of a first-order low-pass at the same cutoff (1 where there is none).
    first: T,
    /// s, see [`Coefficients::lag`].
    lag: T,
}

impl<T: Real> Coefficients<T> {
    /// For a control rate and a cutoff in Hz. The cutoff must lie between 0 and half the rate, except for
    /// [`Estimator::BackwardDifference`], which has none.
    pub fn new(kind: Estimator, rate_hz: T, cutoff_hz: T) -> Result<Self, BadCutoff> {
        let one = T::one();
        let g = match kind {
            Estimator::Butterworth | Estimator::FirstOrder => warped(cutoff_hz, rate_hz)?,
            Estimator::BackwardDifference => one,
        };
        let first = g / (one + g);
        let damped = g * (g + T::from_f64(core::f64::consts::SQRT_2));
        let a1 = one / (one + damped);
        // Half a sample for the difference, and the slope of the low-pass's phase at rest.
        let slope = match kind {
            Estimator::Butterworth => T::from_f64(core::f64::consts::FRAC_1_SQRT_2) / g,
            Estimator::FirstOrder => T::from_f64(0.5) / g,
            Estimator::BackwardDifference => T::zero(),
        };
        let lag = (T::from_f64(0.5) + slope) / rate_hz;
        Ok(Self { rate: rate_hz, kind, loss: damped * a1, a2: g * a1, a3: g * g * a1, first, lag })
    }

    /// How far an estimated velocity lags behind, s.
    pub fn lag(&self) -> T {
        self.lag
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
                let gain = coefficients.a2 * high - coefficients.loss * self.band;
                let rise = coefficients.a2 * self.band + coefficients.a3 * high;
                let low = self.low + rise;
                self.band += gain + gain;
                self.low = low + rise;
                low
            }
            Estimator::FirstOrder => self.step_first_order(coefficients.first, input),
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
    pub fn new(washout_hz: T, rate_hz: T) -> Result<Self, BadCutoff> {
        let g = warped(washout_hz, rate_hz)?;
        Ok(Self { gain: g / (T::one() + g), low: T::zero(), rest: T::zero() })
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
        for i in 0..500 {
            let ratio = f64::from(i) * 1.0e-3;
            let exact = libm::tan(core::f64::consts::PI * ratio);
            // The complement's own rounding counts where the tangent is steep.
            assert!((tangent(ratio) - exact).abs() <= 4.0e-16 * exact * (4.0 + exact), "{ratio}");
            let single = f64::from(tangent(ratio as f32));
            assert!((single - exact).abs() <= 2.0e-7 * exact * (4.0 + exact), "{ratio} in single precision");
        }
    }
}
