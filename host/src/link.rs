//! The link to a board: finding its port, opening it, calling the endpoints, receiving telemetry.
//!
//! The bytes are `postcard-rpc`'s (its header, its keys, COBS frames ended by a zero), over a USB serial port, a
//! pseudo-terminal, TCP, or in memory to a simulated board. Unlike postcard-rpc's own client, this one is synchronous
//! and has no threads: a simulated board runs in lock step with its caller, so tests do not depend on a scheduler, and
//! this side of the wire drops no telemetry (docs/protocol.md).

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

pub use board::{Board, FORCE_PATIENCE, PolarityOutcome, Stopped};
pub use client::{Client, Occupied, Sent, TopicFrame};
pub use disarm::disarm_held_board;
pub use error::{BoardError, LinkError};
pub use framing::{Deframer, MAX_FRAME, Packet, encode, envelope};
pub use ports::{BoardPort, PortSpec, USB_PRODUCT, USB_PRODUCT_NAME, USB_VENDOR, boards};
pub use session::{FADE, HOLD, PATIENCE, Session};
pub use telemetry::{Column, Losses, Row, columns, fields, max_rows_per_second};
pub use wire::{SerialWire, TcpWire, Wire, nothing_yet};
