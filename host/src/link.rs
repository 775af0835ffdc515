//! The link to a board: finds and opens the port, calls the endpoints, receives telemetry.
//!
//! The frames have the format of `postcard-rpc` (docs/protocol.md), and are sent over a USB serial port, a
//! pseudo-terminal, TCP, or in memory to a simulated board. Unlike postcard-rpc's own client, this client is
//! synchronous and has no threads. A simulated board therefore runs in lock step with its caller, and tests do not
//! depend on a scheduler.

mod board;
mod client;
mod disarm;
mod error;
mod framing;
mod open;
mod ports;
mod session;
mod telemetry;
mod wire;

pub use board::{Board, FORCE_PATIENCE, PolarityOutcome, StopOutcome};
pub use client::{Client, OccupiedTopic, SentRequest, TopicFrame};
pub use disarm::disarm_held_board;
pub use error::{BoardError, LinkError};
pub use framing::{Deframer, MAX_FRAME, Packet, encode, encode_plain};
pub use ports::{BoardPort, PortSpec, USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR, boards};
pub use session::{FADE_S, HOLD_S, PATIENCE, Session};
pub use telemetry::{Column, Losses, Row, columns, fields, max_rows_per_second, unit_of};
pub use wire::{SerialWire, TcpWire, Wire, should_retry};
