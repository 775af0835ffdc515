//! What came of every fault, as docs/results/faults.md tells it.

use std::path::{Path, PathBuf};

use haptic_bridge::safety::fault::Fault;

use super::{Injection, Outcome, injection};

/// Where the table is kept.
#[must_use]
pub fn document() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/results/faults.md")
}

/// How `fault` is brought about, or why it cannot be, in words.
#[must_use]
pub fn how(fault: Fault) -> String {
    match injection(fault) {
        Injection::Chip { how, .. } => how.to_owned(),
        Injection::Unseen(why) => format!("not possible: {why}"),
    }
}

/// The row of docs/results/faults.md for `fault`. Values and periods that hang on how fast the image is, such as the
/// instant at which a moving hand trips a limit, are left out.
#[must_use]
pub fn row(fault: Fault, outcome: Option<&Outcome>) -> String {
    let slow = matches!(injection(fault), Injection::Chip { within, .. } if within > 5);
    let how = how(fault);
    let (cause, seen) = match outcome {
        None => ("", "".to_owned()),
        Some(outcome) => {
            let cause = if slow {
                "later"
            } else if outcome.from_cause <= 3 {
                "at most 3"
            } else {
                "more than 3"
            };
            let seen = match outcome.from_seen {
                None => "before the restart".to_owned(),
                Some(0 | 1) => "at most 1".to_owned(),
                Some(periods) => periods.to_string(),
            };
            (cause, seen)
        }
    };
    format!("| {} | {} | {how} | {cause} | {seen} | {} |", fault.code(), fault.name(), fault.remedy())
}

/// The document for what came of every fault.
#[must_use]
pub fn table(outcomes: &[(Fault, Option<Outcome>)]) -> String {
    let mut text = "# Faults brought about in the release images\n\n\
        Written by `cargo xtask faults`: every fault of src/safety/fault.rs injected into an armed board on the emulated chip\n\
        (emulator/src/inject.rs). Each was latched and listed, refused arming until it was cleared, and left the bridges\n\
        floating with the enable line low. Periods from the cause count to bridges that float: `later` is where the cause has to\n\
        last (a budget, a timeout, a moving hand). Periods from the last step before it was seen: at most 1 is the same period.\n\n\
        | code | fault | injection | periods from the cause | periods from being seen | remedy |\n|--:|---|---|---|---|---|\n"
        .to_owned();
    for (fault, outcome) in outcomes {
        text += &row(*fault, outcome.as_ref());
        text.push('\n');
    }
    text
}
