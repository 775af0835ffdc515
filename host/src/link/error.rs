//! The errors between the tool and a board, each with its remedy.

use crate::error::{Choice, Failure};
use haptic_bridge::safety::refusal::Refusal;
use std::io;

/// Why a board could not be reached, or stopped being reachable.
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
    /// Several boards, and none was chosen.
    #[error("several boards found: {}; choose one by its port or its serial number", .0.join(", "))]
    SeveralBoards(Vec<String>),
    /// The port's name means nothing.
    #[error(
        "no port {name}, and no board on USB has that serial number: {reason}; `haptic board list` shows the boards that \
         are connected, and a simulated one is on the port that `haptic sim` prints"
    )]
    NoSuchPort {
        /// The port that was asked for.
        name: String,
        /// The operating system's message.
        reason: String,
    },
    /// Someone else has the port open.
    #[error(
        "port {0} is in use by another program (another `haptic`, a serial monitor, ModemManager); close it first. `haptic view` turns gains and records at once"
    )]
    PortBusy(String),
    /// Not allowed to open the port.
    #[error("no permission to open {0}; add yourself to its group: sudo usermod -aG dialout $USER, then log in again")]
    Forbidden(String),
    /// A TCP connection was not made.
    #[error("cannot connect to {address}: {error}; is a board served there?")]
    NotListening {
        /// The address that was tried.
        address: String,
        /// The operating system's error.
        error: io::Error,
    },
    /// The board or the wire went away.
    #[error("the board was unplugged or the connection was lost ({0}); plug it in again")]
    Lost(io::Error),
    /// Another tool is connected to the simulated board.
    #[error("another tool is connected to {0}; close it first. `haptic view` turns gains and records at once")]
    HeldByAnother(String),
    /// The device of `sim:FILE` cannot be simulated.
    #[error("{0}")]
    CannotSimulate(String),
    /// The board does not answer.
    #[error("the board does not answer ({what}); is this a haptic-bridge board? If it is, power-cycle it")]
    Silent {
        /// The request's path.
        what: &'static str,
    },
    /// A force was sent and its answer did not come: a frame was lost, or somebody else had the computer. What was
    /// asked for before ends with its lease; the next request goes on.
    #[error("no answer to a force within {} ms: it or its answer was lost; send the next one", waited.as_millis())]
    Unanswered {
        /// For how long it was waited for.
        waited: std::time::Duration,
    },
    /// The board understood the frame but not the message.
    #[error(
        "the board rejected the message {what}: {error}; flash the firmware that came with this tool: haptic flash"
    )]
    Rejected {
        /// The request's path.
        what: &'static str,
        /// postcard-rpc's reason.
        error: String,
    },
    /// A message that could not be read or written.
    #[error("the message {what} could not be decoded; flash the firmware that came with this tool: haptic flash")]
    Unreadable {
        /// The message's path.
        what: &'static str,
    },
    /// Tool and board speak different versions of the protocol.
    #[error(
        "the board speaks protocol version {board} and this tool version {tool}; \
         {}",
        if board < tool { "flash it: haptic flash" } else { "update this tool: it is older than the board's firmware" }
    )]
    Version {
        /// The board's.
        board: u16,
        /// The tool's.
        tool: u16,
    },
}

/// Why a board did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// It could not be asked.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// It refused.
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
