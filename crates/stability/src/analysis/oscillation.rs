//! Oscillation of a wall at given gains: its frequency and growth.
//!
//! A mode z of the sampled loop oscillates at arg z/(2π T) and grows as exp(t ln|z|/T). Of all oscillating modes, a
//! hand feels and hears the one with the largest growth: above the boundary the wall buzzes at its frequency. The
//! prediction is linear and leaves out three effects: a wall only pushes, so the tip flies free for a part of every
//! period; friction; and the limit of motor torque. The sustained buzz lies within 13 % of the predicted frequency on
//! the demo's wall (tool/tests/quick/prediction.rs).

use super::eigenvalues::eigenvalues;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// An oscillating mode of the closed loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Oscillation {
    /// Frequency, Hz: half the control rate if the sign changes with every sample.
    pub hz: f64,
    /// Rate of exponential growth, 1/s: negative if the oscillation dies out.
    pub growth_per_s: f64,
}

/// Tolerance of |z| = 1 on the boundary. On the boundary of a creep, a mode that does not oscillate, every oscillation
/// decays faster.
const ON_THE_CIRCLE: f64 = 1e-6;

impl Oscillation {
    /// Returns the least damped of the modes z = 1 + γ of a delta-form matrix F sampled every `sample_s` (s); `None` if
    /// no mode oscillates.
    pub(super) fn least_damped(f: DMatrix<f64>, sample_s: f64) -> Option<Self> {
        eigenvalues(f)?
            .into_iter()
            // One mode of each pair counts. A negative mode oscillates as well; a mode at zero is gone after a sample.
            .filter(|gamma| gamma.im > 0.0 || (gamma.im == 0.0 && gamma.re < -1.0))
            .map(|gamma| Self {
                hz: gamma.im.atan2(1.0 + gamma.re) / (std::f64::consts::TAU * sample_s),
                growth_per_s: 0.5 * (2.0 * gamma.re + gamma.norm_sqr()).ln_1p() / sample_s,
            })
            .filter(|mode| mode.growth_per_s.is_finite())
            .max_by(|a, b| a.growth_per_s.total_cmp(&b.growth_per_s))
    }

    /// Returns true if the oscillation grows.
    #[must_use]
    pub fn grows(&self) -> bool {
        self.growth_per_s > 0.0
    }

    /// Returns the frequency (Hz) if the oscillation neither grows nor dies out, as on a boundary that it causes.
    pub(super) fn sustained_hz(&self, sample_s: f64) -> Option<f64> {
        ((self.growth_per_s * sample_s).abs() < ON_THE_CIRCLE).then_some(self.hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    #[test]
    fn a_creep_has_no_frequency() {
        // Only real modes, one of which grows, as in a creep.
        let creep = DMatrix::from_diagonal(&DVector::from_vec(vec![1e-4, -0.5]));
        assert_eq!(Oscillation::least_damped(creep, 1e-3), None);
        // A mode that changes its sign with every sample oscillates at half the rate.
        let alternates = DMatrix::from_diagonal(&DVector::from_vec(vec![-1.9, -0.5]));
        let result = Oscillation::least_damped(alternates, 1e-3).unwrap();
        assert!((result.hz - 500.0).abs() < 1e-9 && (result.growth_per_s - 1e3 * 0.9_f64.ln()).abs() < 1e-9);
        assert_eq!(result.sustained_hz(1e-3), None);
    }
}
