//! `haptic range` of several walls on a compliant device in a hand. One wall given twice equals the wall, infinitely
//! stiff cables equal no cables, and sets of walls have the limits of loops of separate motors, links and a hand.

use crate::common::bodies::{Bodies, CUTOFF_HZ, RATE_HZ};
use crate::common::prelude::*;
use crate::common::{ideal_loop, shipped_device};
use haptic_stability::analysis::control_loop::Mode;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::range::domain_of_several;
use haptic_stability::analysis::several::WallSet;

const HAND: Hand = Hand { mass: 0.1, damping: 4.0, stiffness: 250.0 };

fn control_loop() -> Loop {
    ideal_loop(RATE_HZ, 1.0, LinearEstimator::Butterworth(CUTOFF_HZ))
}

/// Returns a shipped device. With `hz` every joint has a cable, on which its motor has this natural frequency, Hz. The
/// motor has all of the joint's inertia, or 0.3 of the inertia of a turret.
fn device_with_cables(name: &str, hz: Option<f64>) -> DeviceFile {
    let mut file = shipped_device(name);
    let spec = file.spec();
    for (index, joint) in file.description.joints[..spec.joints].iter_mut().enumerate() {
        let share = if spec.task == 3 && index == 0 { 0.3 } else { 1.0 };
        joint.transmission = hz.map(|hz| {
            let motor_inertia = share * joint.inertia;
            let stiffness = motor_inertia * (std::f64::consts::TAU * hz).powi(2);
            let damping = 0.1 * (stiffness * motor_inertia).sqrt();
            Transmission { stiffness, damping, motor_inertia, encoder_at: EncoderAt::Motor }
        });
    }
    file
}

/// Device, joint angles, rad, normals with their shares of the stiffness, damping, N s/m.
type WallSetCase = (&'static str, &'static [f64], &'static [(&'static [f64], f64)], f64);

const WALL_SETS: [WallSetCase; 3] = [
    ("coupled-five-bar", &[2.6, 1.75], &[(&[0.97, 0.24], 3.0), (&[0.24, -0.97], 1.0)], 10.0),
    ("coupled-five-bar", &[2.6, 1.75], &[(&[0.2419219, 0.9702957], 1.0), (&[0.3255682, 0.9455186], 1.0)], 10.0),
    (
        "phantom-premium-1.5",
        &[0.3, 0.9, -0.3],
        &[(&[0.6, 0.8, 0.0], 1.0), (&[0.0, 0.6, 0.8], 0.5), (&[1.0, 0.0, 0.2], 0.2)],
        2.0,
    ),
];

fn members(walls: &[(&[f64], f64)]) -> Vec<Member> {
    walls.iter().map(|(normal, share)| Member::new(normal.to_vec(), *share)).collect()
}

/// Returns kp_max (N/m) at these dampings (N s/m).
fn boundary(set: &WallSet, mode: Mode, kd: &[f64]) -> Vec<f64> {
    let found = domain_of_several(set, &control_loop(), mode, Some(kd)).unwrap();
    found.boundary.iter().map(|point| point.kp).collect()
}

#[test]
fn one_wall_given_twice_equals_the_wall_with_cables_and_hand() {
    for (name, q, normal) in [
        ("coupled-five-bar", &[2.6, 1.75][..], vec![0.26, 0.97]),
        ("woodenhaptics", &[0.0, 1.3, -0.2], vec![0.6, 0.8, 0.1]),
    ] {
        for (hz, hand) in [(Some(150.0), Hand::default()), (None, HAND), (Some(150.0), HAND)] {
            let file = device_with_cables(name, hz);
            let walls = [Member::new(normal.clone(), 0.3), Member::new(normal.clone(), 0.7)];
            let set = WallSet::at(&file.description, q, &walls, Admissible::default()).unwrap().with_hand(hand);
            let alone = Linearised::at(&file.description, q, &normal).unwrap().with_hand(hand);
            for mode in [Mode::Off, Mode::Full, Mode::Washout(2.0)] {
                let kd = [1.0, 6.0, 12.0];
                let known = domain(&alone, &control_loop(), mode, Some(&kd)).unwrap();
                let largest = known.boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
                for (found, known) in boundary(&set, mode, &kd).into_iter().zip(known.boundary) {
                    // The limit is bisected to a growth of 1e-11 per sample.
                    let off = (found - known.kp) / largest;
                    assert!(off.abs() < 1e-5, "{name} {hz:?} {hand:?} {mode:?}: {found} is not {known:?}");
                }
            }
        }
    }
}

#[test]
fn very_stiff_cables_equal_rigid_transmissions() {
    for (name, q, walls, kd) in WALL_SETS {
        let of = |hz| {
            let set = WallSet::at(&device_with_cables(name, hz).description, q, &members(walls), Admissible::default())
                .unwrap();
            [Mode::Off, Mode::Full].map(|mode| boundary(&set, mode, &[kd])[0])
        };
        let rigid = of(None);
        // The effect of a cable falls with the square of its frequency.
        for (hz, within) in [(2e4, 1e-2), (2e5, 1e-4), (1e9, 1e-9)] {
            for (found, rigid) in of(Some(hz)).into_iter().zip(rigid) {
                assert!((found / rigid - 1.0).abs() < within, "{name}: {found} with cables of {hz} Hz, not {rigid}");
            }
        }
    }
}

#[test]
fn sets_of_walls_have_the_limits_of_loops_of_bodies() {
    for (name, q, walls, kd) in WALL_SETS {
        for (hz, hand) in [(None, HAND), (Some(150.0), Hand::default()), (Some(150.0), HAND)] {
            let file = device_with_cables(name, hz);
            let set = WallSet::at(&file.description, q, &members(walls), Admissible::default()).unwrap();
            let task = file.spec().task;
            for (mode, feed_forward) in [(Mode::Off, false), (Mode::Full, true)] {
                // The law of several walls, which tests/several_walls checks, is a matrix here.
                let unit = |axis: usize| DVector::from_fn(task, |i, _| f64::from(u8::from(i == axis)));
                let torques: Vec<_> = (0..task).map(|axis| set.torque(&unit(axis), feed_forward)).collect();
                let bodies = Bodies::new(&file, q, hand, DMatrix::from_columns(&torques));
                let kp = boundary(&set.clone().with_hand(hand), mode, &[kd])[0];
                bodies.assert_limit(kp, kd, &format!("{name} {hz:?} {hand:?} {mode:?}"));
            }
        }
    }
}
