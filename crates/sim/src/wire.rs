//! A simulated board in this process, in lock step with its caller: simulated time advances only while the caller
//! waits.

use super::board::{BoardOptions, SimulatedBoard};
use super::device::DeviceError;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::Wire;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The device of `--port sim`.
pub use haptic_bridge::model::shipped::COUPLED_FIVE_BAR as SHIPPED_DEVICE;

/// A simulated board that is shared by its wire and its owner.
#[derive(Clone, Debug)]
pub struct SharedBoard(Arc<Mutex<SimulatedBoard>>);

impl SharedBoard {
    /// Shares a board.
    pub fn new(board: SimulatedBoard) -> Self {
        Self(Arc::new(Mutex::new(board)))
    }
    /// Locks the board until the guard is dropped.
    pub fn lock(&self) -> MutexGuard<'_, SimulatedBoard> {
        // After a panic in another thread the board is still valid, because it holds only numbers.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
    /// Returns a wire to the board.
    pub fn wire(&self) -> Box<dyn Wire> {
        Box::new(SimulatedWire(self.clone()))
    }
}

struct SimulatedWire(SharedBoard);

impl Wire for SimulatedWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().receive(bytes);
        Ok(())
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let mut board = self.0.lock();
        let until = board.time() + timeout.as_secs_f64();
        while !board.has_bytes() && board.time() < until {
            board.control_period();
        }
        Ok(board.take_bytes(buffer))
    }

    fn now(&self) -> Duration {
        Duration::from_secs_f64(self.0.lock().time())
    }
}

/// Creates a simulated board with the supply and the device of `file`, and loads the device unless the board refuses
/// it.
pub fn ready_board(file: &DeviceFile, mut options: BoardOptions) -> Result<SimulatedBoard, DeviceError> {
    options.device.bridge.bus_voltage = file.supply.unwrap_or(options.device.bridge.bus_voltage);
    let mut board = SimulatedBoard::new(&file.description, options)?;
    // Ignores a refusal, which the tool reports when it loads the device again.
    let _ = board.load(&file.name, &file.description, None);
    Ok(board)
}
