//! Disarms a board that another tool holds.
//!
//! Over TCP the simulated board accepts and carries out this one request. A second tool can open a pseudo-terminal too.
//! Both tools then read the board's bytes, so the request is sent again in case the holder reads the reply. A second
//! tool cannot open a real serial port: end the holder (Ctrl-C), or pull the USB cable, which disarms a board that
//! watches its host.

use super::client::{Client, Patience};
use super::error::{BoardError, LinkError};
use super::ports::{self, PortSpec};
use haptic_bridge::board::protocol::Disarm;
use std::time::Duration;

/// Retry interval and longest wait for the reply, which the other tool may read instead.
const PATIENCE: Patience = (Duration::from_millis(100), Duration::from_secs(4));
/// Number of connection attempts, because a TCP server with many clients may close a connection early.
const MAX_TRIES: usize = 25;

/// Disarms the board at `port` while another tool holds it.
///
/// Errors: [`LinkError::PortBusy`] if the port cannot be opened a second time; [`LinkError::Silent`] if the request was
/// sent and no reply came.
pub fn disarm_held_board(port: &PortSpec) -> Result<(), BoardError> {
    let open = || match port {
        PortSpec::Tcp(address) => ports::open_tcp(address),
        PortSpec::Serial(name) => ports::open_shared(Some(name)),
        PortSpec::Find | PortSpec::Sim(_) => ports::open_shared(None),
    };
    let mut client = Client::new(open()?);
    for _ in 1..MAX_TRIES {
        match client.call::<Disarm>(&(), PATIENCE) {
            Err(LinkError::Lost(_)) => client = Client::new(open()?),
            outcome => return Ok(outcome??),
        }
    }
    Ok(client.call::<Disarm>(&(), PATIENCE)??)
}
