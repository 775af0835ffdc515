//! The predicted domains agree with independently computed domains (tests/golden/range.json).

use crate::common::domains::{self, Case, KnownDomain};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::range::domain;

#[test]
fn every_domain_agrees_with_independent_values() {
    for Case { id, file, q, normal, around, expected } in domains::all_cases() {
        let device = Linearised::at(&file.description, &q, &normal).unwrap();
        for (mode, KnownDomain { kd, kp, area, kd_max }) in expected {
            let key = format!("{mode:?}");
            let found = domain(&device, &around, mode, Some(&kd)).unwrap();
            let area = found.area / area - 1.0;
            assert!(area.abs() < 1e-6, "{id} {key}: area off by {area:e}");
            let dense: Vec<f64> = (0..=400).map(|i| found.kd_max * f64::from(i) / 400.0).collect();
            let dense = domain(&device, &around, mode, Some(&dense)).unwrap().boundary;
            let exact: f64 = dense.windows(2).map(|p| (p[1].kd - p[0].kd) * (p[0].kp + p[1].kp) / 2.0).sum();
            assert!((found.area / exact - 1.0).abs() < 2e-2, "{id} {key}: {} is not close to {exact}", found.area);
            let kd_max = found.kd_max / kd_max - 1.0;
            assert!(kd_max.abs() < 1e-7, "{id} {key}: kd_max off by {kd_max:e}");
            let largest = kp.iter().fold(0.0_f64, |a, b| a.max(*b));
            for (point, known) in found.boundary.iter().zip(&kp) {
                let off = (point.kp - known) / largest;
                assert!(off.abs() < 1e-6, "{id} {key} at kd = {}: kp off by {off:e} of the largest", point.kd);
            }
        }
    }
}
