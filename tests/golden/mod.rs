//! The golden cases of one wall (model.json): twenty random devices and motions of every mechanism, computed outside this
//! repository in the terms of `haptic model --json`.

use haptic_bridge::model::catalogue::Kind;
use serde_json::Value;

/// Error of f64 as a share of the largest entry, and of the board's f32 as a share of the largest torque.
pub const F64_TOLERANCE: f64 = 1.0e-9;
pub const F32_TOLERANCE: f64 = 2.0e-4;

/// A quantity's name there, and its entries, rows one after the other.
pub type Quantity = (&'static str, Vec<f64>);

/// All cases.
pub fn cases() -> Vec<Value> {
    let mut document: Value = serde_json::from_str(include_str!("model.json")).expect("the golden file is JSON");
    let Value::Array(cases) = document["cases"].take() else { panic!("no cases") };
    for kind in Kind::ALL {
        let of_kind = |case: &&Value| text(&case["id"]).rsplit_once('-').is_some_and(|(id, _)| id == kind.spec().name);
        assert_eq!(cases.iter().filter(of_kind).count(), 20, "{kind:?}");
    }
    cases
}

/// A string of a case.
pub fn text(value: &Value) -> &str {
    value.as_str().expect("a string")
}

/// A number of a case.
pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A list of numbers, rows one after the other.
pub fn list(value: &Value) -> Vec<f64> {
    value.as_array().map_or_else(|| vec![number(value)], |entries| entries.iter().flat_map(list).collect())
}

/// Each is what the case expects within this share of the largest entry, or of `tolerance` itself where all are zero.
pub fn agree(case: &Value, found: &[Quantity], tolerance: f64) {
    for (name, found) in found {
        let expected = list(&case["expect"][*name]);
        assert_eq!(found.len(), expected.len(), "{name}");
        // A difference of two inertias: its digits are theirs.
        let scale = if *name == "coupling" { list(&case["expect"]["w_rr"]) } else { expected.clone() };
        let largest = scale.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        let error = found.iter().zip(&expected).fold(0.0_f64, |error, (a, b)| error.max((a - b).abs()));
        let error = if largest > 0.0 { error / largest } else { error };
        assert!(error <= tolerance, "{}: {name} is {found:?}, not {expected:?} ({error:e})", case["id"]);
    }
}
