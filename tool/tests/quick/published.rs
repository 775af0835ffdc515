//! The library reproduces published numbers about sampled walls (docs/published.md).

use crate::common::prelude::*;
use crate::common::{ideal_loop, point_mass, read};
use haptic_stability::analysis::flexible::Hand;

const RATE_HZ: f64 = 1000.0;

fn unit_mass() -> Linearised {
    point_mass(1.0)
}

fn control_loop(estimator: LinearEstimator, delay_samples: f64) -> Loop {
    ideal_loop(RATE_HZ, delay_samples, estimator)
}

/// Returns kp_max T²/m at these dampings kd T/m.
fn boundary(around: &Loop, dampings: &[f64]) -> Vec<f64> {
    let kd: Vec<f64> = dampings.iter().map(|damping| damping * RATE_HZ).collect();
    let found = domain(&unit_mass(), around, Mode::Off, Some(&kd)).unwrap();
    found.boundary.iter().map(|point| point.kp / (RATE_HZ * RATE_HZ)).collect()
}

/// Rows of the table in docs/published.md: largest kp T²/m, its kd T/m, largest kd T/m, area T³/m².
const PUBLISHED_ROWS: [(f64, f64, f64, f64); 4] = [
    (0.68629, 0.8284, 2.0, 0.9096),
    (0.14447, 0.4247, 0.82843, 0.0798),
    (0.06243, 0.2914, 0.53590, 0.0223),
    (0.03478, 0.2224, 0.39782, 0.0092),
];

#[test]
fn a_mass_behind_whole_samples_of_delay_has_the_known_domain() {
    let page = read("docs/published.md");
    for (delay, (peak, place, limit, area)) in PUBLISHED_ROWS.into_iter().enumerate() {
        let around = control_loop(LinearEstimator::BackwardDifference, delay as f64);
        let dampings: Vec<f64> = (0..=1000).map(|i| limit * f64::from(i) / 1000.0).collect();
        let kp = boundary(&around, &dampings);
        let top = (0..kp.len()).max_by(|a, b| kp[*a].total_cmp(&kp[*b])).unwrap();
        assert!((kp[top] - peak).abs() < 2e-5, "{delay}: {} is not {peak}", kp[top]);
        assert!((dampings[top] - place).abs() < 2e-3 * limit, "{delay}: {} is not {place}", dampings[top]);
        let found = domain(&unit_mass(), &around, Mode::Off, Some(&[])).unwrap();
        assert!((found.kd_max / RATE_HZ - limit).abs() < 2e-5, "{delay}: {} is not {limit}", found.kd_max / RATE_HZ);
        let exact: f64 = kp.windows(2).map(|pair| (pair[0] + pair[1]) / 2.0 * limit / 1000.0).sum();
        assert!((exact - area).abs() < 1e-4, "{delay}: {exact} is not {area}");
        let row = format!("| {delay} | {peak} | {place} | {limit} | {area} |");
        assert!(page.contains(&row), "docs/published.md lacks {row}");
    }
    // Without delay the boundary is known in closed form, 2β(2 - β)/(2 + β), and so is its area, 12 - 16 ln 2.
    let dampings = [0.01, 0.3, 2.0 * (2.0_f64.sqrt() - 1.0), 1.2, 1.9];
    for (found, b) in
        boundary(&control_loop(LinearEstimator::BackwardDifference, 0.0), &dampings).into_iter().zip(dampings)
    {
        assert!((found / (2.0 * b * (2.0 - b) / (2.0 + b)) - 1.0).abs() < 1e-9);
    }
}

#[test]
fn at_the_origin_every_boundary_has_the_same_slope() {
    for delay in [0.0, 0.25, 0.5, 1.0, 1.6, 2.0, 3.0] {
        for estimator in [
            LinearEstimator::BackwardDifference,
            LinearEstimator::BackwardDifference.with_window(4),
            LinearEstimator::FirstOrder(40.0),
            LinearEstimator::Butterworth(20.0),
            LinearEstimator::Butterworth(200.0),
            LinearEstimator::Butterworth(100.0).with_window(3),
        ] {
            let damping = 1e-5;
            let slope = boundary(&control_loop(estimator, delay), &[damping])[0] / damping;
            // Near the origin kp = kd/(T/2 + t_d), here with times in samples.
            assert!((slope * (0.5 + delay) - 1.0).abs() < 2e-3, "{estimator:?}, {delay}: {slope}");
        }
    }
}

#[test]
fn a_physical_damper_widens_the_range_at_both_rates() {
    // Colgate and Brown 1994: physical damping enlarges the range at slow and at fast rates.
    for rate_hz in [100.0, 1000.0] {
        let mut found = [0.0, 5.0].map(|damping| {
            let mut device = unit_mass();
            device.viscous[0] = damping;
            let around = Loop { rate_hz, ..control_loop(LinearEstimator::BackwardDifference, 0.0) };
            domain(&device, &around, Mode::Off, Some(&[])).unwrap().area
        });
        found[0] *= 1.0 + 1e-3;
        assert!(found[1] > found[0], "{rate_hz}: {found:?}");
    }
}

#[test]
fn a_mass_in_the_hand_scales_the_area_by_its_square() {
    let mut held_device = unit_mass();
    held_device.flexible.tip = DMatrix::from_element(1, 1, 1.0);
    held_device.flexible.normal = DVector::from_element(1, 1.0);
    held_device.flexible.hand = Hand { mass: 0.5, ..Hand::default() };
    let around = control_loop(LinearEstimator::Butterworth(100.0), 0.5);
    let area = |device: &Linearised| domain(device, &around, Mode::Off, Some(&[])).unwrap().area;
    assert!((area(&held_device) / area(&unit_mass()) / 1.5_f64.powi(2) - 1.0).abs() < 1e-6);
}
