//! The USB serial port as frames (COBS, terminated by a zero) in both directions. A slow host never stalls the board.
//!
//! Incoming: invalid bytes are skipped, and a lost connection discards a partial frame. Outgoing: at most two frames
//! wait. The USB core's interrupt passes on the next packet as soon as the previous one has left, so the bus does not
//! wait for a task. A host has [`MAX_READ_WAIT`] to read a frame; after that, frames are dropped until the host has
//! read one. A frame that has begun to leave is always sent completely.

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
use haptic_bridge::board::framing::{self, Decoder, max_wire_length};
use haptic_bridge::board::protocol::MAX_FRAME;
use heapless::{Deque, Vec};
use static_cell::ConstStaticCell;

/// The USB driver of this chip.
pub type UsbDriver = Driver<'static, USB_OTG_FS>;
pub type Serial = CdcAcmClass<'static, UsbDriver>;
/// Largest packet of a full-speed bulk endpoint.
pub const PACKET: usize = 64;
/// Longest wait for a host to make room for a frame. A turn of the link task sends at most three frames, and the task
/// must report to the supervisor once a second.
const MAX_READ_WAIT: Duration = Duration::from_millis(100);

/// Bytes aligned to words, for copies by words.
#[repr(align(4))]
pub struct Aligned<const N: usize>(pub [u8; N]);

/// An event on the link from the host.
pub enum Event<'f> {
    Frame(&'f [u8]),
    /// The host disconnected or reconnected, so its streams and replies are obsolete.
    Disconnected,
}

/// Frames from the host.
pub struct Incoming {
    receiver: Receiver<'static, UsbDriver>,
    packet: Aligned<PACKET>,
    position: usize,
    length: usize,
    decoder: Decoder,
}

impl Incoming {
    /// Creates the receiving half of a serial port.
    pub fn new(receiver: Receiver<'static, UsbDriver>) -> Self {
        Self { receiver, packet: Aligned([0; PACKET]), position: 0, length: 0, decoder: Decoder::default() }
    }

    /// Waits for the next frame. Dropping the future while it waits loses nothing.
    pub async fn next(&mut self) -> Event<'_> {
        loop {
            while let Some(left) = self.packet.0.get(self.position..self.length).filter(|left| !left.is_empty()) {
                let (taken, completed) = self.decoder.take(left);
                self.position += taken;
                if completed {
                    return Event::Frame(self.decoder.frame());
                }
            }
            match self.receiver.read_packet(&mut self.packet.0).await {
                Ok(filled) => (self.position, self.length) = (0, filled),
                Err(_) => {
                    self.receiver.wait_connection().await;
                    (self.position, self.length) = (0, 0);
                    self.decoder.forget();
                    return Event::Disconnected;
                }
            }
        }
    }
}

/// An outgoing frame: a delimiter that ends a partial frame at the host, then the frame and its delimiter.
struct Frame {
    bytes: [u8; 1 + max_wire_length(MAX_FRAME)],
    length: usize,
}

impl Frame {
    const EMPTY: Self = Self { bytes: [0; 1 + max_wire_length(MAX_FRAME)], length: 0 };
}

/// Maximum number of frames that wait to leave.
const MAX_WAITING: usize = 2;

/// Frames to the host.
pub struct Outgoing {
    frame: &'static mut Frame,
    is_stalled: bool,
}

impl Outgoing {
    /// Creates the sending half of a serial port. Call once.
    pub fn new(sender: Sender<'static, UsbDriver>) -> Self {
        static FRAMES: ConstStaticCell<[Frame; 1 + MAX_WAITING]> =
            ConstStaticCell::new([Frame::EMPTY; 1 + MAX_WAITING]);
        let [frame, free @ ..] = FRAMES.take();
        let (waiting, free, waker) = (Deque::new(), Vec::from_iter(free), WakerRegistration::new());
        SEND_QUEUE.lock(|queue| queue.replace(Some(SendQueue { sender, waiting, sent_bytes: 0, free, waker })));
        Self { frame, is_stalled: false }
    }

    /// Returns the buffer for the next frame, before encoding.
    pub fn buffer(&mut self) -> &mut [u8] {
        &mut self.frame.bytes[2..][..MAX_FRAME]
    }

    /// Sends the first `length` bytes of [`Outgoing::buffer`], or drops them if the host does not read earlier frames.
    pub async fn send(&mut self, length: usize) {
        let Some(length) = framing::encode(&mut self.frame.bytes[1..], length) else { return };
        self.frame.length = 1 + length;
        let mut free = with_queue(|queue| queue.free.pop()).flatten();
        // Does not wait for a host that did not read during an earlier wait.
        if free.is_none() && !self.is_stalled {
            free = with_timeout(MAX_READ_WAIT, poll_fn(poll_free)).await.ok();
        }
        self.is_stalled = free.is_none();
        let Some(free) = free else { return };
        let frame = core::mem::replace(&mut self.frame, free);
        with_queue(|queue| {
            // The queue has room for all frames except the frame that is being written.
            let _ = queue.waiting.push_back(frame);
            queue.send_next_packet();
        });
    }

    /// Discards the frames that have not left, because their host has gone.
    pub fn discard(&mut self) {
        with_queue(SendQueue::discard);
    }
}

/// The queue of outgoing frames, emptied by the USB core's interrupt.
struct SendQueue {
    sender: Sender<'static, UsbDriver>,
    waiting: Deque<&'static mut Frame, MAX_WAITING>,
    /// Number of bytes of the first frame that were passed to the USB core. Begins at 1 if the host holds no partial
    /// frame, because the frame's leading delimiter is then not needed.
    sent_bytes: usize,
    free: Vec<&'static mut Frame, MAX_WAITING>,
    /// The task that waits for a free frame.
    waker: WakerRegistration,
}

// SAFETY: `Sender` is not `Send` because it shares the state of the control lines with the task of the USB device.
// `SendQueue` only calls `write_packet`, which uses only the endpoint.
unsafe impl Send for SendQueue {}

static SEND_QUEUE: CriticalSectionMutex<RefCell<Option<SendQueue>>> = CriticalSectionMutex::new(RefCell::new(None));

/// Runs `work` on the queue while the USB core's interrupt is masked.
fn with_queue<R>(work: impl FnOnce(&mut SendQueue) -> R) -> Option<R> {
    SEND_QUEUE.lock(|queue| queue.borrow_mut().as_mut().map(work))
}

fn poll_free(context: &mut Context) -> Poll<&'static mut Frame> {
    let free = with_queue(|queue| {
        queue.waker.register(context.waker());
        queue.free.pop()
    });
    free.flatten().map_or(Poll::Pending, Poll::Ready)
}

impl SendQueue {
    /// Passes the next packet to the USB core, if the previous packet has left.
    #[inline(never)]
    fn send_next_packet(&mut self) {
        let Some(frame) = self.waiting.front() else { return };
        let left = &frame.bytes[self.sent_bytes..frame.length];
        // The last packet of a frame is always short, so that the host delivers the frame at once.
        let packet = if left.len() == PACKET { &left[..PACKET - 1] } else { &left[..left.len().min(PACKET)] };
        match poll_once(self.sender.write_packet(packet)) {
            Poll::Pending => {}
            Poll::Ready(Ok(())) if packet.len() < left.len() => self.sent_bytes += packet.len(),
            Poll::Ready(Ok(())) => {
                self.sent_bytes = 1;
                self.free_first();
            }
            Poll::Ready(Err(_)) => self.discard(),
        }
    }

    /// Frees all frames, because the host has gone.
    fn discard(&mut self) {
        self.sent_bytes = 0;
        while self.free_first() {}
    }

    /// Frees the first frame for the task. Returns false if the queue is empty.
    fn free_first(&mut self) -> bool {
        let Some(frame) = self.waiting.pop_front() else { return false };
        let _ = self.free.push(frame);
        self.waker.wake();
        true
    }
}

/// Handler of the USB core's interrupt that runs after the driver's own handler.
pub struct SendNextPacket;

impl typelevel::Handler<typelevel::OTG_FS> for SendNextPacket {
    unsafe fn on_interrupt() {
        with_queue(SendQueue::send_next_packet);
    }
}
