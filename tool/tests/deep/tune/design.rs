//! `haptic design` agrees with formulas and exhaustive searches.

use crate::common::prelude::*;
use crate::common::shipped_device;
use haptic_predict::design::place::places;
use haptic_predict::design::posture::postures;
use haptic_predict::design::sensitivity::{CHANGE, buys_most, sensitivities};
use haptic_predict::design::{clearance, within_limits};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::map::effective_inertias;
use haptic_stability::analysis::pose::{TaskPose, unit_normal};

const ADMISSIBLE_SET: Admissible = Admissible::Orientation;

fn control_loop() -> Loop {
    Loop::with_torque_path(&TorquePath::usual(20_000.0), 20_000.0, LinearEstimator::Butterworth(500.0))
}

#[test]
fn the_stiffest_wall_is_proportional_to_its_inertia() {
    let around = control_loop();
    let mut kilogram = Linearised::at(&shipped_device("hapkit-paddle").description, &[0.0], &[1.0]).unwrap().undamped();
    kilogram.flexible = Default::default();
    let per_kilogram = domain(&kilogram, &around, Mode::Off, None).unwrap().top.kp / kilogram.w_rr();
    for (name, q, n) in [
        ("coupled-five-bar", vec![2.6, 1.75], vec![0.94, -0.34]),
        ("phantom-premium-1.5", vec![0.3, 0.9, -0.3], vec![0.6, 0.8, 0.0]),
    ] {
        let device = Linearised::at(&shipped_device(name).description, &q, &n).unwrap().undamped();
        for (mode, met) in [(Mode::Off, device.w_eff().unwrap()), (Mode::Full, device.w_rr())] {
            let range = domain(&device, &around, mode, None).unwrap();
            let top = range.top.kp;
            assert!((top / (per_kilogram * met) - 1.0).abs() < 1e-6, "{name}, {mode:?}: {top}");
        }
    }
}

/// An inertia δ at joint j raises Wrr = Eᵀ M E by δ Eⱼ². Weff = 1/(Jr M⁻¹ Jrᵀ) follows from Sherman and Morrison.
#[test]
fn the_sensitivity_to_a_rotor_follows_its_formula() {
    for (name, q, n) in [
        ("coupled-five-bar", vec![2.6, 1.75], vec![0.94, -0.34]),
        ("phantom-premium-1.5", vec![0.3, 0.9, -0.3], vec![0.6, 0.5, 0.62]),
        ("serial-3r", vec![0.5, 0.8, 0.7], vec![0.6, 0.8]),
    ] {
        let description = shipped_device(name).description;
        let device = Linearised::at(&description, &q, &n).unwrap();
        let mobility = device.mass.clone().try_inverse().unwrap();
        let found = sensitivities(&description, &q, &n, ADMISSIBLE_SET, &control_loop()).unwrap();
        for j in 0..q.len() {
            let change = CHANGE * description.joints[j].inertia;
            let pull = (&mobility * &device.row)[j];
            let mobile = 1.0 / device.w_eff().unwrap();
            let w_eff = mobile / (mobile - change * pull * pull / (1.0 + change * mobility[(j, j)]));
            let w_rr = 1.0 + change * device.unit_motion[j].powi(2) / device.w_rr();
            let rotor = found.iter().find(|one| one.part == format!("rotor of joint {j}")).unwrap().more.unwrap();
            assert!((rotor.w_eff / w_eff - 1.0).abs() < 1e-9, "{name}, joint {j}: {rotor:?}, {w_eff}");
            assert!((rotor.w_rr / w_rr - 1.0).abs() < 1e-9, "{name}, joint {j}: {rotor:?}, {w_rr}");
            // A gear multiplies the rotor's inertia by the square of its ratio, and torque and counts by its ratio.
            let gear = found.iter().find(|one| one.part == format!("gear ratio of joint {j}")).unwrap().more.unwrap();
            let squared = 1.0 + 2.1 * (w_rr - 1.0);
            assert!((gear.w_rr / squared - 1.0).abs() < 1e-9, "{name}, joint {j}: {gear:?}");
        }
        let best_change = buys_most(&found, |effect| effect.w_rr).unwrap();
        assert_eq!(buys_most(&found, |effect| 1.0 + 0.005 * effect.w_rr.signum()), None);
        let sides = found.iter().flat_map(|one| [one.more, one.less]).flatten();
        assert!(sides.into_iter().all(|effect| effect.w_rr <= best_change.effect.w_rr));
    }
}

#[test]
fn a_longer_link_leaves_the_tip_where_it_is() {
    let description = shipped_device("haply-2diy").description;
    let (q, n) = ([2.3, 0.84159265358979], [0.6, 0.8]);
    let found = sensitivities(&description, &q, &n, ADMISSIBLE_SET, &control_loop()).unwrap();
    let base = found.iter().find(|one| one.part == "length base").unwrap().more.unwrap();
    // The test's own inverse kinematics move the tip of the wider device to its former place.
    let mut wider = description;
    wider.geometry[0] *= 1.0 + CHANGE;
    let before = TaskPose::at(&description, &q).unwrap();
    let (x, y) = (before.position[0], before.position[1]);
    let elbow = |side: f64| {
        let [base, l1, l2, r1, r2, ..] = wider.geometry;
        let (proximal, distal) = if side < 0.0 { (l1, r1) } else { (l2, r2) };
        let (dx, dy) = (x - side * base / 2.0, y);
        let reach = dx.hypot(dy);
        let inside = ((proximal * proximal + reach * reach - distal * distal) / (2.0 * proximal * reach)).acos();
        // The elbows point outwards.
        dy.atan2(dx) - side * inside
    };
    let wider_pose = TaskPose::at(&wider, &[elbow(-1.0), elbow(1.0)]).unwrap();
    assert!((wider_pose.position[0] - x).abs() < 1e-12 && (wider_pose.position[1] - y).abs() < 1e-12);
    let normal = unit_normal(&n, 2, 2).unwrap();
    let ((a, b), (c, d)) =
        (effective_inertias(&before, &normal).unwrap(), effective_inertias(&wider_pose, &normal).unwrap());
    assert!((base.w_eff / (c / a) - 1.0).abs() < 1e-9 && (base.w_rr / (d / b) - 1.0).abs() < 1e-9, "{base:?}");
}

#[test]
fn no_pose_of_a_random_search_is_better_than_the_best() {
    let normal = [0.6, 0.8];
    for name in ["haply-2diy", "coupled-five-bar"] {
        let file = shipped_device(name);
        let clear = 0.4;
        let found = places(&file.description, Some(&normal), 0.0, clear, 700, ADMISSIBLE_SET, &Sweep::quiet()).unwrap();
        let device = file.device::<f64>().unwrap();
        let n = unit_normal(&normal, 2, file.spec().joints).unwrap();
        let along_n = found.along.clone().unwrap();
        // Only poses on the same side of the singularities as home are valid.
        let side = |q: &[f64]| TaskPose::at(&file.description, q).unwrap().jacobian.determinant() > 0.0;
        let home = file.description.home.unwrap();
        let home = side(&home[..file.spec().joints]);
        let mut random = Random::new(7);
        let mut tried = 0;
        for _ in 0..10_000 {
            let q: Vec<f64> = (0..file.spec().joints).map(|_| random.between(-3.1, 3.1)).collect();
            let Ok(pose) = TaskPose::at(&file.description, &q).unwrap().regular() else { continue };
            if clearance(&pose) < clear || !within_limits(&device, &q) || side(&q) != home {
                continue;
            }
            tried += 1;
            let (w_eff, w_rr) = effective_inertias(&pose, &n).unwrap();
            assert!(w_eff <= along_n.off.w_eff * 1.01, "{name}: {w_eff} kg at {q:?}, {:?}", along_n.off);
            assert!(w_rr <= along_n.full.w_rr * 1.01, "{name}: {w_rr} kg at {q:?}, {:?}", along_n.full);
            assert!(w_eff >= along_n.worst.w_eff * 0.99, "{name}: {w_eff} kg at {q:?}, {:?}", along_n.worst);
            for angle in [0.0_f64, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0] {
                let other_normal = unit_normal(&[angle.cos(), angle.sin()], 2, q.len()).unwrap();
                let (w_eff, w_rr) = effective_inertias(&pose, &other_normal).unwrap();
                assert!(w_eff <= found.stiffest.w_eff * 1.01, "{name}: {w_eff} kg at {q:?}");
                let ratio = found.feed_forward_buys_most.w_rr / found.feed_forward_buys_most.w_eff;
                assert!(w_rr / w_eff <= ratio * 1.01, "{name}: {} at {q:?}, {ratio}", w_rr / w_eff);
            }
        }
        assert!(tried > 300, "{name}: {tried}");
    }
}

#[test]
fn a_coarse_grid_has_the_results_of_a_fine_grid() {
    for (name, coarse, fine) in [("coupled-five-bar", 300, 4000), ("haply-2diy", 300, 1000), ("serial-3r", 700, 1000)] {
        let description = shipped_device(name).description;
        let found = |points| places(&description, None, 0.0, 0.3, points, ADMISSIBLE_SET, &Sweep::quiet()).unwrap();
        let (coarse, fine) = (found(coarse), found(fine));
        for found in [&coarse, &fine] {
            let others = [&found.every_direction, &found.feed_forward_buys_most];
            let stiffer = others.into_iter().find(|other| other.w_rr > 1.01 * found.stiffest.w_eff);
            assert_eq!(stiffer, None, "{name}: with the feed-forward this is stiffer than the stiffest");
        }
        let ratio = |placed: &haptic_predict::design::place::WallPlace| placed.w_rr / placed.w_eff;
        for (what, one, other) in [
            ("stiffest", coarse.stiffest.w_eff, fine.stiffest.w_eff),
            ("every direction", coarse.every_direction.w_eff, fine.every_direction.w_eff),
            ("buys most", ratio(&coarse.feed_forward_buys_most), ratio(&fine.feed_forward_buys_most)),
        ] {
            assert!((one / other - 1.0).abs() < 0.01, "{name}, {what}: {one} on a coarse grid, {other} on a fine grid");
        }
    }
}

#[test]
fn a_wide_wall_is_placed_by_its_worst_point() {
    let file = shipped_device("haply-2diy");
    let place_patch = |patch: f64| {
        places(&file.description, Some(&[0.6, 0.8]), patch, 0.4, 700, ADMISSIBLE_SET, &Sweep::quiet())
            .unwrap()
            .along
            .unwrap()
    };
    let (point, wide) = (place_patch(0.0), place_patch(0.02));
    assert!(wide.off.w_eff < 0.99 * point.off.w_eff && wide.full.w_rr < point.full.w_rr, "{point:?} {wide:?}");
}

/// The test's own inverse kinematics compute wrist and elbow (on the arm's side) for every orientation of the tip.
#[test]
fn the_best_posture_equals_the_best_of_all_orientations() {
    let file = shipped_device("serial-3r");
    let (q, n, clear) = ([0.5_f64, 0.8, 0.7], [0.6, 0.8], 0.38);
    let found = postures(&file.description, &q, &n, clear, ADMISSIBLE_SET).unwrap().unwrap();
    let [l1, l2, l3, ..] = file.description.geometry;
    let tip = TaskPose::at(&file.description, &q).unwrap().position;
    let normal = unit_normal(&n, 2, 3).unwrap();
    let (mut max_eff, mut min_eff, mut max_rr, mut min_rr) = (0.0_f64, f64::INFINITY, 0.0_f64, f64::INFINITY);
    for i in 0..20_000 {
        let phi = std::f64::consts::TAU * f64::from(i) / 20_000.0;
        let (x, y) = (tip[0] - l3 * phi.cos(), tip[1] - l3 * phi.sin());
        let cosine = (x * x + y * y - l1 * l1 - l2 * l2) / (2.0 * l1 * l2);
        if cosine.abs() > 1.0 {
            continue;
        }
        let elbow = cosine.acos();
        let shoulder = y.atan2(x) - (l2 * elbow.sin()).atan2(l1 + l2 * elbow.cos());
        let pose = TaskPose::at(&file.description, &[shoulder, elbow, phi - shoulder - elbow]).unwrap();
        assert!((pose.position[0] - tip[0]).abs() < 1e-9);
        if clearance(&pose) < clear {
            continue;
        }
        let (w_eff, w_rr) = effective_inertias(&pose, &normal).unwrap();
        (max_eff, min_eff) = (max_eff.max(w_eff), min_eff.min(w_eff));
        (max_rr, min_rr) = (max_rr.max(w_rr), min_rr.min(w_rr));
    }
    for (one, other) in [
        (found.heaviest.w_eff, max_eff),
        (found.lightest.w_eff, min_eff),
        (found.most_held.w_rr, max_rr),
        (found.least_held.w_rr, min_rr),
    ] {
        assert!((one / other - 1.0).abs() < 0.02, "{one} kg, but {other} kg in the scan");
    }
    // An independent sweep at this tip in coarser steps, with its own limit on the sine at singularities, has Weff of
    // 0.0487 to 0.1139 kg and Wrr of 0.117 to 0.506 kg.
    assert!((max_eff / 0.1139 - 1.0).abs() < 0.01 && (min_eff / 0.0487 - 1.0).abs() < 0.04, "{max_eff} {min_eff}");
    assert!((min_rr / 0.117 - 1.0).abs() < 0.01 && (max_rr / 0.506 - 1.0).abs() < 0.06, "{max_rr} {min_rr}");
    assert_eq!(postures(&shipped_device("haply-2diy").description, &[2.3, 0.84], &n, clear, ADMISSIBLE_SET), Ok(None));
}
