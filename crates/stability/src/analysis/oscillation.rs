//! Oscillation of a wall at given gains: its frequency and growth.
//!
//! A mode z of the sampled loop oscillates at arg z/(2π T) and grows as exp(t ln|z|/T). A hand feels and hears the
//! oscillating mode with the largest growth; above the stability boundary the wall buzzes at its frequency.
//!
//! The linear prediction leaves out that a wall only pushes, friction, and the torque limit. On the demo's wall the
//! buzz lies within 13 % of the predicted frequency (tool/tests/quick/prediction.rs).

use super::eigenvalues::eigenvalues;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// An oscillating mode of the closed loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Oscillation {
    /// Frequency, Hz; half the control rate if the sign changes with every sample.
    pub hz: f64,
    /// Rate of exponential growth, 1/s; negative if the oscillation decays.
    pub growth_per_s: f64,
}

/// Largest growth per sample on the stability boundary. Where a creep is the boundary, oscillations decay faster.
const MAX_GROWTH_ON_CIRCLE: f64 = 1e-6;

impl Oscillation {
    /// Returns the least damped mode z = 1 + γ of F = A - I; `None` if no mode oscillates.
    pub(super) fn least_damped(f: DMatrix<f64>, sample_s: f64) -> Option<Self> {
        eigenvalues(f)?
            .into_iter()
            // Only one mode of each complex pair counts. A mode with negative z oscillates at half the rate.
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

    /// Returns the frequency (Hz) if the oscillation neither grows nor decays, as on its own stability boundary.
    pub(super) fn sustained_hz(&self, sample_s: f64) -> Option<f64> {
        ((self.growth_per_s * sample_s).abs() < MAX_GROWTH_ON_CIRCLE).then_some(self.hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    #[test]
    fn a_creep_has_no_frequency() {
        // Both modes are real and one grows, as in a creep.
        let creep = DMatrix::from_diagonal(&DVector::from_vec(vec![1e-4, -0.5]));
        assert_eq!(Oscillation::least_damped(creep, 1e-3), None);
        // A mode that changes its sign with every sample oscillates at half the rate.
        let alternates = DMatrix::from_diagonal(&DVector::from_vec(vec![-1.9, -0.5]));
        let result = Oscillation::least_damped(alternates, 1e-3).unwrap();
        assert!((result.hz - 500.0).abs() < 1e-9 && (result.growth_per_s - 1e3 * 0.9_f64.ln()).abs() < 1e-9);
        assert_eq!(result.sustained_hz(1e-3), None);
    }
}
