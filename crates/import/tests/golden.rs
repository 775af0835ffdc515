//! Device files from URDF and MJCF agree with independently computed cases (cases.json): the tip, its Jacobian, mass
//! matrix, bias (Coriolis, centrifugal and weight) and the torques of a wall, within 1e-9 of the largest entry.
//!
//! The reference model here reads the text of the device file. It does not use the product's model.

use haptic_import::{Selection, convert};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Translation3, Unit, UnitQuaternion, Vector3};
use serde_json::Value as Json;
use toml::{Table, Value};

/// True for a prismatic joint, the joint's direction and its place, m.
type Axis = (bool, Vector3<f64>, Vector3<f64>);

const TOLERANCE: f64 = 1e-9;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|value| value.as_float().expect("a float")).collect()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_vec(numbers(value))
}

/// Results of the reference model.
struct Motion {
    tip: Vector3<f64>,
    /// Acceleration of the tip without joint acceleration, J̇ q̇.
    tip_acceleration: Vector3<f64>,
    jacobian: DMatrix<f64>,
    mass: DMatrix<f64>,
    bias: DVector<f64>,
}

/// Computes the chain of a device file by sums over its links.
fn motion(file: &Table, q: &[f64], qd: &[f64]) -> Motion {
    let (links, joints) = (file["link"].as_array().unwrap(), file["joint"].as_array().unwrap());
    let n = joints.len();
    let gravity = vector(&file["gravity"]);
    let (mut frame, mut axes) = (Isometry3::identity(), Vec::<Axis>::new());
    let (mut w, mut dw, mut a) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    let (mut mass, mut bias) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let columns = |axes: &[(bool, Vector3<f64>, Vector3<f64>)], point: &Vector3<f64>| {
        let mut linear = DMatrix::zeros(3, n);
        let mut angular = DMatrix::zeros(3, n);
        for (index, (slides, axis, place)) in axes.iter().enumerate() {
            linear.set_column(index, &if *slides { *axis } else { axis.cross(&(point - place)) });
            angular.set_column(index, &if *slides { Vector3::zeros() } else { *axis });
        }
        (linear, angular)
    };
    for index in 0..n {
        let (link, joint) = (links[index].as_table().unwrap(), joints[index].as_table().unwrap());
        let rpy = numbers(&joint["rpy"]);
        let before = frame.translation.vector;
        let turn = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
        frame *= Isometry3::from_parts(Translation3::from(vector(&joint["origin"])), turn);
        let step = frame.translation.vector - before;
        a += dw.cross(&step) + w.cross(&w.cross(&step));
        let axis = Unit::new_normalize(vector(&joint["axis"]));
        let direction = frame * axis.into_inner();
        let slides = joint["type"].as_str() == Some("prismatic");
        axes.push((slides, direction, frame.translation.vector));
        if slides {
            let slide = direction * q[index];
            frame *= Translation3::from(axis.into_inner() * q[index]);
            a += dw.cross(&slide) + w.cross(&w.cross(&slide)) + w.cross(&direction) * (2.0 * qd[index]);
        } else {
            frame *= UnitQuaternion::from_axis_angle(&axis, q[index]);
            dw += w.cross(&direction) * qd[index];
            w += direction * qd[index];
        }
        let r = frame * vector(&link["com"]);
        let t = numbers(&link["inertia"]);
        let tensor = Matrix3::new(t[0], t[3], t[4], t[3], t[1], t[5], t[4], t[5], t[2]);
        let turn = frame.rotation.to_rotation_matrix();
        let tensor = turn * tensor * turn.transpose();
        let m = link["mass"].as_float().unwrap();
        let (linear, angular) = columns(&axes, &(frame.translation.vector + r));
        mass += linear.transpose() * &linear * m + angular.transpose() * tensor * &angular;
        let acceleration = a + dw.cross(&r) + w.cross(&w.cross(&r)) - gravity;
        bias += linear.transpose() * acceleration * m + angular.transpose() * (tensor * dw + w.cross(&(tensor * w)));
        mass[(index, index)] += joint["inertia"].as_float().unwrap();
    }
    let arm = frame * vector(&file["geometry"]["tip"]);
    let tip = frame.translation.vector + arm;
    let tip_acceleration = a + dw.cross(&arm) + w.cross(&w.cross(&arm));
    Motion { tip, tip_acceleration, jacobian: columns(&axes, &tip).0, mass, bias }
}

fn list(value: &Json) -> Vec<f64> {
    match value {
        Json::Array(values) => values.iter().flat_map(list).collect(),
        value => vec![value.as_f64().expect("a number")],
    }
}

fn assert_close(id: &str, name: &str, found: &[f64], expected: &Json) {
    let expected = list(expected);
    let scale = expected.iter().fold(1e-9, |scale: f64, value| scale.max(value.abs()));
    assert_eq!(found.len(), expected.len(), "{id}: {name}");
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() <= TOLERANCE * scale, "{id}: {name} is {found}, not {expected}");
    }
}

fn row_major(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.transpose().iter().copied().collect()
}

#[test]
fn device_files_agree_with_independent_cases() {
    let cases: Vec<Json> = serde_json::from_str(include_str!("cases.json")).unwrap();
    assert_eq!(cases.len(), 6);
    for case in cases {
        let id = case["id"].as_str().unwrap();
        let words = |key: &str| -> Vec<String> { serde_json::from_value(case[key].clone()).unwrap_or_default() };
        let selection = Selection { tip: case["tip"].as_str().map(Into::into), joints: words("joints") };
        let text = convert(case["file"].as_str().unwrap(), id.as_ref(), &selection).unwrap().device_file;
        let file: Table = text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"));
        let task: Vec<&str> = file["geometry"]["task"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        assert_eq!(task, words("task"), "{id}");
        let joints = file["joint"].as_array().unwrap();
        for (joint, expected) in joints.iter().zip(case["found_joints"].as_array().unwrap()) {
            assert_eq!(joint["type"].as_str(), expected["type"].as_str(), "{id}");
            assert_eq!(joint.get("limits").is_none(), expected["limits"].is_null(), "{id}");
            if let Some(limits) = joint.get("limits") {
                assert_close(id, "limits", &numbers(limits), &expected["limits"]);
            }
            for key in ["viscous", "coulomb", "inertia"] {
                assert_close(id, key, &[joint[key].as_float().unwrap()], &expected[key]);
            }
        }

        let (q, qd) = (list(&case["q"]), list(&case["qd"]));
        let all = motion(&file, &q, &qd);
        let rows: Vec<usize> = task.iter().map(|axis| "xyz".find(axis).unwrap()).collect();
        let of_task = |vector: &Vector3<f64>| DVector::from_iterator(rows.len(), rows.iter().map(|row| vector[*row]));
        let (jacobian, expect) = (all.jacobian.select_rows(&rows), &case["expect"]);
        assert_close(id, "position", of_task(&all.tip).as_slice(), &expect["position"]);
        assert_close(id, "jacobian", &row_major(&jacobian), &expect["jacobian"]);
        assert_close(id, "mass", &row_major(&all.mass), &expect["mass"]);
        assert_close(id, "bias", all.bias.as_slice(), &expect["bias"]);
        // Equation (4) in joint form: E is the joint motion for a unit of motion along the normal.
        let inverse = jacobian.try_inverse().unwrap();
        let e = &inverse * DVector::from_vec(list(&case["normal"]));
        let b = &all.bias - &all.mass * inverse * of_task(&all.tip_acceleration);
        let me = &all.mass * &e;
        let force = case["force"].as_f64().unwrap();
        let torque = &me * ((force - e.dot(&b)) / e.dot(&me)) + b;
        assert_close(id, "torque", torque.as_slice(), &expect["torque"]);
    }
}
