//! The two directions of the USB serial port as frames (COBS, ended by a zero) that never hold the board up.
//!
//! In: what is no frame is skipped, and a lost connection ends the frame that was under way. Out: two frames are on their way
//! at most. The interrupt of the USB core hands the next packet over as soon as the one before has left, so that the bus
//! does not wait for a task. A host is given [`PATIENCE`] to take a frame, whether it stops reading or reads slowly; from then
//! on frames are dropped until it has read one. What has begun to leave leaves whole.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::{Context, Poll};

use embassy_futures::poll_once;
use embassy_stm32::interrupt::typelevel;
use embassy_stm32::peripherals::USB_OTG_FS;
use embassy_stm32::usb::Driver;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_sync::waitqueue::WakerRegistration;
use embassy_time::{Duration, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, Receiver, Sender};
use haptic_bridge::board::framing::{self, Decoder, most_on_wire};
use haptic_bridge::board::protocol::MAX_FRAME;
use heapless::{Deque, Vec};
use static_cell::ConstStaticCell;

/// The USB driver of this chip.
pub type UsbDriver = Driver<'static, USB_OTG_FS>;

/// The serial port.
pub type Serial = CdcAcmClass<'static, UsbDriver>;

/// Largest packet of a full-speed bulk endpoint.
pub const PACKET: usize = 64;

/// Longest time that a host may take over the queued frames before there is room for another. A turn of the link task
/// sends three at most, and the watchdog must hear of it once a second.
const PATIENCE: Duration = Duration::from_millis(100);

/// Bytes that are copied by words.
#[repr(align(4))]
pub struct Aligned<const N: usize>(pub [u8; N]);

/// An event on the link from the host.
pub enum Event<'f> {
    /// A frame, decoded.
    Frame(&'f [u8]),
    /// The host has left, or arrived: whatever it had asked for is over.
    Disconnected,
}

/// Frames from the host.
pub struct Incoming {
    receiver: Receiver<'static, UsbDriver>,
    packet: Aligned<PACKET>,
    taken: usize,
    filled: usize,
    decoder: Decoder,
}

impl Incoming {
    /// The receiving half of a serial port.
    pub fn new(receiver: Receiver<'static, UsbDriver>) -> Self {
        Self { receiver, packet: Aligned([0; PACKET]), taken: 0, filled: 0, decoder: Decoder::default() }
    }

    /// Waits for the next frame. May be dropped while it waits; nothing is lost.
    pub async fn next(&mut self) -> Event<'_> {
        loop {
            while let Some(left) = self.packet.0.get(self.taken..self.filled).filter(|left| !left.is_empty()) {
                let (taken, completed) = self.decoder.take(left);
                self.taken += taken;
                if completed {
                    return Event::Frame(self.decoder.frame());
                }
            }
            match self.receiver.read_packet(&mut self.packet.0).await {
                Ok(filled) => (self.taken, self.filled) = (0, filled),
                Err(_) => {
                    self.receiver.wait_connection().await;
                    (self.taken, self.filled) = (0, 0);
                    self.decoder.forget();
                    return Event::Disconnected;
                }
            }
        }
    }
}

/// A frame on its way out: a delimiter, for a host that has got the beginning of another, then the frame with its own.
struct Frame {
    bytes: [u8; 1 + most_on_wire(MAX_FRAME)],
    length: usize,
}

impl Frame {
    const EMPTY: Self = Self { bytes: [0; 1 + most_on_wire(MAX_FRAME)], length: 0 };
}

/// Frames that are on their way at most.
const ON_THEIR_WAY: usize = 2;

/// Frames to the host.
pub struct Outgoing {
    /// The one that is written.
    frame: &'static mut Frame,
    stalled: bool,
}

impl Outgoing {
    /// The sending half of a serial port. Call once.
    pub fn new(sender: Sender<'static, UsbDriver>) -> Self {
        static FRAMES: ConstStaticCell<[Frame; 1 + ON_THEIR_WAY]> =
            ConstStaticCell::new([Frame::EMPTY; 1 + ON_THEIR_WAY]);
        let [frame, free @ ..] = FRAMES.take();
        let (waiting, free, waker) = (Deque::new(), Vec::from_iter(free), WakerRegistration::new());
        LEAVING.lock(|leaving| leaving.replace(Some(Leaving { sender, waiting, begun: 0, free, waker })));
        Self { frame, stalled: false }
    }

    /// Buffer for the next frame, before it is encoded.
    pub fn place(&mut self) -> &mut [u8] {
        &mut self.frame.bytes[2..][..MAX_FRAME]
    }

    /// Sends the first bytes of [`Outgoing::place`], or drops them where the host does not take the frames before.
    pub async fn send(&mut self, length: usize) {
        let Some(length) = framing::encode(&mut self.frame.bytes[1..], length) else { return };
        self.frame.length = 1 + length;
        let mut free = with(|leaving| leaving.free.pop()).flatten();
        // One look, no waiting, at a host that has kept the board waiting.
        if free.is_none() && !self.stalled {
            free = with_timeout(PATIENCE, poll_fn(poll_free)).await.ok();
        }
        self.stalled = free.is_none();
        let Some(free) = free else { return };
        let frame = core::mem::replace(&mut self.frame, free);
        with(|leaving| {
            // There is room for all frames but the one that is written.
            let _ = leaving.waiting.push_back(frame);
            leaving.hand_over();
        });
    }

    /// Forgets what has not left yet: it was for a host that is gone.
    pub fn forget(&mut self) {
        with(Leaving::forget);
    }
}

/// Outgoing bytes, as the USB core's interrupt sees them.
struct Leaving {
    sender: Sender<'static, UsbDriver>,
    waiting: Deque<&'static mut Frame, ON_THEIR_WAY>,
    /// Bytes of the first of them that have been handed over. Its own first byte is only sent where the host may have got
    /// the beginning of another frame.
    begun: usize,
    free: Vec<&'static mut Frame, ON_THEIR_WAY>,
    /// The task that waits for a free one.
    waker: WakerRegistration,
}

// SAFETY: what keeps it from being sent is the state of the control lines that `Sender` shares with the task of the USB
// device. `Leaving` calls nothing of it but `write_packet`, which touches the endpoint alone.
unsafe impl Send for Leaving {}

static LEAVING: CriticalSectionMutex<RefCell<Option<Leaving>>> = CriticalSectionMutex::new(RefCell::new(None));

/// Does what is to be done without the interrupt coming in between.
fn with<R>(work: impl FnOnce(&mut Leaving) -> R) -> Option<R> {
    LEAVING.lock(|leaving| leaving.borrow_mut().as_mut().map(work))
}

/// Waits for a frame that is free.
fn poll_free(context: &mut Context) -> Poll<&'static mut Frame> {
    let free = with(|leaving| {
        leaving.waker.register(context.waker());
        leaving.free.pop()
    });
    free.flatten().map_or(Poll::Pending, Poll::Ready)
}

impl Leaving {
    /// Hands the next packet to the USB core, if there is one and the one before has left.
    #[inline(never)]
    fn hand_over(&mut self) {
        let Some(frame) = self.waiting.front() else { return };
        let left = &frame.bytes[self.begun..frame.length];
        // The last packet of a frame is always a short one, so that the frame goes to the tool at once.
        let packet = if left.len() == PACKET { &left[..PACKET - 1] } else { &left[..left.len().min(PACKET)] };
        match poll_once(self.sender.write_packet(packet)) {
            Poll::Pending => {}
            Poll::Ready(Ok(())) if packet.len() < left.len() => self.begun += packet.len(),
            Poll::Ready(Ok(())) => {
                self.begun = 1;
                self.free_first();
            }
            Poll::Ready(Err(_)) => self.forget(),
        }
    }

    /// The host is gone.
    fn forget(&mut self) {
        self.begun = 0;
        while self.free_first() {}
    }

    /// Lets the task have the first frame again, if there is one.
    fn free_first(&mut self) -> bool {
        let Some(frame) = self.waiting.pop_front() else { return false };
        let _ = self.free.push(frame);
        self.waker.wake();
        true
    }
}

/// The USB core interrupt's work after the driver's own handler.
pub struct HandOver;

impl typelevel::Handler<typelevel::OTG_FS> for HandOver {
    unsafe fn on_interrupt() {
        with(Leaving::hand_over);
    }
}
