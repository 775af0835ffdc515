//! The serial port of a board that the page has opened: the worker (src/worker.js) carries its bytes.

use crate::{BUFFER, answer};
use haptic_host::link::Wire;
use std::io;
use std::time::Duration;

/// How much longer than over the tool's own ports an answer may take: the page's thread hands the bytes on, and may be
/// busy with something else.
const PAGE: Duration = Duration::from_secs(3);

/// The port; there is one.
pub struct PagePort;

impl Wire for PagePort {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        answer(bytes);
        worker::send();
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let there = worker::receive(buffer.len(), 1e3 * timeout.as_secs_f64());
        let came = BUFFER.take();
        if !there {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, String::from_utf8_lossy(&came)));
        }
        let count = came.len().min(buffer.len());
        buffer[..count].copy_from_slice(&came[..count]);
        Ok(count)
    }

    fn now(&self) -> Duration {
        Duration::try_from_secs_f64(1e-3 * worker::now()).unwrap_or_default()
    }

    fn slack(&self) -> Duration {
        PAGE
    }

    // The standard library draws the same numbers in every browser.
    fn draw(&mut self) -> u32 {
        worker::draw()
    }
}

/// What the worker does for the port.
#[cfg(target_arch = "wasm32")]
mod worker {
    #[link(wasm_import_module = "port")]
    unsafe extern "C" {
        /// Sends what is in the buffer.
        pub safe fn send();
        /// Waits at most so many milliseconds for bytes, and puts what has come into the buffer, at most so many bytes.
        /// False where the port is lost: the buffer says why.
        pub safe fn receive(most: usize, milliseconds: f64) -> bool;
        /// The time, in milliseconds.
        pub safe fn now() -> f64;
        /// A number drawn by chance.
        pub safe fn draw() -> u32;
    }
}

/// In tests another port stands in for the page's.
#[cfg(not(target_arch = "wasm32"))]
pub mod worker {
    use crate::{BUFFER, answer};
    use haptic_host::link::Wire;
    use std::cell::RefCell;
    use std::time::Duration;

    thread_local! {
        /// What is plugged in.
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
        answer(if count.is_some() { bytes } else { b"nothing is plugged in".into() });
        count.is_some()
    }

    pub fn now() -> f64 {
        PLUGGED.with_borrow(|port| port.as_ref().map_or(0.0, |port| 1e3 * port.now().as_secs_f64()))
    }

    pub fn draw() -> u32 {
        4
    }
}
