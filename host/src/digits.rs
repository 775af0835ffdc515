//! Numbers of the board's single precision in documents.

use crate::error::{Failure, print};
use serde_json::{Number, Value};

/// The same document with every number that single precision holds in the fewest digits that mean it there: a [`Value`]
/// keeps an `f32` as the `f64` of the same worth, whose digits go on. What is shorter in double precision stays.
pub fn shortest(document: Value) -> Value {
    match document {
        Value::Number(number) if number.is_f64() => {
            let single = number.as_f64().filter(|wide| f64::from(*wide as f32) == *wide).map(|wide| wide as f32);
            let short = single.and_then(|single| single.to_string().parse().ok()).and_then(Number::from_f64);
            let shorter = short.filter(|short| short.to_string().len() < number.to_string().len());
            Value::Number(shorter.unwrap_or(number))
        }
        Value::Array(values) => values.into_iter().map(shortest).collect(),
        Value::Object(map) => Value::Object(map.into_iter().map(|(key, value)| (key, shortest(value))).collect()),
        other => other,
    }
}

/// Writes one JSON document to standard output, its numbers in the [`shortest`] digits.
pub fn print_json(document: Value) -> Result<(), Failure> {
    print(&format!("{}\n", shortest(document)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_of_a_board_have_the_digits_that_they_mean_and_others_keep_theirs() {
        let document =
            json!({ "single": [0.08f32, 2.3f32, -1.862_645_1e-9f32, 24.0f32], "double": 0.1 + 0.2, "count": 3 });
        assert_eq!(
            shortest(document).to_string(),
            r#"{"count":3,"double":0.30000000000000004,"single":[0.08,2.3,-1.8626451e-9,24.0]}"#
        );
        // Whole numbers keep all of their digits.
        assert_eq!(shortest(json!(33_554_436.0f32)).to_string(), "33554436.0");
    }
}
