//! The swing that a wall makes at given gains: its frequency, and how fast it grows or dies out.
//!
//! A mode z of the sampled loop swings at arg z/(2π T) and grows as exp(t ln|z|/T). Of the modes that swing at all, the
//! one that grows fastest, or dies out slowest, is what a hand feels and a microphone hears: above the boundary the
//! wall buzzes with it. The prediction is linear. It leaves out that a wall only pushes, so that the tip flies free for
//! a part of every turn, that friction holds, and that motors give no more than they can; the buzz that lasts lies
//! within 13 % of the predicted one on the demo's wall (host/tool/tests/quick/prediction.rs).

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
    use crate::analysis::domain::{domain, oscillation};
    use crate::analysis::flexible::Flexible;
    use crate::analysis::plant::{Drive, Linearised};
    use crate::analysis::sampled::{LinearEstimator, Loop, Mode};
    use nalgebra::DVector;
    use std::f64::consts::TAU;

    const RATE: f64 = 1000.0;

    /// A joint of 1 kg with a backward difference, no filter and no delay. In units of m/T² and m/T its characteristic
    /// polynomial is z³ + (k/2 + d/2 - 2) z² + (1 + k/2) z - d/2.
    fn joint() -> (Linearised, Loop) {
        let device = Linearised {
            gain: 1.0,
            flexible: Flexible::default(),
            mass: DMatrix::from_element(1, 1, 1.0),
            viscous: DVector::zeros(1),
            row: DVector::from_element(1, 1.0),
            unit_motion: DVector::from_element(1, 1.0),
        };
        let around = Loop {
            rate_hz: RATE,
            delay_samples: 0.0,
            estimator: LinearEstimator::BackwardDifference,
            drive: Drive::Ideal,
            damping_compensation: false,
        };
        (device, around)
    }

    #[test]
    fn a_joint_swings_as_the_roots_of_its_polynomial_say() {
        let (device, around) = joint();
        // Without damping one root is 0, and the pair has |z|² = 1 + k/2 and the sum 2 - k/2.
        for k in [1e-6, 0.01, 1.0, 3.0] {
            let found = oscillation(&device, &around, Mode::Off, k * RATE * RATE, 0.0).unwrap().unwrap();
            let size = (1.0 + k / 2.0_f64).sqrt();
            let hz = ((1.0 - k / 4.0) / size).acos() * RATE / TAU;
            assert!((found.hz / hz - 1.0).abs() < 1e-6, "{k}: {found:?} is not {hz} Hz");
            assert!((found.growth_per_s / (size.ln() * RATE) - 1.0).abs() < 1e-6, "{k}: {found:?}");
        }
        // With d = 0.4 and the pair at 0.9 e^{±iθ}, the third root is r = d/2/0.81; the sum of all roots and that of
        // their products in pairs give θ and k.
        let (size, d) = (0.9_f64, 0.4_f64);
        let r = d / 2.0 / (size * size);
        let cosine = (3.0 - d / 2.0 - r - size * size) / (2.0 * size * (1.0 + r));
        let k = 2.0 * (2.0 * r * size * cosine + size * size - 1.0);
        let found = oscillation(&device, &around, Mode::Off, k * RATE * RATE, d * RATE).unwrap().unwrap();
        assert!((found.hz - cosine.acos() * RATE / TAU).abs() < 1e-9 && k > 0.0, "{found:?}");
        assert!((found.growth_per_s - size.ln() * RATE).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn the_boundary_says_at_which_frequency_it_buzzes() {
        let (device, around) = joint();
        // On the circle the third root is d/2 and cos θ = (2 - d)/(2 + d).
        let asked: Vec<f64> = [0.0, 0.1, 0.5, 1.9, 2.5].iter().map(|d| d * RATE).collect();
        let found = domain(&device, &around, Mode::Off, Some(&asked)).unwrap();
        for (point, d) in found.boundary.iter().zip(&asked).skip(1).take(3) {
            let d = d / RATE;
            let hz = ((2.0 - d) / (2.0 + d)).acos() * RATE / TAU;
            assert!((point.hz.unwrap() / hz - 1.0).abs() < 1e-6, "{point:?} is not at {hz} Hz");
        }
        assert_eq!([found.boundary[0].hz, found.boundary[4].hz], [None; 2], "nothing is stable there");
        assert!(oscillation(&device, &around, Mode::Off, -1.0, 0.0).is_err());
    }

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
