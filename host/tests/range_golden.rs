//! The predicted domains agree with independently computed ones (tests/golden/range.json).

use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::range::domain;
use haptic::analysis::sampled::{Estimator, FeedForward, Loop};
use haptic::device_file::DeviceFile;
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn every_domain_agrees_with_the_independent_one() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/range.json");
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 20);
    for case in cases {
        let id = case["id"].as_str().unwrap();
        let file = DeviceFile::parse(case["device"].as_str().unwrap(), id).unwrap();
        let device = Linearised::at(&file.description, &numbers(&case["q"]), &numbers(&case["normal"])).unwrap();
        let around = Loop {
            rate_hz: case["rate"].as_f64().unwrap(),
            delay_samples: case["delay"].as_f64().unwrap(),
            estimator: Estimator::Butterworth(case["cutoff"].as_f64().unwrap()),
            drive: Drive::Ideal,
            damping_compensation: false,
        };
        for (mode, key) in [(FeedForward::Off, "off"), (FeedForward::Full, "full")] {
            let expected = &case["expect"][key];
            let points = expected["boundary"].as_array().unwrap();
            let kd: Vec<f64> = points.iter().map(|point| point["kd"].as_f64().unwrap()).collect();
            let kp: Vec<f64> = points.iter().map(|point| point["kp"].as_f64().unwrap()).collect();
            let found = domain(&device, &around, mode, Some(&kd)).unwrap();

            let area = found.area / expected["area"].as_f64().unwrap() - 1.0;
            assert!(area.abs() < 1e-6, "{id} {key}: area off by {area:e}");
            let dense: Vec<f64> = (0..=400).map(|i| found.kd_max * f64::from(i) / 400.0).collect();
            let dense = domain(&device, &around, mode, Some(&dense)).unwrap().boundary;
            let exact: f64 = dense.windows(2).map(|p| (p[1].kd - p[0].kd) * (p[0].kp + p[1].kp) / 2.0).sum();
            assert!((found.area / exact - 1.0).abs() < 2e-2, "{id} {key}: {} is no measure of {exact}", found.area);

            let kd_max = found.kd_max / expected["kd_max"].as_f64().unwrap() - 1.0;
            assert!(kd_max.abs() < 1e-7, "{id} {key}: kd_max off by {kd_max:e}");
            let largest = kp.iter().fold(0.0_f64, |a, b| a.max(*b));
            for (point, known) in found.boundary.iter().zip(&kp) {
                let off = (point.kp - known) / largest;
                assert!(off.abs() < 1e-6, "{id} {key} at kd = {}: kp off by {off:e} of the largest", point.kd);
            }
        }
    }
}
