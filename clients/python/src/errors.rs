//! Exceptions, in the words of the tool.

use haptic_host::error::{Blame, Failure};
use haptic_host::link::{BoardError, LinkError as NoLink};
use haptic_host::words::for_a_program;
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::PyException;

create_exception!(
    haptic_bridge,
    HapticError,
    PyException,
    "Something that haptic-bridge could not do; its text says why."
);
create_exception!(
    haptic_bridge,
    RequestError,
    HapticError,
    "A file or an argument is wrong, and would be wrong again."
);
create_exception!(
    haptic_bridge,
    ImpossibleError,
    HapticError,
    "A sound request that has no answer, such as at a singular pose."
);
create_exception!(haptic_bridge, LinkError, HapticError, "No board can be reached, or it went away.");
create_exception!(
    haptic_bridge,
    UnansweredError,
    LinkError,
    "One answer did not come in time: the board or the computer was busy. The next request goes on."
);
create_exception!(haptic_bridge, RefusedError, HapticError, "The board refuses.");

/// Commands that a person would type, and what a program calls instead.
const CALLS: [(&str, &str); 6] = [
    ("device FILE", "Board.load()"),
    ("scene FILE", "Board.set_scene()"),
    ("home", "Board.home()"),
    ("polarity", "Board.check_polarity()"),
    ("disarm", "Board.disarm()"),
    ("faults --clear", "Board.clear()"),
];

/// Of anything that the tool ends with.
pub fn failure(failure: impl Into<Failure>) -> PyErr {
    let failure = failure.into();
    match failure.blame() {
        Blame::Request => RequestError::new_err(failure.to_string()),
        Blame::World | Blame::Difference => ImpossibleError::new_err(failure.to_string()),
    }
}

/// Of a board.
pub fn board(error: BoardError) -> PyErr {
    match error {
        BoardError::Link(error) => link(error),
        BoardError::Refused(_) => refused(&error.to_string()),
    }
}

/// Of what a board does not do.
pub fn refused(words: &str) -> PyErr {
    RefusedError::new_err(in_calls(words))
}

/// The tool's words, with a program's calls in the place of commands.
pub fn in_calls(words: &str) -> String {
    for_a_program(words, &CALLS)
}

/// Of the way to one.
pub fn link(error: NoLink) -> PyErr {
    match error {
        NoLink::CannotSimulate(_) => RequestError::new_err(error.to_string()),
        NoLink::Unanswered { .. } => UnansweredError::new_err(error.to_string()),
        _ => LinkError::new_err(error.to_string()),
    }
}
