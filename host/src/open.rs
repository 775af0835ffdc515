//! What `--port` means, opened: a board on a wire, or a simulated one in this process. It lies above both, so that the
//! link knows nothing of simulations, whose boards speak through it.

use crate::device_file::DeviceFile;
use crate::link::{Board, BoardError, LinkError, PortSpec, Stopped, Wire, open_serial, open_tcp};
use crate::sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
use std::path::Path;

impl Board {
    /// Finds and opens the board that `--port` means, and checks its protocol version.
    pub fn open(port: &PortSpec) -> Result<Self, LinkError> {
        let (wire, name) = wire(port)?;
        Self::over(wire, name)
    }

    /// Turns the motors of the board that `port` means off, whatever version of the protocol it speaks. Where another
    /// tool holds it, and that shows only at the port, this is an error, and [`crate::link::disarm_past`] a way.
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
        PortSpec::Sim(device) => Ok((simulated(device.as_deref())?, "sim".into())),
    }
}

/// Opens `--port sim` (the shipped device) or `--port sim:FILE`: a board with that device on it and loaded.
fn simulated(device: Option<&Path>) -> Result<Box<dyn Wire>, LinkError> {
    let file = match device {
        Some(path) => DeviceFile::load(path),
        None => DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml"),
    };
    let file = file.map_err(|error| LinkError::CannotSimulate(error.to_string()))?;
    let board = ready_board(&file, BoardOptions::default())
        .map_err(|error| LinkError::CannotSimulate(format!("{}: {error}", file.path.display())))?;
    Ok(SharedBoard::new(board).wire())
}
