//! The rendered inertia of a redundant device depends on the admissible set, in the same way for all commands. The gain
//! of the feed-forward changes the inertia that a wall meets.

use crate::common::prelude::*;
use crate::common::{ideal_loop, shipped_device, type_lines};
use haptic_stability::analysis::map::map_holding;
use haptic_stability::analysis::range::predict;
use haptic_stability::model::{Precision, WallForce, evaluate_holding};

const NORMAL: [f64; 2] = [0.6, 0.8];

fn redundant_arm() -> DeviceFile {
    shipped_device("serial-3r")
}

fn control_loop(rate_hz: f64, cutoff_hz: f64) -> Loop {
    ideal_loop(rate_hz, 0.025, LinearEstimator::Butterworth(cutoff_hz))
}

#[test]
fn only_the_rendered_inertia_depends_on_the_admissible_set() {
    let arm = redundant_arm();
    let wall = [WallForce { normal: NORMAL.to_vec(), force: 2.0, stiffness: 1.0, feed_forward: true }];
    let mut effective = Vec::new();
    // The ratios come from an independent computation.
    for (admissible, ratio) in [
        (Admissible::Orientation, 3.99),
        (Admissible::Joint0, 1.29),
        (Admissible::Joint1, 1.26),
        (Admissible::Joint2, 2.38),
        (Admissible::Consistent, 1.22),
    ] {
        let q = [0.5, 0.8, 0.7];
        for precision in [Precision::F64, Precision::F32] {
            let tolerance = if precision == Precision::F32 { 2e-5 } else { 1e-10 };
            let model = evaluate_holding(&arm, &q, &[0.4, -0.3, 0.9], &wall, precision, admissible).unwrap();
            assert!((model.w_rr[0][0] / model.w_eff[0][0] - ratio).abs() < 0.006, "{admissible:?}: {:?}", model.w_rr);
            let range = Linearised::holding(&arm.description, &q, &NORMAL, admissible).unwrap();
            assert!((model.w_rr[0][0] / range.w_rr() - 1.0).abs() < tolerance, "{admissible:?}, {precision:?}");
            // By (1) with W in blocks, Wrr - Wra Waa⁻¹ War equals Weff for every choice of the third coordinate.
            let (a, b, c) = (model.w_aa[0][0], model.w_aa[0][1], model.w_aa[1][1]);
            let (x, y) = (model.w_ra[0][0], model.w_ra[0][1]);
            let schur = model.w_rr[0][0] - (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b);
            assert!((schur / model.w_eff[0][0] - 1.0).abs() < 50.0 * tolerance, "{admissible:?}: {schur}");
            if admissible == Admissible::Consistent {
                assert!(y.abs() < 10.0 * tolerance, "the wall couples to the null motion: {y}");
            }
            effective.push((model.w_eff[0][0], model.condition));
        }
    }
    let (first, condition) = effective[0];
    for (w_eff, other) in &effective {
        assert!((w_eff / first - 1.0).abs() < 1e-5 && (other.jacobian / condition.jacobian - 1.0).abs() < 1e-4);
    }
}

#[test]
fn the_map_depends_on_the_admissible_set() {
    let arm = redundant_arm();
    let maps = Admissible::ALL.map(|(name, admissible)| {
        let points = map_holding(&arm.description, &NORMAL, 400, admissible).unwrap();
        assert!(points.len() > 50, "{name}: {} poses", points.len());
        for point in &points {
            let model = Linearised::holding(&arm.description, &point.q, &NORMAL, admissible).unwrap();
            assert!(
                (point.w_rr / model.w_rr() - 1.0).abs() < 1e-9 && point.w_rr > point.w_eff * (1.0 - 1e-9),
                "{name}"
            );
        }
        points
    });
    // The map has no point at poses where holding the joint is singular.
    for points in &maps[1..] {
        let pairs: Vec<_> = points.iter().filter_map(|a| maps[0].iter().find(|b| a.q == b.q).map(|b| (a, b))).collect();
        assert!(10 * pairs.len() > 8 * maps[0].len(), "{} poses in common", pairs.len());
        assert!(pairs.iter().all(|(a, b)| (a.w_eff / b.w_eff - 1.0).abs() < 1e-6));
        assert!(pairs.iter().any(|(a, b)| (a.w_rr / b.w_rr - 1.0).abs() > 0.1), "the set has no effect");
    }
}

#[test]
fn the_stable_area_grows_with_the_square_of_the_inertia() {
    let arm = redundant_arm();
    for (admissible, area) in [(Admissible::Orientation, 15.9), (Admissible::Consistent, 1.49)] {
        let device = Linearised::holding(&arm.description, &[0.5, 0.8, 0.7], &NORMAL, admissible).unwrap().undamped();
        let found = predict(&device, &control_loop(1000.0, 100.0), None, None).unwrap().area_ratio;
        assert!((found / area - 1.0).abs() < 0.01, "{admissible:?}: {found}");
    }
}

#[test]
fn a_gain_of_two_makes_the_demos_wall_stiffer() {
    let five_bar = shipped_device("coupled-five-bar");
    let normal = [75.0_f64.to_radians().cos(), 75.0_f64.to_radians().sin()];
    let mut device = Linearised::at(&five_bar.description, &[2.6, 1.75], &normal).unwrap().undamped();
    // An independent computation has 22 994.941 N/m at gain 1, 29.9 kN/m and 0.357 kg at gain 2, and the pole at 4.9.
    for (gain, kilograms, stiffness) in [(1.0, 0.265, 22_994.941), (2.0, 0.357, 29_900.0)] {
        device.gain = gain;
        let range = predict(&device, &control_loop(1000.0, 100.0), Some(&[40.0]), None).unwrap();
        assert!((device.inertia_met().unwrap() - kilograms).abs() < 1e-3, "{gain}: {:?}", device.inertia_met());
        assert!((range.full.boundary[0].kp / stiffness - 1.0).abs() < 2e-3, "{gain}: {:?}", range.full.boundary);
        assert_eq!(range.off.boundary[0].kp.round(), 17_877.0);
    }
    let max_gain = device.largest_gain().unwrap();
    // The largest gain is half way from gain 1 to the pole.
    assert!((2.0 * max_gain - 1.0 - 4.9).abs() < 0.05, "{max_gain}");
    device.gain = 5.0;
    assert_eq!(device.inertia_met(), None);
    assert!(predict(&device, &control_loop(1000.0, 100.0), Some(&[40.0]), None).is_err());
}

#[test]
fn commands_take_a_gain_and_an_admissible_set() {
    type_lines(
        "range devices/coupled-five-bar.toml --q 2.6,1.75 --normal 0.2588,0.9659 --rate 1000 --cutoff 100 --kd 40 \
            --feed-forward-gain 2 => met with 2 times the feed-forward | its cost: 2 times
        2: range devices/coupled-five-bar.toml --normal 0.2588,0.9659 --q 2.6,1.75 --feed-forward-gain 4 => is not between 0 and 2.9
        model devices/serial-3r.toml --q 0.5,0.8,0.7 --normal 0.6,0.8 => with orientation held | \
            orientation 3.99 joint-0 1.29
        model devices/serial-3r.toml --q 0.5,0.8,0.7 --normal 0.6,0.8 --admissible consistent => with consistent held
        2: map devices/serial-3r.toml --normal 0.6,0.8 --points 200 --admissible elbow",
        &[],
    );
}
