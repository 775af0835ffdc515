//! Opening the board that `--port` names. A simulated board has no wire: `haptic-sim` opens it, and uses these
//! functions for all others.

use super::board::{Board, Stopped};
use super::error::{BoardError, LinkError};
use super::ports::{PortSpec, open_serial, open_tcp};
use super::wire::Wire;

impl Board {
    /// Finds and opens the board that `port` means, and checks its protocol version. A program that is also to open
    /// simulated boards calls `haptic_sim::open` instead.
    pub fn open(port: &PortSpec) -> Result<Self, LinkError> {
        let (wire, name) = wire(port)?;
        Self::over(wire, name)
    }

    /// Turns the motors of the board that `port` means off, whatever version of the protocol it speaks. Where another
    /// tool holds it, and that shows only at the port, this is an error, and [`super::disarm_past`] a way.
    pub fn stop(port: &PortSpec) -> Result<Stopped, BoardError> {
        let (wire, name) = wire(port)?;
        Self::stop_over(wire, name)
    }
}

/// The wire that `port` means, and what messages call it.
fn wire(port: &PortSpec) -> Result<(Box<dyn Wire>, String), LinkError> {
    match port {
        PortSpec::Find => open_serial(None),
        PortSpec::Serial(name) => open_serial(Some(name)),
        PortSpec::Tcp(address) => Ok((open_tcp(address)?, format!("tcp:{address}"))),
        PortSpec::Sim(_) => Err(LinkError::CannotSimulate("this program brings no simulated board".into())),
    }
}
