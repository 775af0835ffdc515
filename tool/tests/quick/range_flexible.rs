//! Ranges with compliant transmissions, modes, a hand, and a difference over samples (docs/model.md section 4).

use crate::common::prelude::*;
use crate::common::{ideal_loop, numbers, read, rigid_device};
use haptic_bridge::model::description::StructuralMode;
use haptic_stability::analysis::flexible::{Flexible, Hand};

#[test]
fn every_boundary_agrees_with_independent_values() {
    let golden: Value = serde_json::from_str(&read("tests/golden/real.json")).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 20);
    let mut points = 0;
    for case in cases {
        let id = case["id"].as_str().unwrap();
        let file = DeviceFile::parse(case["device"].as_str().unwrap(), id).unwrap();
        let device = Linearised::at(&file.description, &numbers(&case["q"]), &numbers(&case["normal"])).unwrap();
        let [mass, damping, stiffness] = numbers(&case["hand"])[..] else { panic!("{id}") };
        let device = device.with_hand(Hand { mass, damping, stiffness });
        let samples = case["difference_over"].as_u64().unwrap() as usize;
        let [rate_hz, delay, cutoff] = ["rate", "delay", "cutoff"].map(|key| case[key].as_f64().unwrap());
        let around = ideal_loop(rate_hz, delay, LinearEstimator::Butterworth(cutoff).with_window(samples));
        for (mode, key) in [(Mode::Off, "off"), (Mode::Full, "full")] {
            let expected = case["expect"][key].as_array().unwrap();
            let kd: Vec<f64> = expected.iter().map(|point| point["kd"].as_f64().unwrap()).collect();
            let found = domain(&device, &around, mode, Some(&kd)).unwrap();
            let largest = expected.iter().map(|point| point["kp"].as_f64().unwrap()).fold(0.0, f64::max);
            for (point, known) in found.boundary.iter().zip(expected) {
                let known = known["kp"].as_f64().unwrap();
                points += 1;
                assert!((point.kp - known).abs() < 1e-4 * largest, "{id} {key}: {point:?} is not {known}");
            }
        }
    }
    assert!(points == 91, "{points}");
}

/// Returns a rigid device with two joints that both move the tip along the wall's normal.
fn stiff_device() -> Linearised {
    rigid_device(&[3.0e-4, 4.0e-5, 4.0e-5, 1.1e-4], &[1e-3, 4e-4], &[0.1, 0.06], &[7.0, 5.0])
}

fn transmission(stiffness: f64, damping: f64, encoder_at: EncoderAt) -> Option<Transmission> {
    Some(Transmission { stiffness, damping, motor_inertia: 2e-5, encoder_at })
}

fn control_loop(rate_hz: f64, cutoff_hz: f64) -> Loop {
    ideal_loop(rate_hz, 0.5, LinearEstimator::Butterworth(cutoff_hz))
}

#[test]
fn an_infinitely_stiff_transmission_is_rigid() {
    let stiff = stiff_device();
    for mode in [Mode::Off, Mode::Full, Mode::Washout(2.0)] {
        for (drive, stiffness) in
            [(Drive::Ideal, 1e11), (Drive::Current { bandwidth_hz: 900.0 }, 1e11), (Drive::Ideal, 1e18)]
        {
            let around = Loop { drive, ..control_loop(1000.0, 50.0) };
            let known = domain(&stiff, &around, mode, None).unwrap();
            let mut soft_device = stiff.clone();
            // The cable has a hundredth of the motor's critical damping.
            let damping = 0.02 * (stiffness * 2e-5_f64).sqrt();
            soft_device.flexible.transmissions = vec![
                transmission(stiffness, damping, EncoderAt::Motor),
                transmission(stiffness, damping, EncoderAt::Joint),
            ];
            let found = domain(&soft_device, &around, mode, None).unwrap();
            assert!((found.area / known.area - 1.0).abs() < 1e-9, "{mode:?}: {} {}", found.area, known.area);
            assert!((found.kd_max / known.kd_max - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn a_joint_outside_the_loop_has_no_effect() {
    // Neither joint has losses. The soft second joint is uncoupled and neither moves the tip nor renders the wall.
    let mut device = stiff_device();
    device.mass = DMatrix::from_diagonal(&DVector::from_vec(vec![3.0e-4, 1.1e-4]));
    device.viscous.fill(0.0);
    device.row = DVector::from_vec(vec![0.1, 0.0]);
    device.unit_motion = DVector::from_vec(vec![10.0, 0.0]);
    let around = control_loop(1000.0, 50.0);
    for mode in [Mode::Off, Mode::Full] {
        let known = domain(&device, &around, mode, None).unwrap();
        let mut soft_device = device.clone();
        soft_device.flexible.transmissions = vec![None, transmission(3.0, 0.0, EncoderAt::Motor)];
        let found = domain(&soft_device, &around, mode, None).unwrap();
        assert!(known.area > 0.0 && (found.area / known.area - 1.0).abs() < 1e-9, "{} {}", found.area, known.area);
    }
}

#[test]
fn a_fast_mode_lowers_the_boundary() {
    let stiff = stiff_device();
    let around = control_loop(1000.0, 50.0);
    let area = |device: &Linearised| domain(device, &around, Mode::Off, Some(&[])).unwrap().area;
    let mut soft_device = stiff.clone();
    soft_device.flexible.transmissions = vec![transmission(3.0, 5e-4, EncoderAt::Joint); 2];
    assert!(area(&soft_device) < 0.5 * area(&stiff), "{} {}", area(&soft_device), area(&stiff));
}

#[test]
fn a_difference_over_more_samples_lowers_the_boundary() {
    let device = stiff_device();
    let mean = |samples| {
        let estimator = LinearEstimator::BackwardDifference.with_window(samples);
        let around = Loop { estimator, ..control_loop(1000.0, 50.0) };
        domain(&device, &around, Mode::Off, Some(&[])).map(|found| found.area)
    };
    let estimator_loop = Loop { estimator: LinearEstimator::BackwardDifference, ..control_loop(1000.0, 50.0) };
    let backward_area = domain(&device, &estimator_loop, Mode::Off, Some(&[])).unwrap().area;
    assert!((mean(1).unwrap() / backward_area - 1.0).abs() < 1e-12);
    assert!(mean(4).unwrap() < 0.6 * backward_area);
}

#[test]
fn a_mode_of_one_joint_equals_a_link_behind_a_transmission() {
    let mode = StructuralMode { frequency: 90.0, damping: 0.03, inertia: 4e-4 };
    let one = |flexible: Flexible| Linearised {
        flexible: Flexible { tip: DMatrix::from_element(1, 1, 0.1), normal: DVector::from_element(1, 1.0), ..flexible },
        ..rigid_device(&[1e-3], &[2e-4], &[0.1], &[10.0])
    };
    let swings = one(Flexible { modes: vec![(0, mode)], ..Flexible::default() });
    let give = Transmission {
        stiffness: mode.stiffness(),
        damping: mode.viscous(),
        motor_inertia: 6e-4,
        encoder_at: EncoderAt::Motor,
    };
    let soft_device = one(Flexible { transmissions: vec![Some(give)], ..Flexible::default() });
    for (rate, cutoff) in [(1000.0, 50.0), (5000.0, 200.0)] {
        let of = |device: &Linearised| domain(device, &control_loop(rate, cutoff), Mode::Off, None).unwrap();
        let (left, right) = (of(&swings), of(&soft_device));
        assert!(right.area > 0.0 && (left.area / right.area - 1.0).abs() < 1e-9, "{} {}", left.area, right.area);
        let rigid = of(&one(Flexible::default()));
        // The mode may enlarge or reduce the area, because a mass on a damped spring absorbs vibration.
        assert!((left.area / rigid.area - 1.0).abs() > 0.05, "{} {}", left.area, rigid.area);
    }
}

#[test]
fn a_very_fast_or_very_light_mode_is_rigid() {
    let stiff = stiff_device();
    let around = control_loop(1000.0, 50.0);
    for (mode, close) in [
        (StructuralMode { frequency: 1e6, damping: 0.01, inertia: 4e-5 }, 1e-6),
        (StructuralMode { frequency: 1e9, damping: 0.01, inertia: 4e-5 }, 1e-9),
        (StructuralMode { frequency: 300.0, damping: 0.5, inertia: 1e-14 }, 1e-6),
    ] {
        let known = domain(&stiff, &around, Mode::Full, None).unwrap();
        let mut soft_device = stiff.clone();
        soft_device.flexible.modes = vec![(1, mode)];
        let found = domain(&soft_device, &around, Mode::Full, None).unwrap();
        assert!((found.area / known.area - 1.0).abs() < close, "{mode:?}: {} {}", found.area, known.area);
    }
}
