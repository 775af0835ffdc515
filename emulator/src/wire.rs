//! The emulated USB port as the tool's own client knows wires: `haptic_host::link::Board` over it talks to the real
//! firmware, in lock step and on the board's own clock.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use haptic_host::link::Wire;

use crate::run::{MICROSECOND, VirtualBoard};

/// Time that the board runs between two looks at its port, unless told otherwise: ten looks a millisecond.
const LOOK: u64 = 100 * MICROSECOND;

/// A board that a test and a wire hold together.
#[derive(Clone, Debug)]
pub struct Shared(Arc<Mutex<VirtualBoard>>);

impl Shared {
    /// Shares a board.
    #[must_use]
    pub fn new(board: VirtualBoard) -> Self {
        Self(Arc::new(Mutex::new(board)))
    }

    /// Returns the board, locked, so that no one else runs it meanwhile.
    ///
    /// # Panics
    ///
    /// When a holder panicked with the board in hand.
    pub fn board(&self) -> MutexGuard<'_, VirtualBoard> {
        self.0.lock().expect("no holder of the board panicked")
    }

    /// A wire to its USB port.
    #[must_use]
    pub fn wire(&self) -> Box<dyn Wire> {
        self.wire_looking_every(LOOK)
    }

    /// A wire to its USB port for a computer that looks so often, in ns, whether something came: its answer to what
    /// came is up to that late.
    #[must_use]
    pub fn wire_looking_every(&self, look: u64) -> Box<dyn Wire> {
        Box::new(UsbWire { shared: self.clone(), waiting: Vec::new(), look })
    }
}

/// The serial port of the emulated board.
struct UsbWire {
    shared: Shared,
    waiting: Vec<u8>,
    look: u64,
}

impl Wire for UsbWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let bytes = bytes.to_vec();
        let sent = self.shared.board().with(move |bench| {
            let usb = bench.usb();
            let ready = usb.ready();
            if ready {
                usb.write(&bytes);
            }
            ready
        });
        if sent { Ok(()) } else { Err(io::Error::new(io::ErrorKind::NotConnected, "the port is not there")) }
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let mut board = self.shared.board();
        let span = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX / 4);
        let until = board.now() + span;
        loop {
            if self.waiting.is_empty() {
                self.waiting = board.with(|bench| bench.usb().take());
            }
            if !self.waiting.is_empty() {
                let count = self.waiting.len().min(buffer.len());
                buffer[..count].copy_from_slice(&self.waiting[..count]);
                self.waiting.drain(..count);
                return Ok(count);
            }
            if board.now() >= until {
                return Ok(0);
            }
            let step = self.look.min(until - board.now());
            board.run(step);
        }
    }

    fn now(&self) -> Duration {
        Duration::from_nanos(self.shared.board().now())
    }
}
