//! Devices that are not ideal: transmissions that give, a hand on the tip, a difference over several samples
//! (docs/model.md section 4).

use crate::common::root;
use haptic_bridge::model::description::{EncoderAt, StructuralMode, Transmission};
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::flexible::{Flexible, Hand};
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::range::domain;
use haptic_stability::analysis::sampled::{AnalysisError, LinearEstimator, Loop, Mode};
use nalgebra::{DMatrix, DVector};
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn every_boundary_agrees_with_the_independent_one() {
    let path = root().join("tests/golden/real.json");
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 20);
    let mut points = 0;
    for case in cases {
        let id = case["id"].as_str().unwrap();
        let file = DeviceFile::parse(case["device"].as_str().unwrap(), id).unwrap();
        let device = Linearised::at(&file.description, &numbers(&case["q"]), &numbers(&case["normal"])).unwrap();
        let [mass, damping, stiffness] = numbers(&case["hand"])[..] else { panic!("{id}") };
        let device = device.held(Hand { mass, damping, stiffness });
        let samples = case["difference_over"].as_u64().unwrap() as usize;
        let around = Loop {
            rate_hz: case["rate"].as_f64().unwrap(),
            delay_samples: case["delay"].as_f64().unwrap(),
            estimator: LinearEstimator::Butterworth(case["cutoff"].as_f64().unwrap()).over(samples),
            drive: Drive::Ideal,
            damping_compensation: false,
        };
        for (mode, key) in [(Mode::Off, "off"), (Mode::Full, "full")] {
            let expected = case["expect"][key].as_array().unwrap();
            let kd: Vec<f64> = expected.iter().map(|point| point["kd"].as_f64().unwrap()).collect();
            let found = domain(&device, &around, mode, Some(&kd)).unwrap();
            let largest = expected.iter().map(|point| point["kp"].as_f64().unwrap()).fold(0.0, f64::max);
            for (point, known) in found.boundary.iter().zip(expected) {
                let known = known["kp"].as_f64().unwrap();
                points += 1;
                assert!(
                    (point.kp - known).abs() < 1e-4 * largest,
                    "{id} {key} at kd = {}: {} is not {known}",
                    point.kd,
                    point.kp
                );
            }
        }
    }
    assert!(points == 91, "{points}");
}

/// Two joints and a wall that both move.
fn rigid() -> Linearised {
    Linearised {
        gain: 1.0,
        flexible: Flexible::default(),
        mass: DMatrix::from_row_slice(2, 2, &[3.0e-4, 4.0e-5, 4.0e-5, 1.1e-4]),
        viscous: DVector::from_vec(vec![1e-3, 4e-4]),
        row: DVector::from_vec(vec![0.1, 0.06]),
        unit_motion: DVector::from_vec(vec![7.0, 5.0]),
    }
}

fn behind(stiffness: f64, damping: f64, encoder_at: EncoderAt) -> Option<Transmission> {
    Some(Transmission { stiffness, damping, motor_inertia: 2e-5, encoder_at })
}

fn around(rate_hz: f64, cutoff_hz: f64) -> Loop {
    Loop {
        rate_hz,
        delay_samples: 0.5,
        estimator: LinearEstimator::Butterworth(cutoff_hz),
        drive: Drive::Ideal,
        damping_compensation: false,
    }
}

#[test]
fn an_infinite_stiffness_is_rigid() {
    let stiff = rigid();
    for mode in [Mode::Off, Mode::Full, Mode::Washout(2.0)] {
        for (drive, stiffness) in
            [(Drive::Ideal, 1e11), (Drive::Current { bandwidth_hz: 900.0 }, 1e11), (Drive::Ideal, 1e18)]
        {
            let around = Loop { drive, ..around(1000.0, 50.0) };
            let known = domain(&stiff, &around, mode, None).unwrap();
            let mut soft = stiff.clone();
            // A hundredth of critical damping against the motor's inertia.
            let damping = 0.02 * (stiffness * 2e-5_f64).sqrt();
            soft.flexible.transmissions =
                vec![behind(stiffness, damping, EncoderAt::Motor), behind(stiffness, damping, EncoderAt::Joint)];
            let found = domain(&soft, &around, mode, None).unwrap();
            assert!((found.area / known.area - 1.0).abs() < 1e-9, "{mode:?}: {} {}", found.area, known.area);
            assert!((found.kd_max / known.kd_max - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn what_the_loop_neither_sees_nor_moves_does_not_count() {
    // Two joints that do not know each other, without any loss: a soft one that the wall does not see beside a rigid
    // one.
    let mut device = rigid();
    device.mass = DMatrix::from_diagonal(&DVector::from_vec(vec![3.0e-4, 1.1e-4]));
    device.viscous.fill(0.0);
    device.row = DVector::from_vec(vec![0.1, 0.0]);
    device.unit_motion = DVector::from_vec(vec![10.0, 0.0]);
    let around = around(1000.0, 50.0);
    for mode in [Mode::Off, Mode::Full] {
        let known = domain(&device, &around, mode, None).unwrap();
        let mut soft = device.clone();
        soft.flexible.transmissions = vec![None, behind(3.0, 0.0, EncoderAt::Motor)];
        let found = domain(&soft, &around, mode, None).unwrap();
        assert!(known.area > 0.0 && (found.area / known.area - 1.0).abs() < 1e-9, "{} {}", found.area, known.area);
    }
}

#[test]
fn a_mode_near_the_sampling_lowers_the_boundary_and_a_heavy_hand_raises_it() {
    let stiff = rigid();
    let around = around(1000.0, 50.0);
    let area = |device: &Linearised| domain(device, &around, Mode::Off, Some(&[])).unwrap().area;
    let mut soft = stiff.clone();
    soft.flexible.transmissions = vec![behind(3.0, 5e-4, EncoderAt::Joint); 2];
    assert!(area(&soft) < 0.5 * area(&stiff), "{} {}", area(&soft), area(&stiff));
    // A hand of nothing but mass, without loss, is what the device weighs more.
    let mut held = stiff.clone().undamped();
    held.flexible.tip = DMatrix::from_row_slice(1, 2, &[0.1, 0.06]);
    held.flexible.normal = DVector::from_vec(vec![1.0]);
    let alone = (area(&held), held.w_eff().unwrap());
    held.flexible.hand = Hand { mass: 0.1, ..Hand::default() };
    let heavier = ((alone.1 + 0.1) / alone.1).powi(2);
    assert!((area(&held) / alone.0 / heavier - 1.0).abs() < 1e-6, "{} {heavier}", area(&held) / alone.0);
}

#[test]
fn a_difference_over_several_samples_is_their_mean_and_more_than_64_are_refused() {
    let device = rigid();
    let mean = |samples| {
        let around = Loop { estimator: LinearEstimator::BackwardDifference.over(samples), ..around(1000.0, 50.0) };
        domain(&device, &around, Mode::Off, Some(&[])).map(|found| found.area)
    };
    let plain = Loop { estimator: LinearEstimator::BackwardDifference, ..around(1000.0, 50.0) };
    let plain = domain(&device, &plain, Mode::Off, Some(&[])).unwrap().area;
    assert!((mean(1).unwrap() / plain - 1.0).abs() < 1e-12);
    assert!(mean(4).unwrap() < 0.6 * plain);
    assert_eq!(mean(0), Err(AnalysisError::Difference(0)));
    assert_eq!(mean(65), Err(AnalysisError::Difference(65)));
}

#[test]
fn a_mode_of_the_only_joint_is_its_link_behind_a_transmission() {
    let mode = StructuralMode { frequency: 90.0, damping: 0.03, inertia: 4e-4 };
    let one = |flexible: Flexible| Linearised {
        gain: 1.0,
        flexible: Flexible { tip: DMatrix::from_element(1, 1, 0.1), normal: DVector::from_element(1, 1.0), ..flexible },
        mass: DMatrix::from_element(1, 1, 1e-3),
        viscous: DVector::from_element(1, 2e-4),
        row: DVector::from_element(1, 0.1),
        unit_motion: DVector::from_element(1, 10.0),
    };
    let swings = one(Flexible { modes: vec![(0, mode)], ..Flexible::default() });
    let give = Transmission {
        stiffness: mode.stiffness(),
        damping: mode.viscous(),
        motor_inertia: 6e-4,
        encoder_at: EncoderAt::Motor,
    };
    let soft = one(Flexible { transmissions: vec![Some(give)], ..Flexible::default() });
    for (rate, cutoff) in [(1000.0, 50.0), (5000.0, 200.0)] {
        let of = |device: &Linearised| domain(device, &around(rate, cutoff), Mode::Off, None).unwrap();
        let (left, right) = (of(&swings), of(&soft));
        assert!(right.area > 0.0 && (left.area / right.area - 1.0).abs() < 1e-9, "{} {}", left.area, right.area);
        let rigid = of(&one(Flexible::default()));
        // It may help: what swings on a damped spring is an absorber.
        assert!((left.area / rigid.area - 1.0).abs() > 0.05, "{} {}", left.area, rigid.area);
    }
}

#[test]
fn a_mode_of_any_frequency_or_no_inertia_to_speak_of_is_rigid_in_the_limit() {
    let stiff = rigid();
    let around = around(1000.0, 50.0);
    for (mode, close) in [
        (StructuralMode { frequency: 1e6, damping: 0.01, inertia: 4e-5 }, 1e-6),
        (StructuralMode { frequency: 1e9, damping: 0.01, inertia: 4e-5 }, 1e-9),
        (StructuralMode { frequency: 300.0, damping: 0.5, inertia: 1e-14 }, 1e-6),
    ] {
        let known = domain(&stiff, &around, Mode::Full, None).unwrap();
        let mut soft = stiff.clone();
        soft.flexible.modes = vec![(1, mode)];
        let found = domain(&soft, &around, Mode::Full, None).unwrap();
        assert!((found.area / known.area - 1.0).abs() < close, "{mode:?}: {} {}", found.area, known.area);
    }
}
