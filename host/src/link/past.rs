//! Disarming a board that another tool holds.
//!
//! Over TCP the simulated board lets this one request through, and answers it. A pseudo-terminal can be opened beside
//! the tool that holds it; both then read what the board says, so an answer may go to the other one, and the request is
//! sent again. A real serial port is the other tool's alone: end that tool (Ctrl-C), or pull the USB cable, which
//! disarms a board that watches its host.

use super::client::{Client, Patience};
use super::error::{BoardError, LinkError};
use super::ports::{self, PortSpec};
use haptic_bridge::board::protocol::Disarm;
use std::time::Duration;

/// Time after which the request is sent again, because another tool may read the answer, and after which it is given up.
const PATIENCE: Patience = (Duration::from_millis(100), Duration::from_secs(4));
/// Connections that are tried: a crowd before a TCP door may push one out.
const TRIES: usize = 25;

/// Has the board at `port` disarm although another tool holds it.
///
/// Errors: [`LinkError::PortBusy`] where there is no way past the other tool; [`LinkError::Silent`] when the request
/// was sent and no answer came.
pub fn disarm_past(port: &PortSpec) -> Result<(), BoardError> {
    let open = || match port {
        PortSpec::Tcp(address) => ports::open_tcp(address),
        PortSpec::Serial(name) => ports::open_beside(Some(name)),
        PortSpec::Find | PortSpec::Sim(_) => ports::open_beside(None),
    };
    let mut client = Client::new(open()?);
    for _ in 1..TRIES {
        match client.call::<Disarm>(&(), PATIENCE) {
            Err(LinkError::Lost(_)) => client = Client::new(open()?),
            answered => return Ok(answered??),
        }
    }
    Ok(client.call::<Disarm>(&(), PATIENCE)??)
}
