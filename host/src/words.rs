//! The wording of walls and numbers in messages.

use haptic_bridge::render::scene::{FeedForward, Wall};
use haptic_bridge::safety::fault::FaultRecord;

/// Rewrites a message of a board or of this library for people who call functions: `calls` names the function for each
/// command of the tool.
pub fn for_a_program(text: &str, calls: &[(&str, &str)]) -> String {
    calls.iter().fold(text.into(), |text, (command, call)| text.replace(&format!("`haptic {command}`"), call))
}

/// A fault, its joint, and what to do about it.
pub fn fault_and_remedy(record: &FaultRecord) -> String {
    let joint = record.axis.map_or(String::new(), |axis| format!(" (joint {axis})"));
    format!("{}{joint}; {}", record.fault, record.fault.remedy())
}

/// A wall in words.
pub fn wall_in_words(wall: &Wall<f32>) -> String {
    let shape = wall.surface.spec().name;
    let (stiffness, damping) = (short(wall.stiffness), short(wall.damping));
    format!("{shape}, {stiffness} N/m, {damping} N s/m, feed-forward {}", feed_forward_in_words(wall))
}

/// Its feed-forward in words.
pub fn feed_forward_in_words(wall: &Wall<f32>) -> String {
    match wall.feed_forward {
        FeedForward::Washout => format!("washout at {} Hz", short(wall.washout_hz)),
        other => other.name().into(),
    }
}

/// A number to five digits, without zeros that say nothing.
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
    // Display gives a float the fewest digits that mean it, where a precision would write out those it does not have.
    let text = if digits == 0 { value.round().to_string() } else { format!("{value:.digits$}") };
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// So many bytes, for people.
pub fn bytes_in_words(bytes: u64) -> String {
    match bytes as f64 {
        size if size < 1e3 => format!("{size} bytes"),
        size if size < 1e6 => format!("{:.1} kB", 1e-3 * size),
        size if size < 1e9 => format!("{:.1} MB", 1e-6 * size),
        size => format!("{:.2} GB", 1e-9 * size),
    }
}

/// A number as it was meant, to six significant digits: without what arithmetic left behind them.
pub fn digits(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().unwrap_or(value).to_string()
}

/// A share in per cent to so many decimals, with its sign where `signed`; what rounds to zero has none of its own.
pub fn percent(share: f64, decimals: i32, signed: bool) -> String {
    let shown = decimals.max(0) as usize;
    let rounded = (100.0 * share * 10.0_f64.powi(decimals)).round() / 10.0_f64.powi(decimals) + 0.0;
    if signed { format!("{rounded:+.shown$} %") } else { format!("{rounded:.shown$} %") }
}

/// So many of a thing.
pub fn counted(count: impl std::fmt::Display, noun: &str) -> String {
    let count = count.to_string();
    let plural = if count == "1" { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// "0", "0 and 1", "0, 1 and 2".
pub fn listed(items: &[String]) -> String {
    match items {
        [others @ .., before, last] => [others, &[format!("{before} and {last}")]].concat().join(", "),
        _ => items.concat(),
    }
}

/// A number for people: three significant digits, and a prefix where the unit takes one.
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

/// "3rd step".
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
        let told = [0.0, 0.12345678, 12345.678, 1_234_567.8, 1e12, 1.2345678e9].map(short);
        assert_eq!(told.join(", "), "0, 0.12346, 12346, 1234568, 1e12, 1.2346e9");
    }

    #[test]
    fn things_are_listed_as_people_do() {
        let told = |count: usize| listed(&(0..count).map(|i| i.to_string()).collect::<Vec<_>>());
        assert_eq!([0, 1, 2, 3].map(told), ["", "0", "0 and 1", "0, 1 and 2"]);
    }

    #[test]
    fn a_share_that_rounds_to_nothing_has_no_sign() {
        let told = [-1e-5, 0.0, 0.0123, -0.5].map(|share| percent(share, 1, false));
        assert_eq!(
            (told.join(", "), percent(-1e-9, 2, true)),
            ("0.0 %, 0.0 %, 1.2 %, -50.0 %".into(), "+0.00 %".into())
        );
    }

    #[test]
    fn steps_are_counted_as_people_do() {
        assert_eq!(
            [1, 2, 3, 4, 11, 21, 22, 112].map(nth_step).join(", "),
            "step, 2nd step, 3rd step, 4th step, 11th step, 21st step, 22nd step, 112th step"
        );
    }

    #[test]
    fn sizes_are_told_in_the_unit_that_fits() {
        let told = [17, 1_234, 3_600_000, 2_500_000_000].map(bytes_in_words);
        assert_eq!(told.join(", "), "17 bytes, 1.2 kB, 3.6 MB, 2.50 GB");
    }
}
