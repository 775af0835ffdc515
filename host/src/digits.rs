//! Numbers of the board's single precision in documents.

use crate::error::{Failure, print};
use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter};
use serde_json::{Number, Value};
use std::io;

/// The same number in the fewest digits that mean it where single precision holds it: an `f32` that was widened to
/// `f64` has digits that were never measured. A number that is shorter in double precision stays.
pub(crate) fn fewest(number: f64) -> f64 {
    let single = number as f32;
    if f64::from(single) != number {
        return number;
    }
    let short = single.to_string().parse().unwrap_or(number);
    if short.to_string().len() < number.to_string().len() { short } else { number }
}

/// The same document with every number in the fewest digits that mean it where single precision holds it.
pub fn shortest(document: Value) -> Value {
    match document {
        Value::Number(number) if number.is_f64() => {
            let short = number.as_f64().and_then(|wide| Number::from_f64(fewest(wide)));
            Value::Number(short.unwrap_or(number))
        }
        Value::Array(values) => values.into_iter().map(shortest).collect(),
        Value::Object(map) => Value::Object(map.into_iter().map(|(key, value)| (key, shortest(value))).collect()),
        other => other,
    }
}

/// Writes numbers in the fewest digits.
struct Fewest;

impl Formatter for Fewest {
    fn write_f64<W: ?Sized + io::Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        CompactFormatter.write_f64(writer, fewest(value))
    }
}

/// A JSON document on one line, its numbers in the fewest digits that mean them.
fn line(document: impl Serialize) -> Result<String, Failure> {
    let mut text = Vec::new();
    document.serialize(&mut serde_json::Serializer::with_formatter(&mut text, Fewest)).map_err(Failure::impossible)?;
    Ok(String::from_utf8(text).map_err(Failure::impossible)? + "\n")
}

/// Writes one JSON document to standard output, its numbers in the fewest digits that mean them.
pub fn print_json(document: impl Serialize) -> Result<(), Failure> {
    print(&line(document)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_of_a_board_have_the_digits_that_they_mean_and_others_keep_theirs() {
        let document =
            json!({ "single": [0.08f32, 2.3f32, -1.862_645_1e-9f32, 24.0f32], "double": 0.1 + 0.2, "count": 3 });
        let expected = r#"{"count":3,"double":0.30000000000000004,"single":[0.08,2.3,-1.8626451e-9,24.0]}"#;
        assert_eq!(line(&document).unwrap(), format!("{expected}\n"));
        assert_eq!(shortest(document).to_string(), expected);
        // Whole numbers keep all of their digits.
        assert_eq!(shortest(json!(33_554_436.0f32)).to_string(), "33554436.0");
    }
}
