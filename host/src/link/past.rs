//! Disarming a board that another tool holds.
//!
//! Over TCP the simulated board lets this one request through, and answers it. A pseudo-terminal can be opened beside
//! the tool that holds it; both then read what the board says, so an answer may go to the other one, and the request is
//! sent again. A real serial port is the other tool's alone: end that tool (Ctrl-C), or pull the USB cable, which
//! disarms a board that watches its host.

use super::client::Client;
use super::error::{BoardError, LinkError};
use super::ports::{self, PortSpec};
use haptic_bridge::board::protocol::Disarm;
use std::time::Duration;

/// How long the answer to one request is waited for.
const PATIENCE: Duration = Duration::from_millis(400);
/// How often the request is sent at most where another tool may read the answer: for ten seconds.
const TRIES: usize = 25;

/// Has the board at `port` disarm although another tool holds it.
///
/// Errors: [`LinkError::PortBusy`] where there is no way past the other tool; [`LinkError::Silent`] when the request
/// was sent and no answer came.
pub fn disarm_past(port: &PortSpec) -> Result<(), BoardError> {
    let (wire, tries) = match port {
        PortSpec::Tcp(address) => (ports::open_tcp(address)?, 1),
        PortSpec::Serial(name) => (ports::open_beside(Some(name))?, TRIES),
        PortSpec::Find | PortSpec::Sim(_) => (ports::open_beside(None)?, TRIES),
    };
    let mut client = Client::new(wire);
    for _ in 1..tries {
        match client.call::<Disarm>(&(), PATIENCE) {
            Err(LinkError::Silent { .. }) => {}
            answered => return Ok(answered??),
        }
    }
    Ok(client.call::<Disarm>(&(), PATIENCE + client.slack())??)
}
