//! The golden cases of one wall (model.json): twenty random devices and motions of every mechanism. They were computed
//! outside this repository and have the keys of `haptic model --json`.

use haptic_bridge::model::catalogue::Kind;
use serde_json::Value;

/// Largest error of f64 as a share of the largest entry, and of the board's f32 as a share of the largest torque.
pub const F64_TOLERANCE: f64 = 1.0e-9;
pub const F32_TOLERANCE: f64 = 2.0e-4;

/// Key of a quantity in the golden file, and its entries in row-major order.
pub type Quantity = (&'static str, Vec<f64>);

/// Reads all cases.
pub fn cases() -> Vec<Value> {
    let mut document: Value = serde_json::from_str(include_str!("model.json")).expect("the golden file is JSON");
    let Value::Array(cases) = document["cases"].take() else { panic!("no cases") };
    for kind in Kind::ALL {
        let of_kind = |case: &&Value| text(&case["id"]).rsplit_once('-').is_some_and(|(id, _)| id == kind.spec().name);
        assert_eq!(cases.iter().filter(of_kind).count(), 20, "{kind:?}");
    }
    cases
}

/// Reads a string of a case.
pub fn text(value: &Value) -> &str {
    value.as_str().expect("a string")
}

/// Reads a number of a case.
pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// Reads a list or matrix of numbers in row-major order.
pub fn list(value: &Value) -> Vec<f64> {
    value.as_array().map_or_else(|| vec![number(value)], |entries| entries.iter().flat_map(list).collect())
}

/// Asserts that every quantity is as the case expects. `tolerance` is a share of the largest expected entry, or the
/// largest error itself if all expected entries are zero.
pub fn agree(case: &Value, found: &[Quantity], tolerance: f64) {
    for (name, found) in found {
        let expected = list(&case["expect"][*name]);
        assert_eq!(found.len(), expected.len(), "{name}");
        // The coupling is a difference of two inertias, so its rounding error is theirs.
        let scale = if *name == "coupling" { list(&case["expect"]["w_rr"]) } else { expected.clone() };
        let largest = scale.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        let error = found.iter().zip(&expected).fold(0.0_f64, |error, (a, b)| error.max((a - b).abs()));
        let error = if largest > 0.0 { error / largest } else { error };
        assert!(error <= tolerance, "{}: {name} is {found:?}, not {expected:?} ({error:e})", case["id"]);
    }
}
