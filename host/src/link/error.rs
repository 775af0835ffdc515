//! The errors between the tool and a board, each with its remedy.

use crate::error::{Choice, Failure};
use haptic_bridge::safety::refusal::Refusal;
use std::io;

/// A failure to reach a board, or a lost connection. `what` is the path of the request or message, `others` are serial
/// ports without a board.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum LinkError {
    #[error(
        "no board found{}; plug one in, or name its port (a serial port, tcp:HOST:PORT, or sim)",
        if others.is_empty() { " and no serial ports at all".into() } else { format!(" (other serial ports: {})", others.join(", ")) }
    )]
    NoBoard { others: Vec<String> },
    #[error("several boards found: {}; choose one by its port or its serial number", .0.join(", "))]
    SeveralBoards(Vec<String>),
    #[error(
        "no port {name}, and no board on USB has that serial number: {reason}; `haptic board list` shows the boards that \
         are connected, and a simulated one is on the port that `haptic sim` prints"
    )]
    NoSuchPort { name: String, reason: String },
    #[error(
        "port {0} is in use by another program (another `haptic`, a serial monitor, ModemManager); close it first. To \
         change gains while recording, use `haptic view` for both"
    )]
    PortBusy(String),
    #[error("no permission to open {0}; add yourself to its group: sudo usermod -aG dialout $USER, then log in again")]
    Forbidden(String),
    #[error("cannot connect to {address}: {error}; check that a simulated board is served there")]
    NotListening { address: String, error: io::Error },
    #[error("the board was unplugged or the connection was lost ({0}); plug it in again")]
    Lost(io::Error),
    #[error(
        "another tool is connected to {0}; close it first. To change gains while recording, use `haptic view` for both"
    )]
    HeldByAnother(String),
    /// The device of `sim:FILE` cannot be simulated.
    #[error("{0}")]
    CannotSimulate(String),
    #[error("the board does not reply ({what}); is this a haptic-bridge board? If it is, power-cycle it")]
    Silent { what: &'static str },
    /// No reply to a force, because a frame was lost or the computer was busy. The earlier force ends with its lease.
    #[error("no reply to a force within {} ms: the force or the reply was lost; send the next force", waited.as_millis())]
    Unanswered { waited: std::time::Duration },
    /// The board could not decode the message of a valid frame.
    #[error(
        "the board rejected the message {what}: {error}; flash the firmware that came with this tool: haptic flash"
    )]
    Rejected { what: &'static str, error: String },
    #[error("the message {what} could not be decoded; flash the firmware that came with this tool: haptic flash")]
    Unreadable { what: &'static str },
    #[error(
        "the board has protocol version {board} and this tool has version {tool}; \
         {}",
        if board < tool { "flash it: haptic flash" } else { "update this tool: it is older than the board's firmware" }
    )]
    Version { board: u16, tool: u16 },
}

/// A request that a board did not carry out.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The board could not be reached.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The board refused the request.
    #[error("the board refuses: {0}")]
    Refused(Refusal),
}

impl From<Refusal> for BoardError {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        match error {
            LinkError::CannotSimulate(_) => Self::wrong(error),
            LinkError::NoBoard { .. } | LinkError::SeveralBoards(_) => Self::impossible(error).choose(Choice::Board),
            _ => Self::impossible(error),
        }
    }
}

impl From<BoardError> for Failure {
    fn from(error: BoardError) -> Self {
        match error {
            BoardError::Link(error) => error.into(),
            BoardError::Refused(_) => Self::impossible(error),
        }
    }
}
