//! Shortest decimal form of the board's single-precision numbers in JSON documents.

use crate::error::{Failure, print};
use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter};
use serde_json::{Number, Value};
use std::io;

/// Returns the number with the fewest digits that rounds to the same `f32`, because an `f32` widened to `f64` has
/// digits without meaning. Returns a `number` that is no `f32`, or shorter in double precision, unchanged.
pub(crate) fn shorten(number: f64) -> f64 {
    let single = number as f32;
    if f64::from(single) != number {
        return number;
    }
    let short = single.to_string().parse().unwrap_or(number);
    if short.to_string().len() < number.to_string().len() { short } else { number }
}

/// Returns the document with every single-precision number in the fewest digits.
pub fn shorten_all(document: Value) -> Value {
    match document {
        Value::Number(number) if number.is_f64() => {
            let short = number.as_f64().and_then(|wide| Number::from_f64(shorten(wide)));
            Value::Number(short.unwrap_or(number))
        }
        Value::Array(values) => values.into_iter().map(shorten_all).collect(),
        Value::Object(map) => Value::Object(map.into_iter().map(|(key, value)| (key, shorten_all(value))).collect()),
        other => other,
    }
}

/// A JSON formatter that writes numbers in the fewest digits.
struct ShortNumbers;

impl Formatter for ShortNumbers {
    fn write_f64<W: ?Sized + io::Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        CompactFormatter.write_f64(writer, shorten(value))
    }
}

/// Formats a JSON document on one line, with numbers in the fewest digits.
fn json_line(document: impl Serialize) -> Result<String, Failure> {
    let mut text = Vec::new();
    document
        .serialize(&mut serde_json::Serializer::with_formatter(&mut text, ShortNumbers))
        .map_err(Failure::impossible)?;
    Ok(String::from_utf8(text).map_err(Failure::impossible)? + "\n")
}

/// Writes one JSON document to standard output, with numbers in the fewest digits.
pub fn print_json(document: impl Serialize) -> Result<(), Failure> {
    print(&json_line(document)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn single_precision_numbers_are_written_in_the_fewest_digits() {
        let document =
            json!({ "single": [0.08f32, 2.3f32, -1.862_645_1e-9f32, 24.0f32], "double": 0.1 + 0.2, "count": 3 });
        let expected = r#"{"count":3,"double":0.30000000000000004,"single":[0.08,2.3,-1.8626451e-9,24.0]}"#;
        assert_eq!(json_line(&document).unwrap(), format!("{expected}\n"));
        assert_eq!(shorten_all(document).to_string(), expected);
        // Whole numbers keep all of their digits.
        assert_eq!(shorten_all(json!(33_554_436.0f32)).to_string(), "33554436.0");
    }
}
