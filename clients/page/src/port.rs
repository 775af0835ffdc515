//! The serial port of a board that the page has opened. The worker (src/worker.js) carries its bytes.

use crate::{BUFFER, set_buffer};
use haptic_host::link::Wire;
use std::io;
use std::time::Duration;

/// Extra time that a reply may take, because the page's thread, which carries the bytes, may be busy.
const PAGE_SLACK: Duration = Duration::from_secs(3);

/// The port that the page has opened.
pub struct PagePort;

impl Wire for PagePort {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        set_buffer(bytes);
        worker::send();
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let is_open = worker::receive(buffer.len(), 1e3 * timeout.as_secs_f64());
        let bytes = BUFFER.take();
        if !is_open {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, String::from_utf8_lossy(&bytes)));
        }
        let count = bytes.len().min(buffer.len());
        buffer[..count].copy_from_slice(&bytes[..count]);
        Ok(count)
    }

    fn now(&self) -> Duration {
        Duration::try_from_secs_f64(1e-3 * worker::now()).unwrap_or_default()
    }
    fn slack(&self) -> Duration {
        PAGE_SLACK
    }
    // Uses the worker's numbers, because the standard library draws the same numbers in every browser.
    fn draw(&mut self) -> u32 {
        worker::draw()
    }
}

/// Functions of the worker.
#[cfg(target_arch = "wasm32")]
mod worker {
    #[link(wasm_import_module = "port")]
    unsafe extern "C" {
        /// Sends the contents of the buffer.
        pub safe fn send();
        /// Waits at most `milliseconds` for bytes and puts at most `most` bytes into the buffer. Returns false if the
        /// port is lost, with the reason in the buffer.
        pub safe fn receive(most: usize, milliseconds: f64) -> bool;
        /// Returns the time of the worker's clock, ms.
        pub safe fn now() -> f64;
        /// Draws a random number.
        pub safe fn draw() -> u32;
    }
}

/// A replacement of the worker for tests.
#[cfg(not(target_arch = "wasm32"))]
pub mod worker {
    use crate::{BUFFER, set_buffer};
    use haptic_host::link::Wire;
    use std::cell::RefCell;
    use std::time::Duration;

    thread_local! {
        /// The port that is plugged in.
        pub static PLUGGED: RefCell<Option<Box<dyn Wire>>> = const { RefCell::new(None) };
    }

    pub fn send() {
        let bytes = BUFFER.take();
        let _ = PLUGGED.with_borrow_mut(|port| port.as_mut().map(|port| port.send(&bytes)));
    }

    pub fn receive(most: usize, milliseconds: f64) -> bool {
        let mut bytes = vec![0; most];
        let timeout = Duration::from_secs_f64(1e-3 * milliseconds);
        let count = PLUGGED.with_borrow_mut(|port| port.as_mut()?.receive(&mut bytes, timeout).ok());
        bytes.truncate(count.unwrap_or(0));
        set_buffer(if count.is_some() { bytes } else { b"nothing is plugged in".into() });
        count.is_some()
    }

    pub fn now() -> f64 {
        PLUGGED.with_borrow(|port| port.as_ref().map_or(0.0, |port| 1e3 * port.now().as_secs_f64()))
    }

    pub fn draw() -> u32 {
        4
    }
}
