//! The table of all faults, docs/results/faults.csv.

use haptic_bridge::safety::fault::Fault;
use haptic_host::output::csv_line;

use super::{Injection, Outcome, injection};

/// Describes how `fault` is caused, or why that is impossible.
#[must_use]
pub fn describe(fault: Fault) -> String {
    match injection(fault) {
        Injection::Chip { description, .. } => description.to_owned(),
        Injection::Undetectable(why) => format!("not possible: {why}"),
    }
}

/// Returns the row for `fault`. Values and periods that depend on the image's speed are omitted, for example the time
/// at which a moving hand trips a limit.
#[must_use]
pub fn row(fault: Fault, outcome: Option<&Outcome>) -> String {
    let slow = matches!(injection(fault), Injection::Chip { within_ms, .. } if within_ms > 5);
    let description = describe(fault);
    let (cause, detection) = match outcome {
        None => ("", "".to_owned()),
        Some(outcome) => {
            let cause = if slow {
                "later"
            } else if outcome.periods_from_cause <= 3 {
                "at most 3"
            } else {
                "more than 3"
            };
            let detection = match outcome.periods_from_detection {
                None => "before the restart".to_owned(),
                Some(0 | 1) => "at most 1".to_owned(),
                Some(periods) => periods.to_string(),
            };
            (cause, detection)
        }
    };
    csv_line([&fault.code().to_string(), fault.name(), &description, cause, &detection])
}

/// Returns the table of all faults.
#[must_use]
pub fn table(outcomes: &[(Fault, Option<Outcome>)]) -> String {
    let head = csv_line(["code", "fault", "injection", "periods from the cause", "periods from being seen"]);
    head + &outcomes.iter().map(|(fault, outcome)| row(*fault, outcome.as_ref())).collect::<String>()
}
