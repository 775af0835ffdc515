//! Cutoff frequencies, prewarped for the bilinear transform.

use crate::math::Real;

/// A cutoff that is not between zero and half the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadCutoff;

impl core::fmt::Display for BadCutoff {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a filter's cutoff must be greater than zero and below half the control rate")
    }
}

impl core::error::Error for BadCutoff {}

/// Returns the prewarped gain tan(π cutoff/rate).
pub(super) fn prewarped_gain<T: Real>(cutoff_hz: T, rate_hz: T) -> Result<T, BadCutoff> {
    let ratio = cutoff_hz / rate_hz;
    let valid = rate_hz.is_finite() && ratio > T::zero() && ratio < T::from_f64(0.5);
    if valid { Ok(tangent(ratio)) } else { Err(BadCutoff) }
}

/// Returns the tangent of π times a ratio from 0 to 1/2, to a few units in the last place. Uses the quotient of two
/// power series, or above π/4 the inverse of the complement's tangent.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_agrees_with_libm_up_to_a_quarter_turn() {
        for i in 0..500 {
            let ratio = f64::from(i) * 1.0e-3;
            let exact = libm::tan(core::f64::consts::PI * ratio);
            // The rounding of the complement matters where the tangent is steep.
            assert!((tangent(ratio) - exact).abs() <= 4.0e-16 * exact * (4.0 + exact), "{ratio}");
            let single = f64::from(tangent(ratio as f32));
            assert!((single - exact).abs() <= 2.0e-7 * exact * (4.0 + exact), "{ratio} in single precision");
        }
    }
}
