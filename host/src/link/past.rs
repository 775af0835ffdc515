//! Disarming a board that another tool holds.
//!
//! Over TCP the simulated board lets this one request through. A pseudo-terminal can be opened beside the tool that
//! holds it; both then read what the board says, so an answer may go to the other one, and the request is sent again.
//! A real serial port is the other tool's alone: end that tool (Ctrl-C), or pull the USB cable, which disarms a board
//! that watches its host.

use super::client::Client;
use super::error::{BoardError, LinkError};
use super::ports::{self, PortSpec};
use haptic_bridge::board::protocol::Disarm;
use std::time::Duration;

/// How long the answer to one request is waited for.
const PATIENCE: Duration = Duration::from_millis(400);
/// How often the request is sent again before the answer is given up.
const AGAIN: usize = 4;

/// Has the board at `port` disarm although another tool holds it.
///
/// Errors: [`LinkError::PortBusy`] where there is no way past the other tool; [`LinkError::Silent`] when the request
/// was sent and no answer came.
pub fn disarm_past(port: &PortSpec) -> Result<(), BoardError> {
    let wire = match port {
        PortSpec::Tcp(address) => ports::open_tcp(address)?,
        PortSpec::Serial(name) => ports::open_beside(Some(name))?,
        PortSpec::Find | PortSpec::Sim(_) => ports::open_beside(None)?,
    };
    let mut client = Client::new(wire);
    for _ in 0..AGAIN {
        match client.call::<Disarm>(&(), PATIENCE) {
            Err(LinkError::Silent { .. }) => {}
            answered => return Ok(answered??),
        }
    }
    Ok(client.call::<Disarm>(&(), PATIENCE)??)
}
