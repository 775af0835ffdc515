//! Exceptions with the messages of the tool.

use haptic_host::error::{Blame, Failure};
use haptic_host::link::{BoardError, LinkError as HostLinkError};
use haptic_host::words::commands_to_calls;
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::PyException;

create_exception!(
    haptic_bridge,
    HapticError,
    PyException,
    "A failed operation of haptic-bridge, with the reason as its text."
);
create_exception!(haptic_bridge, RequestError, HapticError, "A file or an argument is wrong.");
create_exception!(
    haptic_bridge,
    ImpossibleError,
    HapticError,
    "A valid request without a result, such as at a singular pose."
);
create_exception!(haptic_bridge, LinkError, HapticError, "No board can be reached, or the board was lost.");
create_exception!(
    haptic_bridge,
    UnansweredError,
    LinkError,
    "A reply did not come in time, because the board or the computer was busy. The next request may succeed."
);
create_exception!(haptic_bridge, RefusedError, HapticError, "The board refused the request.");

/// Commands of the tool, and the calls that replace them.
const CALLS: [(&str, &str); 6] = [
    ("device FILE", "Board.load()"),
    ("scene FILE", "Board.set_scene()"),
    ("home", "Board.home()"),
    ("polarity", "Board.check_polarity()"),
    ("disarm", "Board.disarm()"),
    ("faults --clear", "Board.clear()"),
];

/// Converts a failure of the tool to an exception.
pub fn failure(failure: impl Into<Failure>) -> PyErr {
    let failure = failure.into();
    match failure.blame() {
        Blame::Request => RequestError::new_err(failure.to_string()),
        Blame::System | Blame::Difference => ImpossibleError::new_err(failure.to_string()),
    }
}

/// Converts an error of a board to an exception.
pub fn board(error: BoardError) -> PyErr {
    match error {
        BoardError::Link(error) => link(error),
        BoardError::Refused(_) => refused_error(&error.to_string()),
    }
}

/// Creates a RefusedError with this message.
pub fn refused_error(message: &str) -> PyErr {
    RefusedError::new_err(with_python_calls(message))
}

/// Replaces the tool's commands in a message by calls.
pub fn with_python_calls(message: &str) -> String {
    commands_to_calls(message, &CALLS)
}

/// Converts an error of the link to a board to an exception.
pub fn link(error: HostLinkError) -> PyErr {
    match error {
        HostLinkError::CannotSimulate(_) => RequestError::new_err(error.to_string()),
        HostLinkError::Unanswered { .. } => UnansweredError::new_err(error.to_string()),
        _ => LinkError::new_err(error.to_string()),
    }
}
