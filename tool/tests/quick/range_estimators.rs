//! The stable range of a pure mass with each velocity estimator agrees with closed forms.

use crate::common::{ideal_loop, point_mass};
use haptic_stability::analysis::range::domain;
use haptic_stability::analysis::sampled::{AnalysisError, LinearEstimator, Mode};
use nalgebra::Complex;

const RATE_HZ: f64 = 1000.0;
/// Mass, kg.
const MASS_KG: f64 = 0.3;

/// Returns kp_max T²/m at these dampings kd T/m, without delay.
fn boundary(estimator: LinearEstimator, damping: &[f64]) -> Result<Vec<f64>, AnalysisError> {
    let around = ideal_loop(RATE_HZ, 0.0, estimator);
    let kd: Vec<f64> = damping.iter().map(|b| b * MASS_KG * RATE_HZ).collect();
    let found = domain(&point_mass(MASS_KG), &around, Mode::Off, Some(&kd))?;
    Ok(found.boundary.iter().map(|point| point.kp / (MASS_KG * RATE_HZ * RATE_HZ)).collect())
}

#[test]
fn a_predicted_velocity_acts_like_an_exact_one_at_every_cutoff() {
    // x' = x + v + u/2, v' = v + u and u = -a x - b v have the polynomial z² - (2 - a/2 - b) z + 1 - b + a/2, which is
    // stable for a < 2b, b < 2. By the separation principle the observer only adds its own poles.
    let damping = [0.05, 0.4, 1.0, 1.9];
    for cutoff in [1.0, 20.0, 200.0] {
        let found = boundary(LinearEstimator::Predicted(cutoff), &damping).unwrap();
        for (b, a) in damping.iter().zip(&found) {
            assert!((a / (2.0 * b) - 1.0).abs() < 1e-6, "cutoff {cutoff}, damping {b}: {a}");
        }
    }
}

#[test]
fn a_difference_over_k_samples_matches_its_transfer_function() {
    // The boundary is the smallest real a > 0 with 1 + (a + b (1 - z^-k)/k) (z + 1)/(2 (z - 1)²) = 0 for some |z| = 1.
    let crossing = |k: i32, b: f64| {
        let at = |angle: f64| {
            let z = Complex::from_polar(1.0, angle);
            -(z - 1.0) * (z - 1.0) * 2.0 / (z + 1.0) - (Complex::new(1.0, 0.0) - z.powi(-k)) * b / f64::from(k)
        };
        let angles: Vec<f64> = (1..200_000).map(|i| std::f64::consts::PI * f64::from(i) / 200_000.0).collect();
        let mut smallest_limit = f64::INFINITY;
        for pair in angles.windows(2) {
            let (low, high) = (at(pair[0]), at(pair[1]));
            if (low.im > 0.0) != (high.im > 0.0) {
                let share = low.im / (low.im - high.im);
                let a = low.re + share * (high.re - low.re);
                smallest_limit = if a > 0.0 { smallest_limit.min(a) } else { smallest_limit };
            }
        }
        smallest_limit
    };
    for k in [2, 5, 10, 32] {
        for b in [0.01, 0.02, 0.04] {
            let found = boundary(LinearEstimator::BackwardDifference.with_window(k as usize), &[b]).unwrap()[0];
            assert!((found / crossing(k, b) - 1.0).abs() < 1e-4, "over {k}, damping {b}: {found}, {}", crossing(k, b));
        }
    }
}

#[test]
fn impossible_windows_and_cutoffs_are_refused() {
    assert_eq!(boundary(LinearEstimator::BackwardDifference.with_window(0), &[]), Err(AnalysisError::Difference(0)));
    assert_eq!(boundary(LinearEstimator::BackwardDifference.with_window(65), &[]), Err(AnalysisError::Difference(65)));
    for estimator in [LinearEstimator::Predicted(0.0), LinearEstimator::Butterworth(500.0).with_window(2)] {
        assert!(matches!(boundary(estimator, &[]), Err(AnalysisError::Cutoff { .. })), "{estimator:?}");
    }
}
