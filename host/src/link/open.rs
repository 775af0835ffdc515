//! Opens the board that `--port` names, except a simulated board in this process, which `haptic-sim` opens.

use super::board::{Board, StopOutcome};
use super::error::{BoardError, LinkError};
use super::ports::{PortSpec, open_serial, open_tcp};
use super::wire::Wire;

impl Board {
    /// Finds and opens the board at `port`, and checks its protocol version. A program that should also open simulated
    /// boards calls `haptic_sim::open` instead.
    pub fn open(port: &PortSpec) -> Result<Self, LinkError> {
        let (wire, name) = wire(port)?;
        Self::over(wire, name)
    }
    /// Turns the motors of the board at `port` off, in any version of the protocol. Fails if another tool holds the
    /// port itself; then use [`super::disarm_held_board`].
    pub fn stop(port: &PortSpec) -> Result<StopOutcome, BoardError> {
        let (wire, name) = wire(port)?;
        Self::stop_over(wire, name)
    }
}

/// Opens the wire of `port`. Returns the wire and its name for messages.
fn wire(port: &PortSpec) -> Result<(Box<dyn Wire>, String), LinkError> {
    match port {
        PortSpec::Find => open_serial(None),
        PortSpec::Serial(name) => open_serial(Some(name)),
        PortSpec::Tcp(address) => Ok((open_tcp(address)?, format!("tcp:{address}"))),
        PortSpec::Sim(_) => Err(LinkError::CannotSimulate("this program contains no simulated board".into())),
    }
}
