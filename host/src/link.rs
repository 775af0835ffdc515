//! Talking to a board: find it, open its port, call its endpoints, follow its telemetry.
//!
//! The bytes are `postcard-rpc`'s (its header, its keys, COBS frames ended by a zero), over a USB serial port, a
//! pseudo-terminal, TCP, or in memory to a simulated board. The client here is synchronous and has no threads, unlike
//! postcard-rpc's own: a simulated board then runs in lock step with its caller, so that what a test sees never
//! depends on a scheduler, and no telemetry is dropped on this side of the wire (docs/protocol.md).

mod board;
mod client;
mod error;
mod framing;
mod open;
mod past;
mod ports;
mod session;
mod telemetry;
mod wire;

pub use board::{Board, FORCE_PATIENCE, PolarityOutcome, Stopped};
pub use client::{Client, Occupied, Sent, TopicFrame};
pub use error::{BoardError, LinkError};
pub use framing::{Deframer, MAX_FRAME, Packet, encode, envelope};
pub use past::disarm_past;
pub use ports::{BoardPort, PortSpec, USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR, boards};
pub use session::{FADE, HOLD, PATIENCE, Session};
pub use telemetry::{Column, Losses, Row, columns, fields, rows_that_fit};
pub use wire::{SerialWire, TcpWire, Wire, nothing_yet};
