//! The model agrees with independently computed cases: twenty random devices and motions of every mechanism.
//!
//! tests/golden/model.json was computed outside this repository, in the terms of `haptic model --json`. Required: 1e-9
//! of the largest entry in f64; in f32, with the board's own code, torques within 2e-4 of the largest.

use haptic::device_file::DeviceFile;
use haptic::model::{Precision, Report, WallForce, evaluate};
use haptic_bridge::model::catalogue::Kind;
use serde_json::Value;

mod golden;
use golden::{cases, list, number, worst};

const F64_TOLERANCE: f64 = 1.0e-9;
const F32_TOLERANCE: f64 = 2.0e-4;

fn mechanisms() -> impl Iterator<Item = &'static str> {
    Kind::ALL.iter().map(|kind| kind.spec().name)
}

fn computed(case: &Value, precision: Precision) -> Report {
    let device = DeviceFile::parse(golden::text(&case["device"]), golden::text(&case["id"])).expect("a sound device");
    let wall =
        WallForce { normal: list(&case["normal"]), force: number(&case["force"]), stiffness: 1.0, feed_forward: true };
    evaluate(&device, &list(&case["q"]), &list(&case["qd"]), &[wall], precision).expect("a regular pose")
}

fn flat(rows: &[Vec<f64>]) -> Vec<f64> {
    rows.concat()
}

#[test]
fn every_quantity_agrees_in_double_precision() {
    for mechanism in mechanisms() {
        let cases = cases("model.json", mechanism);
        assert_eq!(cases.len(), 20, "{mechanism}");
        for case in cases {
            let id = golden::text(&case["id"]);
            let report = computed(&case, Precision::F64);
            let expect = &case["expect"];
            let w_rr = list(&expect["w_rr"]);
            let quantities = [
                ("position", &report.position),
                ("jacobian", &flat(&report.jacobian)),
                ("mass", &flat(&report.mass)),
                ("bias", &report.bias),
                ("w_rr", &flat(&report.w_rr)),
                ("w_eff", &flat(&report.w_eff)),
                ("z_r", &report.z_r),
                ("f_a", &report.f_a),
                ("torque", &report.torque),
                ("torque_without_feed_forward", &report.torque_without_feed_forward),
            ];
            for (name, found) in quantities {
                let expected = list(&expect[name]);
                let error = worst(found, &expected, &expected);
                assert!(error <= F64_TOLERANCE, "{id}: {name} is {found:?}, not {expected:?} ({error:e})");
            }
            // A difference of two inertias: its digits are theirs.
            let coupling = worst(&flat(&report.coupling), &list(&expect["coupling"]), &w_rr);
            assert!(coupling <= F64_TOLERANCE, "{id}: coupling differs by {coupling:e}");
            let condition = number(&case["condition_jacobian"]);
            assert!((report.condition.jacobian / condition - 1.0).abs() < 1.0e-9, "{id}: {:?}", report.condition);
        }
    }
}

#[test]
fn the_boards_own_code_gives_the_torques_in_single_precision() {
    for mechanism in mechanisms() {
        for case in cases("model.json", mechanism) {
            let report = computed(&case, Precision::F32);
            for (name, found) in
                [("torque", &report.torque), ("torque_without_feed_forward", &report.torque_without_feed_forward)]
            {
                let expected = list(&case["expect"][name]);
                let error = worst(found, &expected, &expected);
                assert!(error <= F32_TOLERANCE, "{}: {name} is {found:?}, not {expected:?} ({error:e})", case["id"]);
            }
        }
    }
}

#[test]
fn weff_and_wrr_do_not_depend_on_the_side_of_the_wall() {
    for mechanism in mechanisms() {
        for case in cases("model.json", mechanism) {
            let device = DeviceFile::parse(golden::text(&case["device"]), "golden").expect("a sound device");
            let normal: Vec<f64> = list(&case["normal"]).iter().map(|entry| -entry).collect();
            let wall = WallForce { normal, force: -number(&case["force"]), stiffness: 1.0, feed_forward: true };
            let q = list(&case["q"]);
            let other_side = evaluate(&device, &q, &list(&case["qd"]), &[wall], Precision::F64).expect("regular");
            let expect = &case["expect"];
            for (name, found) in [
                ("w_eff", flat(&other_side.w_eff)),
                ("w_rr", flat(&other_side.w_rr)),
                ("torque", other_side.torque.clone()),
            ] {
                let expected = list(&expect[name]);
                assert!(worst(&found, &expected, &expected) <= F64_TOLERANCE, "{}: {name}", case["id"]);
            }
        }
    }
}
