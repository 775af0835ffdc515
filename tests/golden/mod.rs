//! Reads the golden cases beside this file.

use serde_json::Value;
use std::path::Path;

/// The cases of `file` whose id is `mechanism-NNN`.
pub fn cases(file: &str, mechanism: &str) -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(file);
    let text = std::fs::read_to_string(&path).expect("the golden file is there");
    let mut document: Value = serde_json::from_str(&text).expect("the golden file is JSON");
    let Value::Array(cases) = document["cases"].take() else { panic!("{file} has no cases") };
    let of_mechanism = |case: &Value| {
        let id = text_of(&case["id"]).to_string();
        id.rsplit_once('-').is_some_and(|(kind, _)| kind == mechanism)
    };
    cases.into_iter().filter(of_mechanism).collect()
}

fn text_of(value: &Value) -> &str {
    value.as_str().expect("a string")
}

/// A string of a case.
pub fn text(value: &Value) -> &str {
    text_of(value)
}

/// A number of a case.
pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A list of numbers, rows one after the other.
pub fn list(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .expect("a list")
        .iter()
        .flat_map(|entry| if entry.is_array() { list(entry) } else { vec![number(entry)] })
        .collect()
}

/// The largest difference over the largest entry of `scale`; the difference itself where everything is zero.
pub fn worst(found: &[f64], expected: &[f64], scale: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len(), "{found:?} against {expected:?}");
    let largest = scale.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let error = found.iter().zip(expected).fold(0.0_f64, |error, (a, b)| error.max((a - b).abs()));
    if largest > 0.0 { error / largest } else { error }
}
