//! The emulated USB port as a wire of the tool's client. Over this wire `haptic_host::link::Board` talks to the real
//! firmware, in lockstep and in the board's virtual time.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use haptic_host::link::Wire;

use crate::run::{MICROSECOND, VirtualBoard};

/// Default interval between two polls of the port, ns.
const POLL_INTERVAL_NS: u64 = 100 * MICROSECOND;

/// A board that a test and a wire share.
#[derive(Clone, Debug)]
pub struct Shared(Arc<Mutex<VirtualBoard>>);

impl Shared {
    /// Shares a board.
    #[must_use]
    pub fn new(board: VirtualBoard) -> Self {
        Self(Arc::new(Mutex::new(board)))
    }

    /// Locks the board, so that nothing else runs it meanwhile.
    pub fn board(&self) -> MutexGuard<'_, VirtualBoard> {
        self.0.lock().expect("no holder of the board panicked")
    }

    /// Returns a wire to the board's USB port.
    #[must_use]
    pub fn wire(&self) -> Box<dyn Wire> {
        self.wire_polled_every(POLL_INTERVAL_NS)
    }

    /// Returns a wire to the board's USB port, for a computer that polls the port every `interval` (ns).
    #[must_use]
    pub fn wire_polled_every(&self, interval: u64) -> Box<dyn Wire> {
        Box::new(UsbWire { shared: self.clone(), unread: Vec::new(), interval })
    }
}

struct UsbWire {
    shared: Shared,
    unread: Vec<u8>,
    interval: u64,
}

impl Wire for UsbWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let bytes = bytes.to_vec();
        let sent = self.shared.board().while_stopped(move |stopped| {
            let usb = stopped.usb();
            let ready = usb.is_ready();
            if ready {
                usb.write(&bytes);
            }
            ready
        });
        if sent { Ok(()) } else { Err(io::Error::new(io::ErrorKind::NotConnected, "the board's USB port is not open")) }
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let mut board = self.shared.board();
        let span = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX / 4);
        let until = board.now() + span;
        loop {
            if self.unread.is_empty() {
                self.unread = board.while_stopped(|stopped| stopped.usb().take());
            }
            if !self.unread.is_empty() {
                let count = self.unread.len().min(buffer.len());
                buffer[..count].copy_from_slice(&self.unread[..count]);
                self.unread.drain(..count);
                return Ok(count);
            }
            if board.now() >= until {
                return Ok(0);
            }
            let step = self.interval.min(until - board.now());
            board.run(step);
        }
    }

    fn now(&self) -> Duration {
        Duration::from_nanos(self.shared.board().now())
    }
}
