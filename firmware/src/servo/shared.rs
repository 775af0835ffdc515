//! Numbers that the control interrupt and the tasks share.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Numbers that the control interrupt and tasks show each other. The steps come first: the emulator's tests read them.
#[repr(C)]
pub struct Shared {
    /// Control steps since the start, wrapping.
    pub steps: AtomicU32,
    /// Those of them whose duties applied half a carrier period later than usual.
    pub late_steps: AtomicU32,
    /// Every how many control steps a frame is wanted; 0 for none.
    pub stream_divider: AtomicU32,
    /// Frames that found no place since the stream started.
    pub frames_dropped: AtomicU32,
    /// Steps that reached past the next crest.
    pub overruns: AtomicU32,
    /// The longest time from a crest to the end of its interrupt, core cycles, and how much it left until the valley.
    pub longest_cycles: AtomicU32,
    pub(super) least_left: AtomicU32,
    /// The gate drivers are up and set: the bridges may be connected, and while they are not, no current flows.
    pub gate_ready: AtomicBool,
    /// A flash operation is about to stall the program: missed crests are no overruns.
    pub stall_expected: AtomicBool,
}

impl Shared {
    pub(super) const fn new() -> Self {
        Self {
            steps: AtomicU32::new(0),
            late_steps: AtomicU32::new(0),
            stream_divider: AtomicU32::new(0),
            frames_dropped: AtomicU32::new(0),
            overruns: AtomicU32::new(0),
            longest_cycles: AtomicU32::new(0),
            least_left: AtomicU32::new(0),
            gate_ready: AtomicBool::new(false),
            stall_expected: AtomicBool::new(false),
        }
    }
}

/// One more; the control interrupt alone writes it.
pub(super) fn count(number: &AtomicU32) {
    number.store(number.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}
