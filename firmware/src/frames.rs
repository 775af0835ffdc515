//! The ring of telemetry frames from the control interrupt to a task, written and read in place.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicUsize, Ordering, compiler_fence};

use haptic_bridge::board::telemetry;
use haptic_bridge::control::frame::StepRecord;

/// Number of places in the ring: 5 ms of frames at 20 kHz.
const RING_PLACES: usize = 100;

/// A ring of frames. The places from `first` up to `next` hold frames. One place is always empty.
#[repr(C)]
pub struct Frames {
    /// Index of the oldest frame. Only the reader changes it.
    first: AtomicUsize,
    /// Index of the place to write next. Only the writer changes it.
    next: AtomicUsize,
    places: [UnsafeCell<MaybeUninit<StepRecord>>; RING_PLACES],
}

// SAFETY: there is one writer, the control interrupt, and one reader, see [`FrameReader::new`]. A place belongs to the
// writer until the writer moves `next` past it, and then to the reader until the reader moves `first` past it. Writer
// and reader use only their own places.
unsafe impl Sync for Frames {}

impl Frames {
    pub const fn new() -> Self {
        Self {
            first: AtomicUsize::new(0),
            next: AtomicUsize::new(0),
            places: [const { UnsafeCell::new(MaybeUninit::uninit()) }; RING_PLACES],
        }
    }

    /// Lets `write` fill the next place, and publishes the frame. Returns false without writing if the ring is full.
    /// Only the control interrupt may call this.
    #[inline(always)]
    pub fn push(&self, write: impl FnOnce(&mut MaybeUninit<StepRecord>)) -> bool {
        let place = self.next.load(Ordering::Relaxed);
        let next = next_place(place);
        if next == self.first.load(Ordering::Relaxed) {
            return false;
        }
        // SAFETY: `place` is below RING_PLACES, because only `next_place` changes it, and it belongs to the writer.
        write(unsafe { &mut *self.places.get_unchecked(place).get() });
        // A compiler fence is enough, because the reader runs on the same core.
        compiler_fence(Ordering::Release);
        self.next.store(next, Ordering::Relaxed);
        true
    }
}

#[inline(always)]
fn next_place(place: usize) -> usize {
    if place + 1 < RING_PLACES { place + 1 } else { 0 }
}

/// The reader of a ring, owned by a task.
pub struct FrameReader(&'static Frames);

impl FrameReader {
    /// Creates the only reader of a ring. Call once.
    pub fn new(frames: &'static Frames) -> Self {
        Self(frames)
    }
}

impl telemetry::Frames for FrameReader {
    fn first(&self) -> Option<&StepRecord> {
        let place = self.0.first.load(Ordering::Relaxed);
        let has_frame = place != self.0.next.load(Ordering::Relaxed);
        compiler_fence(Ordering::Acquire);
        // SAFETY: the place holds a frame and belongs to the reader until `drop_first`, which borrows `self` mutably.
        has_frame.then(|| unsafe { (*self.0.places[place].get()).assume_init_ref() })
    }

    fn drop_first(&mut self) {
        let place = self.0.first.load(Ordering::Relaxed);
        if place != self.0.next.load(Ordering::Relaxed) {
            // The frame has been read, so the store below frees its place.
            compiler_fence(Ordering::Release);
            self.0.first.store(next_place(place), Ordering::Relaxed);
        }
    }
}
