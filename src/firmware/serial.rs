//! The two directions of the USB serial port as byte streams that never fail and never hold the board up.
//!
//! In: a lost connection ends the frame that was under way (one zero byte, the frame delimiter) and waits for the next
//! connection. Out: a host that stops reading is given [`PATIENCE`]; from then on bytes are dropped until it reads again, and
//! what follows starts with a delimiter, so that only whole frames are lost after the first.

use core::convert::Infallible;
use core::future::{Future as _, poll_fn};
use core::pin::pin;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Poll;

use embassy_time::{Duration, with_timeout};
use embassy_usb::class::cdc_acm::{Receiver, Sender};
use embedded_io_async::{ErrorType, Read, Write};

use crate::link::UsbDriver;

/// Largest packet of a full-speed bulk endpoint.
pub const PACKET: usize = 64;

/// How long a host may leave a packet unread before the board stops waiting for it.
const PATIENCE: Duration = Duration::from_millis(100);

/// Bytes that no host took.
pub static DROPPED_BYTES: AtomicU32 = AtomicU32::new(0);

/// Bytes from the host.
pub struct Incoming {
    receiver: Receiver<'static, UsbDriver>,
    packet: [u8; PACKET],
    taken: usize,
    filled: usize,
}

impl Incoming {
    /// The receiving half of a serial port.
    pub fn new(receiver: Receiver<'static, UsbDriver>) -> Self {
        Self { receiver, packet: [0; PACKET], taken: 0, filled: 0 }
    }
}

impl ErrorType for Incoming {
    type Error = Infallible;
}

impl Read for Incoming {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        while self.taken == self.filled {
            self.taken = 0;
            self.filled = match self.receiver.read_packet(&mut self.packet).await {
                Ok(len) => len,
                Err(_) => {
                    self.receiver.wait_connection().await;
                    self.packet[0] = 0;
                    1
                }
            };
        }
        let len = bytes.len().min(self.filled - self.taken);
        bytes[..len].copy_from_slice(&self.packet[self.taken..self.taken + len]);
        self.taken += len;
        Ok(len)
    }
}

/// Bytes to the host.
pub struct Outgoing {
    sender: Sender<'static, UsbDriver>,
    stalled: bool,
}

impl Outgoing {
    /// The sending half of a serial port. Nobody has read anything yet, so it does not wait for the first packet.
    pub fn new(sender: Sender<'static, UsbDriver>) -> Self {
        Self { sender, stalled: true }
    }

    /// Sends one packet; false when it was dropped.
    async fn packet(&mut self, bytes: &[u8]) -> bool {
        let mut sending = pin!(self.sender.write_packet(bytes));
        let sent = if self.stalled {
            // One look, no waiting.
            poll_fn(|context| match sending.as_mut().poll(context) {
                Poll::Ready(result) => Poll::Ready(result.is_ok()),
                Poll::Pending => Poll::Ready(false),
            })
            .await
        } else {
            matches!(with_timeout(PATIENCE, sending).await, Ok(Ok(())))
        };
        self.stalled = !sent;
        sent
    }
}

impl ErrorType for Outgoing {
    type Error = Infallible;
}

impl Write for Outgoing {
    /// Takes all bytes, whatever becomes of them.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let resuming = self.stalled;
        if resuming && !self.packet(&[0]).await {
            DROPPED_BYTES.fetch_add(bytes.len() as u32, Ordering::Relaxed);
            return Ok(bytes.len());
        }
        let mut rest = bytes;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(rest.len().min(PACKET - 1));
            if !self.packet(now).await {
                DROPPED_BYTES.fetch_add(rest.len() as u32, Ordering::Relaxed);
                break;
            }
            rest = later;
        }
        Ok(bytes.len())
    }
}
