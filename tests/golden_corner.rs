//! Two walls at once agree with independently computed cases: the torque of equation (4) in a corner.
//!
//! tests/golden/corner.json was computed outside this repository; each case has two walls whose forces act together.

use haptic::device_file::DeviceFile;
use haptic::model::{Precision, Report, WallForce, evaluate};
use haptic_bridge::model::catalogue::Kind;
use serde_json::Value;

mod golden;
use golden::{cases, list, text, worst};

fn computed(case: &Value, precision: Precision, swapped: bool) -> Report {
    let device = DeviceFile::parse(text(&case["device"]), text(&case["id"])).expect("a sound device");
    let normals = case["normals"].as_array().expect("a list of normals");
    let forces = list(&case["forces"]);
    let mut walls: Vec<WallForce> =
        normals.iter().zip(forces).map(|(normal, force)| WallForce { normal: list(normal), force }).collect();
    if swapped {
        walls.reverse();
    }
    evaluate(&device, &list(&case["q"]), &list(&case["qd"]), &walls, precision).expect("a regular pose")
}

fn errors(precision: Precision, swapped: bool) -> Vec<(String, f64)> {
    let mut errors = Vec::new();
    // A paddle moves along one line: it has no corners.
    for spec in Kind::ALL.iter().map(|kind| kind.spec()).filter(|spec| spec.task > 1) {
        let cases = cases("corner.json", spec.name);
        assert_eq!(cases.len(), 5, "{}", spec.name);
        for case in cases {
            let expected = list(&case["expect"]["torque"]);
            let error = worst(&computed(&case, precision, swapped).torque, &expected, &expected);
            errors.push((text(&case["id"]).to_string(), error));
        }
    }
    errors
}

#[test]
fn torques_in_a_corner_agree_in_double_precision() {
    for (id, error) in errors(Precision::F64, false) {
        assert!(error <= 1.0e-9, "{id}: {error:e}");
    }
}

#[test]
fn the_boards_own_code_agrees_in_single_precision() {
    for (id, error) in errors(Precision::F32, false) {
        assert!(error <= 2.0e-4, "{id}: {error:e}");
    }
}

#[test]
fn the_order_of_the_walls_does_not_matter() {
    for (id, error) in errors(Precision::F64, true) {
        assert!(error <= 1.0e-9, "{id}: {error:e}");
    }
}
