//! `haptic range` of several walls on a device with cables or in a hand: one wall given twice equals the wall, stiff
//! cables equal rigid ones, and the boundary agrees with a loop built from M and J with motors and hand as bodies.

use crate::common::oracle::{Bodies, CUTOFF, RATE};
use crate::common::prelude::*;
use crate::common::{ideal_loop, shipped};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::range::domain_of_several;
use haptic_stability::analysis::several::WallSet;

const HAND: Hand = Hand { mass: 0.1, damping: 4.0, stiffness: 250.0 };

fn around() -> Loop {
    ideal_loop(RATE, 1.0, LinearEstimator::Butterworth(CUTOFF))
}

/// A shipped device. With `hz`, every joint has a cable of that frequency against its motor. The motor side has all of
/// the joint's inertia, or 0.3 of it on the first joint of a spatial device.
fn device(name: &str, hz: Option<f64>) -> DeviceFile {
    let mut file = shipped(name);
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

/// Device, pose, normals with their parts, damping.
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

/// kp_max at these dampings.
fn boundary(set: &WallSet, mode: Mode, kd: &[f64]) -> Vec<f64> {
    let found = domain_of_several(set, &around(), mode, Some(kd)).unwrap();
    found.boundary.iter().map(|point| point.kp).collect()
}

#[test]
fn one_wall_given_twice_equals_it_with_cables_and_hand() {
    for (name, q, normal) in [
        ("coupled-five-bar", &[2.6, 1.75][..], vec![0.26, 0.97]),
        ("woodenhaptics", &[0.0, 1.3, -0.2], vec![0.6, 0.8, 0.1]),
    ] {
        for (hz, hand) in [(Some(150.0), Hand::default()), (None, HAND), (Some(150.0), HAND)] {
            let file = device(name, hz);
            let walls = [Member::new(normal.clone(), 0.3), Member::new(normal.clone(), 0.7)];
            let set = WallSet::at(&file.description, q, &walls, Admissible::default()).unwrap().held(hand);
            let alone = Linearised::at(&file.description, q, &normal).unwrap().held(hand);
            for mode in [Mode::Off, Mode::Full, Mode::Washout(2.0)] {
                let kd = [1.0, 6.0, 12.0];
                let known = domain(&alone, &around(), mode, Some(&kd)).unwrap();
                let largest = known.boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
                for (found, known) in boundary(&set, mode, &kd).into_iter().zip(known.boundary) {
                    // Bisection of a growth of 1e-11 a sample.
                    let off = (found - known.kp) / largest;
                    assert!(off.abs() < 1e-5, "{name} {hz:?} {hand:?} {mode:?}: {found} is not {known:?}");
                }
            }
        }
    }
}

#[test]
fn stiff_cables_equal_rigid_ones() {
    for (name, q, walls, kd) in WALL_SETS {
        let of = |hz| {
            let set = WallSet::at(&device(name, hz).description, q, &members(walls), Admissible::default()).unwrap();
            [Mode::Off, Mode::Full].map(|mode| boundary(&set, mode, &[kd])[0])
        };
        let rigid = of(None);
        // The effect of a cable falls with the square of its frequency.
        for (hz, within) in [(2e4, 1e-2), (2e5, 1e-4), (1e9, 1e-9)] {
            for (found, rigid) in of(Some(hz)).into_iter().zip(rigid) {
                assert!(
                    (found / rigid - 1.0).abs() < within,
                    "{name}: {found} with cables of {hz} Hz, {rigid} without"
                );
            }
        }
    }
}

/// The bodies of a device with cables or in a hand.
fn bodies(file: &DeviceFile, q: &[f64], hand: Hand, torques: DMatrix<f64>) -> Bodies {
    let mechanism = AnyMechanism::new(&file.description).unwrap();
    let pose = TaskPose::of(&mechanism, q).unwrap();
    let (n, tip) = (q.len(), pose.jacobian.rows(0, pose.task).into_owned());
    let joints = &file.description.joints[..n];
    let cables = joints.iter().any(|joint| joint.transmission.is_some());
    let all = if cables { 2 * n } else { n };
    let square = tip.tr_mul(&tip);
    let mut bodies = Bodies {
        mass: DMatrix::zeros(all, all),
        damping: DMatrix::zeros(all, all),
        stiffness: DMatrix::zeros(all, all),
        seen: DMatrix::zeros(tip.nrows(), all),
        driven: DMatrix::zeros(all, n),
        torques,
    };
    let links = &pose.mass + &square * hand.mass;
    bodies.mass.view_mut((0, 0), (n, n)).copy_from(&links);
    bodies.damping.view_mut((0, 0), (n, n)).copy_from(&(&square * hand.damping));
    bodies.stiffness.view_mut((0, 0), (n, n)).copy_from(&(&square * hand.stiffness));
    for (j, joint) in joints.iter().enumerate() {
        let motor = if cables { n + j } else { j };
        if let Some(cable) = joint.transmission {
            bodies.mass[(j, j)] -= cable.motor_inertia;
            bodies.mass[(motor, motor)] = cable.motor_inertia;
            for (a, b, sign) in [(j, j, 1.0), (motor, motor, 1.0), (j, motor, -1.0), (motor, j, -1.0)] {
                bodies.damping[(a, b)] += sign * cable.damping;
                bodies.stiffness[(a, b)] += sign * cable.stiffness;
            }
        }
        bodies.damping[(motor, motor)] += joint.viscous;
        bodies.driven[(motor, j)] = 1.0;
        bodies.seen.set_column(motor, &tip.column(j));
    }
    bodies
}

#[test]
fn wall_sets_with_cables_and_hands_agree_with_loops_of_bodies() {
    for (name, q, walls, kd) in WALL_SETS {
        for (hz, hand) in [(None, HAND), (Some(150.0), Hand::default()), (Some(150.0), HAND)] {
            let file = device(name, hz);
            let set = WallSet::at(&file.description, q, &members(walls), Admissible::default()).unwrap();
            let task = file.spec().task;
            for (mode, feed_forward) in [(Mode::Off, false), (Mode::Full, true)] {
                // The law of several walls is held elsewhere (tests/several_walls); here it is a matrix.
                let unit = |axis: usize| DVector::from_fn(task, |i, _| f64::from(u8::from(i == axis)));
                let torques: Vec<_> = (0..task).map(|axis| set.torque(&unit(axis), feed_forward)).collect();
                let bodies = bodies(&file, q, hand, DMatrix::from_columns(&torques));
                let kp = boundary(&set.clone().held(hand), mode, &[kd])[0];
                assert!(kp > 0.0, "{name} {mode:?}: nothing is stable at {kd} N s/m");
                let (below, above) = (bodies.radius(kp * 0.999, kd), bodies.radius(kp * 1.001, kd));
                assert!(below < 1.0 && above > 1.0, "{name} {hz:?} {hand:?} {mode:?}: {below}, {above} about {kp} N/m");
            }
        }
    }
}
