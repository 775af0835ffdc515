//! Frames of the telemetry stream on their way from the control interrupt to a task: a ring whose places are written
//! where they lie, and read there.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicUsize, Ordering, compiler_fence};

use haptic_bridge::board::telemetry;
use haptic_bridge::servo::frame::StepRecord;

/// Frames that may wait: 5 ms at 20 kHz.
const PLACES: usize = 100;

/// The ring. The places from `first` up to `next` hold frames; one is always empty.
#[repr(C)]
pub struct Frames {
    /// The oldest frame, moved by the reader alone.
    first: AtomicUsize,
    /// The place to be written next, moved by the writer alone.
    next: AtomicUsize,
    places: [UnsafeCell<MaybeUninit<StepRecord>>; PLACES],
}

// SAFETY: there is one writer, the control interrupt, and one reader, see [`FrameReader::new`]. A place is the writer's until
// it moves `next` past it and then the reader's until that moves `first` past it; each leaves the other's places alone.
unsafe impl Sync for Frames {}

impl Frames {
    /// An empty ring.
    pub const fn new() -> Self {
        Self {
            first: AtomicUsize::new(0),
            next: AtomicUsize::new(0),
            places: [const { UnsafeCell::new(MaybeUninit::uninit()) }; PLACES],
        }
    }

    /// Hands on the frame that `write` puts into its place; false, and nothing written, where all places are taken. For the
    /// control interrupt alone.
    #[inline(always)]
    pub fn push(&self, write: impl FnOnce(&mut MaybeUninit<StepRecord>)) -> bool {
        let place = self.next.load(Ordering::Relaxed);
        let next = after(place);
        if next == self.first.load(Ordering::Relaxed) {
            return false;
        }
        // SAFETY: `place` is below PLACES, because only `after` moves it, and the writer's.
        write(unsafe { &mut *self.places.get_unchecked(place).get() });
        // The reader runs on the same core: it sees what was written before in the program.
        compiler_fence(Ordering::Release);
        self.next.store(next, Ordering::Relaxed);
        true
    }
}

#[inline(always)]
fn after(place: usize) -> usize {
    if place + 1 < PLACES { place + 1 } else { 0 }
}

/// The reader's end, for a task.
pub struct FrameReader(&'static Frames);

impl FrameReader {
    /// The one reader of a ring. Call once.
    pub fn new(frames: &'static Frames) -> Self {
        Self(frames)
    }
}

impl telemetry::Frames for FrameReader {
    fn first(&self) -> Option<&StepRecord> {
        let place = self.0.first.load(Ordering::Relaxed);
        let some = place != self.0.next.load(Ordering::Relaxed);
        compiler_fence(Ordering::Acquire);
        // SAFETY: the place holds a frame, and is the reader's until `drop_first`, which takes `self` for its own.
        some.then(|| unsafe { (*self.0.places[place].get()).assume_init_ref() })
    }

    fn drop_first(&mut self) {
        let place = self.0.first.load(Ordering::Relaxed);
        if place != self.0.next.load(Ordering::Relaxed) {
            // The frame has been read; the place is free from here on.
            compiler_fence(Ordering::Release);
            self.0.first.store(after(place), Ordering::Relaxed);
        }
    }
}
