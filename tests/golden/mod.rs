//! The golden cases of one wall (model.json, more.json): random devices and motions of every mechanism. They were
//! computed outside this repository and have the keys of `haptic model --json`.

use haptic_bridge::model::catalogue::Kind;
use serde_json::Value;

/// Largest error of f64, as a share of the quantity's largest entry.
pub const F64_TOLERANCE: f64 = 1.0e-9;
/// Largest error of the board's f32, as a share of the largest torque.
pub const F32_TOLERANCE: f64 = 2.0e-4;

/// Key of a quantity in the golden file, and the quantity's entries in row-major order.
pub type Quantity = (&'static str, Vec<f64>);

pub fn cases() -> Vec<Value> {
    let files = [include_str!("model.json"), include_str!("more.json")];
    let cases: Vec<Value> = files
        .into_iter()
        .flat_map(|file| {
            let mut document: Value = serde_json::from_str(file).expect("the golden file is JSON");
            let Value::Array(cases) = document["cases"].take() else { panic!("no cases") };
            cases
        })
        .collect();
    for kind in Kind::ALL {
        let name = format!("mechanism = \"{}\"", kind.spec().name);
        assert!(cases.iter().any(|case| text(&case["device"]).contains(&name)), "{kind:?}");
    }
    cases
}

pub fn text(value: &Value) -> &str {
    value.as_str().expect("a string")
}

pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// Returns the numbers of a list or matrix in row-major order.
pub fn list(value: &Value) -> Vec<f64> {
    value.as_array().map_or_else(|| vec![number(value)], |entries| entries.iter().flat_map(list).collect())
}

/// Asserts that every quantity equals the case's value. `tolerance` is a share of the largest expected entry, or an
/// absolute error if all expected entries are zero.
pub fn assert_agree(case: &Value, found: &[Quantity], tolerance: f64) {
    for (name, found) in found {
        let expected = list(&case["expect"][*name]);
        assert_eq!(found.len(), expected.len(), "{name}");
        // The coupling is a difference of two inertias, so its rounding error is relative to these inertias.
        let scale = if *name == "coupling" { list(&case["expect"]["w_rr"]) } else { expected.clone() };
        let largest = scale.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        let error = found.iter().zip(&expected).fold(0.0_f64, |error, (a, b)| error.max((a - b).abs()));
        let error = if largest > 0.0 { error / largest } else { error };
        assert!(error <= tolerance, "{}: {name} is {found:?}, not {expected:?} ({error:e})", case["id"]);
    }
}
