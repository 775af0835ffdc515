//! The two directions of the USB serial port as frames (COBS, ended by a zero) that never hold the board up.
//!
//! In: what is no frame is skipped, and a lost connection ends the frame that was under way. Out: a host is given
//! [`PATIENCE`] for a whole frame, whether it stops reading or reads slowly; from then on frames are dropped until it
//! reads again, and what follows starts with a delimiter, so that only whole frames are lost after the first.

use core::future::{Future as _, poll_fn};
use core::pin::pin;
use core::task::Poll;

use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::Driver;
use embassy_time::{Duration, Instant, with_deadline};
use embassy_usb::class::cdc_acm::{CdcAcmClass, Receiver, Sender};
use haptic_bridge::board::protocol::MAX_FRAME;

/// The USB driver of this chip.
pub type UsbDriver = Driver<'static, USB_OTG_FS>;

/// The serial port.
pub type Serial = CdcAcmClass<'static, UsbDriver>;

/// Largest packet of a full-speed bulk endpoint.
pub const PACKET: usize = 64;

/// How long a host may take over a frame before the board stops waiting for it. A turn of the link task sends three at
/// most, and the watchdog wants to hear of it once a second.
const PATIENCE: Duration = Duration::from_millis(100);

/// Room for a frame with what COBS adds: a byte in 254, one more, and the delimiter.
const WIRE_FRAME: usize = MAX_FRAME + MAX_FRAME / 254 + 2;

/// What came from the host.
pub enum Event<'f> {
    /// A frame, decoded.
    Frame(&'f [u8]),
    /// The host has left, or arrived: whatever it had asked for is over.
    Disconnected,
}

/// Frames from the host.
pub struct Incoming {
    receiver: Receiver<'static, UsbDriver>,
    packet: [u8; PACKET],
    taken: usize,
    filled: usize,
    frame: [u8; WIRE_FRAME],
    length: usize,
    too_long: bool,
}

impl Incoming {
    /// The receiving half of a serial port.
    pub fn new(receiver: Receiver<'static, UsbDriver>) -> Self {
        Self { receiver, packet: [0; PACKET], taken: 0, filled: 0, frame: [0; WIRE_FRAME], length: 0, too_long: false }
    }

    /// Waits for the next frame. May be dropped while it waits; nothing is lost.
    pub async fn next(&mut self) -> Event<'_> {
        let length = loop {
            if let Some(length) = self.take() {
                break length;
            }
            match self.receiver.read_packet(&mut self.packet).await {
                Ok(filled) => (self.taken, self.filled) = (0, filled),
                Err(_) => {
                    self.receiver.wait_connection().await;
                    (self.taken, self.filled, self.length, self.too_long) = (0, 0, 0, false);
                    return Event::Disconnected;
                }
            }
        };
        Event::Frame(&self.frame[..length])
    }

    /// Moves bytes from the packet to the frame until one is complete; its length once decoded.
    fn take(&mut self) -> Option<usize> {
        while self.taken < self.filled {
            let left = &self.packet[self.taken..self.filled];
            let end = left.iter().position(|byte| *byte == 0);
            let piece = &left[..end.unwrap_or(left.len())];
            self.taken += piece.len() + usize::from(end.is_some());
            let after = self.length + piece.len();
            match self.frame.get_mut(self.length..after) {
                Some(room) => {
                    room.copy_from_slice(piece);
                    self.length = after;
                }
                None => self.too_long = true,
            }
            if end.is_none() {
                continue;
            }
            let length = core::mem::take(&mut self.length);
            if !core::mem::take(&mut self.too_long)
                && length > 0
                && let Ok(decoded) = cobs::decode_in_place(&mut self.frame[..length])
            {
                return Some(decoded);
            }
        }
        None
    }
}

/// Frames to the host.
pub struct Outgoing {
    sender: Sender<'static, UsbDriver>,
    wire: [u8; WIRE_FRAME],
    stalled: bool,
}

impl Outgoing {
    /// The sending half of a serial port. Nobody has read anything yet, so it does not wait for the first packet.
    pub fn new(sender: Sender<'static, UsbDriver>) -> Self {
        Self { sender, wire: [0; WIRE_FRAME], stalled: true }
    }

    /// Sends a frame (not yet encoded); false when the host did not take it.
    pub async fn send(&mut self, frame: &[u8]) -> bool {
        if frame.len() > MAX_FRAME {
            return false;
        }
        let length = cobs::encode(frame, &mut self.wire);
        self.wire[length] = 0;
        let deadline = Instant::now() + PATIENCE;
        if self.stalled && !packet(&mut self.sender, &mut self.stalled, deadline, &[0]).await {
            return false;
        }
        // One byte less than a full packet, so that the last packet of a frame is always a short one and goes to the
        // tool at once.
        for piece in self.wire[..=length].chunks(PACKET - 1) {
            if !packet(&mut self.sender, &mut self.stalled, deadline, piece).await {
                return false;
            }
        }
        true
    }
}

/// Sends one packet until `deadline`; false when it was dropped.
async fn packet(sender: &mut Sender<'static, UsbDriver>, stalled: &mut bool, deadline: Instant, bytes: &[u8]) -> bool {
    let mut sending = pin!(sender.write_packet(bytes));
    let sent = if *stalled {
        // One look, no waiting.
        poll_fn(|context| match sending.as_mut().poll(context) {
            Poll::Ready(result) => Poll::Ready(result.is_ok()),
            Poll::Pending => Poll::Ready(false),
        })
        .await
    } else {
        matches!(with_deadline(deadline, sending).await, Ok(Ok(())))
    };
    *stalled = !sent;
    sent
}
