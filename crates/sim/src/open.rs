//! Opens the board that `--port` names: a simulated board in this process, or a board on a wire.

use crate::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
use haptic_host::device_file::DeviceFile;
use haptic_host::link::{Board, BoardError, LinkError, PortSpec, StopOutcome, Wire};
use std::path::Path;

/// Finds and opens the real or simulated board at `port`, and checks its protocol version.
pub fn open(port: &PortSpec) -> Result<Board, LinkError> {
    match port {
        PortSpec::Sim(device) => Board::over(simulated(device.as_deref())?, PORT_NAME),
        _ => Board::open(port),
    }
}

/// Turns the motors of the board at `port` off, see [`Board::stop`].
pub fn stop(port: &PortSpec) -> Result<StopOutcome, BoardError> {
    match port {
        PortSpec::Sim(device) => Board::stop_over(simulated(device.as_deref())?, PORT_NAME),
        _ => Board::stop(port),
    }
}

/// Port name of a simulated board in messages.
const PORT_NAME: &str = "sim";

/// Opens a simulated board with the device of `--port sim:FILE`, or with the shipped device of `--port sim`.
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
