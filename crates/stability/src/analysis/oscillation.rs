//! The swing that a wall makes at given gains: its frequency, and how fast it grows or dies out.
//!
//! A mode z of the sampled loop swings at arg z/(2π T) and grows as exp(t ln|z|/T). Of the modes that swing at all, the
//! one that grows fastest, or dies out slowest, is what a hand feels and a microphone hears: above the boundary the
//! wall buzzes with it. The prediction is linear. It leaves out that a wall only pushes, so that the tip flies free for
//! a part of every turn, that friction holds, and that motors give no more than they can; the buzz that lasts lies
//! within 13 % of the predicted one on the demo's wall (tool/tests/quick/prediction.rs).

use super::eigenvalues::eigenvalues;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// A mode of the closed loop that swings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Oscillation {
    /// Frequency, Hz: half the control rate where the sign changes with every sample.
    pub hz: f64,
    /// Rate of exponential growth, 1/s: negative where the swing dies out.
    pub growth_per_s: f64,
}

/// On the boundary |z| is 1 to this; on the boundary of a creep, a mode that does not swing, every swing decays faster.
const ON_THE_CIRCLE: f64 = 1e-6;

impl Oscillation {
    /// The least damped of the modes z = 1 + γ of a delta-form matrix F sampled every `sample_s` (s); `None` where none
    /// swings.
    pub(super) fn least_damped(f: DMatrix<f64>, sample_s: f64) -> Option<Self> {
        eigenvalues(f)?
            .into_iter()
            // Of each pair one; a negative mode swings as well, and one at zero is gone after a sample.
            .filter(|gamma| gamma.im > 0.0 || (gamma.im == 0.0 && gamma.re < -1.0))
            .map(|gamma| Self {
                hz: gamma.im.atan2(1.0 + gamma.re) / (std::f64::consts::TAU * sample_s),
                growth_per_s: 0.5 * (2.0 * gamma.re + gamma.norm_sqr()).ln_1p() / sample_s,
            })
            .filter(|mode| mode.growth_per_s.is_finite())
            .max_by(|a, b| a.growth_per_s.total_cmp(&b.growth_per_s))
    }

    /// Returns true if it builds up.
    #[must_use]
    pub fn grows(&self) -> bool {
        self.growth_per_s > 0.0
    }

    /// Its frequency (Hz) if it neither grows nor dies out, as on a boundary that it makes.
    pub(super) fn sustained_hz(&self, sample_s: f64) -> Option<f64> {
        ((self.growth_per_s * sample_s).abs() < ON_THE_CIRCLE).then_some(self.hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    #[test]
    fn what_does_not_swing_has_no_frequency() {
        // Real modes alone, one of them growing, as a creep does.
        let creep = DMatrix::from_diagonal(&DVector::from_vec(vec![1e-4, -0.5]));
        assert_eq!(Oscillation::least_damped(creep, 1e-3), None);
        // A mode that changes its sign with every sample swings at half the rate.
        let alternates = DMatrix::from_diagonal(&DVector::from_vec(vec![-1.9, -0.5]));
        let found = Oscillation::least_damped(alternates, 1e-3).unwrap();
        assert!((found.hz - 500.0).abs() < 1e-9 && (found.growth_per_s - 1e3 * 0.9_f64.ln()).abs() < 1e-9);
        assert_eq!(found.sustained_hz(1e-3), None);
    }
}
