//! Text for walls, faults and numbers in messages.

use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::scene::{FeedForward, Wall};
use haptic_bridge::safety::fault::FaultRecord;

/// Rewrites a message for users of a programming interface: replaces each command of the tool by the function that
/// `calls` lists for it.
pub fn commands_to_calls(text: &str, calls: &[(&str, &str)]) -> String {
    calls.iter().fold(text.into(), |text, (command, call)| text.replace(&format!("`haptic {command}`"), call))
}

/// Formats a fault with the joint and the remedy.
pub fn fault_and_remedy(record: &FaultRecord) -> String {
    let joint = record.axis.map_or(String::new(), |axis| format!(" (joint {axis})"));
    format!("{}{joint}; {}", record.fault, record.fault.remedy())
}

/// Joins a unit of a device's joints: "rad", or "rad, m" if the joints differ.
pub fn joint_units(joints: &[&JointUnits], unit: impl Fn(&JointUnits) -> &'static str) -> String {
    let mut units: Vec<&str> = joints.iter().map(|joint| unit(joint)).collect();
    if units.iter().all(|unit| *unit == units[0]) {
        units.truncate(1);
    }
    units.join(", ")
}

/// Describes a wall.
pub fn wall_in_words(wall: &Wall<f32>) -> String {
    let shape = wall.surface.spec().name;
    let (stiffness, damping) = (short(wall.stiffness), short(wall.damping));
    format!("{shape}, {stiffness} N/m, {damping} N s/m, feed-forward {}", feed_forward_in_words(wall))
}

/// Describes the feed-forward of a wall.
pub fn feed_forward_in_words(wall: &Wall<f32>) -> String {
    match wall.feed_forward {
        FeedForward::Washout => format!("washout at {} Hz", short(wall.washout_hz)),
        other => other.name().into(),
    }
}

/// Formats a number to five significant digits, without trailing zeros.
pub fn short(value: f32) -> String {
    let digits = match value.abs() {
        size if size > 0.0 && size.is_finite() => (4 - f64::from(size).log10().floor() as i32).max(0) as usize,
        _ => 0,
    };
    if digits > 12 {
        return format!("{value:.4e}");
    }
    if value.is_finite() && value.abs() >= 1e7 {
        let rounded: f32 = format!("{value:.4e}").parse().unwrap_or(value);
        return format!("{rounded:e}");
    }
    // Without a precision, `Display` writes the fewest digits that round to the value.
    let text = if digits == 0 { value.round().to_string() } else { format!("{value:.digits$}") };
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// Formats a number of bytes in bytes, kB, MB or GB.
pub fn bytes_in_words(bytes: u64) -> String {
    match bytes as f64 {
        size if size < 1e3 => format!("{size} bytes"),
        size if size < 1e6 => format!("{:.1} kB", 1e-3 * size),
        size if size < 1e9 => format!("{:.1} MB", 1e-6 * size),
        size => format!("{:.2} GB", 1e-9 * size),
    }
}

/// Formats a number to six significant digits, which removes rounding errors of arithmetic.
pub fn digits(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().unwrap_or(value).to_string()
}

/// Formats a ratio in per cent with `decimals` decimals, and with a plus sign if `signed`. A result that rounds to zero
/// has no minus sign.
pub fn percent(share: f64, decimals: i32, signed: bool) -> String {
    let shown = decimals.max(0) as usize;
    let rounded = (100.0 * share * 10.0_f64.powi(decimals)).round() / 10.0_f64.powi(decimals) + 0.0;
    if signed { format!("{rounded:+.shown$} %") } else { format!("{rounded:.shown$} %") }
}

/// Formats a count with its noun in the singular or plural.
pub fn counted(count: impl std::fmt::Display, noun: &str) -> String {
    let count = count.to_string();
    let plural = if count == "1" { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Joins items: "0", "0 and 1", "0, 1 and 2".
pub fn listed(items: &[String]) -> String {
    match items {
        [others @ .., before, last] => [others, &[format!("{before} and {last}")]].concat().join(", "),
        _ => items.concat(),
    }
}

/// Formats a number to three significant digits, with an SI prefix except for grams and kilograms.
pub fn with_unit(value: f64, unit: &str) -> String {
    let size = value.abs();
    let (factor, prefix) = match unit {
        "kg" if size < 1.0 => return with_unit(1e3 * value, "g"),
        "kg" | "g" => (1.0, ""),
        _ if size >= 1e9 => (1e9, "G"),
        _ if size >= 1e6 => (1e6, "M"),
        _ if size >= 1e3 => (1e3, "k"),
        _ if size >= 1.0 || size == 0.0 => (1.0, ""),
        _ if size >= 1e-3 => (1e-3, "m"),
        _ => (1e-6, "µ"),
    };
    let scaled = value / factor;
    let decimals = if scaled == 0.0 { 0 } else { (2 - scaled.abs().log10().floor() as i32).clamp(0, 3) as usize };
    format!("{scaled:.decimals$} {prefix}{unit}")
}

/// Formats a divider as an ordinal: "3rd step".
pub fn nth_step(divider: u32) -> String {
    let ending = match (divider % 10, divider % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    if divider == 1 { "step".into() } else { format!("{divider}{ending} step") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_digits_are_enough_at_any_size() {
        let texts = [0.0, 0.12345678, 12345.678, 1_234_567.8, 1e12, 1.2345678e9].map(short);
        assert_eq!(texts.join(", "), "0, 0.12346, 12346, 1234568, 1e12, 1.2346e9");
    }

    #[test]
    fn items_are_joined_with_commas_and_and() {
        let texts = |count: usize| listed(&(0..count).map(|i| i.to_string()).collect::<Vec<_>>());
        assert_eq!([0, 1, 2, 3].map(texts), ["", "0", "0 and 1", "0, 1 and 2"]);
    }

    #[test]
    fn a_ratio_that_rounds_to_zero_has_no_minus_sign() {
        let texts = [-1e-5, 0.0, 0.0123, -0.5].map(|share| percent(share, 1, false));
        assert_eq!(
            (texts.join(", "), percent(-1e-9, 2, true)),
            ("0.0 %, 0.0 %, 1.2 %, -50.0 %".into(), "+0.00 %".into())
        );
    }

    #[test]
    fn ordinals_end_as_in_english() {
        assert_eq!(
            [1, 2, 3, 4, 11, 21, 22, 112].map(nth_step).join(", "),
            "step, 2nd step, 3rd step, 4th step, 11th step, 21st step, 22nd step, 112th step"
        );
    }

    #[test]
    fn byte_counts_get_a_fitting_prefix() {
        let texts = [17, 1_234, 3_600_000, 2_500_000_000].map(bytes_in_words);
        assert_eq!(texts.join(", "), "17 bytes, 1.2 kB, 3.6 MB, 2.50 GB");
    }
}
