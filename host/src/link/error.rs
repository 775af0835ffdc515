//! The errors between the tool and a board, each with its remedy.

use crate::error::{Choice, Failure};
use haptic_bridge::safety::refusal::Refusal;
use std::io;

/// A failure to reach a board, or a lost connection.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No board among the serial ports.
    #[error(
        "no board found{}; plug one in, or name its port (a serial port, tcp:HOST:PORT, or sim)",
        if others.is_empty() { " and no serial ports at all".into() } else { format!(" (other serial ports: {})", others.join(", ")) }
    )]
    NoBoard {
        /// Serial ports that are not boards.
        others: Vec<String>,
    },
    /// Several boards without a choice by the user.
    #[error("several boards found: {}; choose one by its port or its serial number", .0.join(", "))]
    SeveralBoards(Vec<String>),
    /// No port or board has this name.
    #[error(
        "no port {name}, and no board on USB has that serial number: {reason}; `haptic board list` shows the boards that \
         are connected, and a simulated one is on the port that `haptic sim` prints"
    )]
    NoSuchPort {
        /// The requested port.
        name: String,
        /// The operating system's message.
        reason: String,
    },
    /// Another program has the port open.
    #[error(
        "port {0} is in use by another program (another `haptic`, a serial monitor, ModemManager); close it first. To \
         change gains while recording, use `haptic view` for both"
    )]
    PortBusy(String),
    /// No permission to open the port.
    #[error("no permission to open {0}; add yourself to its group: sudo usermod -aG dialout $USER, then log in again")]
    Forbidden(String),
    /// A TCP connection failed.
    #[error("cannot connect to {address}: {error}; check that a simulated board is served there")]
    NotListening {
        /// The address that was tried.
        address: String,
        /// The operating system's error.
        error: io::Error,
    },
    /// The board or the wire is gone.
    #[error("the board was unplugged or the connection was lost ({0}); plug it in again")]
    Lost(io::Error),
    /// Another tool is connected to the simulated board.
    #[error(
        "another tool is connected to {0}; close it first. To change gains while recording, use `haptic view` for both"
    )]
    HeldByAnother(String),
    /// The device of `sim:FILE` cannot be simulated.
    #[error("{0}")]
    CannotSimulate(String),
    /// The board does not reply.
    #[error("the board does not reply ({what}); is this a haptic-bridge board? If it is, power-cycle it")]
    Silent {
        /// The request's path.
        what: &'static str,
    },
    /// No reply to a force, because a frame was lost or the computer was busy. The earlier force ends with its lease.
    #[error("no reply to a force within {} ms: the force or the reply was lost; send the next force", waited.as_millis())]
    Unanswered {
        /// Time waited.
        waited: std::time::Duration,
    },
    /// The board could not decode the message of a valid frame.
    #[error(
        "the board rejected the message {what}: {error}; flash the firmware that came with this tool: haptic flash"
    )]
    Rejected {
        /// The request's path.
        what: &'static str,
        /// postcard-rpc's reason.
        error: String,
    },
    /// A message that could not be encoded or decoded.
    #[error("the message {what} could not be decoded; flash the firmware that came with this tool: haptic flash")]
    Unreadable {
        /// The message's path.
        what: &'static str,
    },
    /// Tool and board have different versions of the protocol.
    #[error(
        "the board has protocol version {board} and this tool has version {tool}; \
         {}",
        if board < tool { "flash it: haptic flash" } else { "update this tool: it is older than the board's firmware" }
    )]
    Version {
        /// The board's version.
        board: u16,
        /// The tool's version.
        tool: u16,
    },
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
