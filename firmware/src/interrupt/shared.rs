//! The numbers that the control interrupt and the tasks share.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Numbers shared by the control interrupt and the tasks. `steps` comes first, because the emulator's tests read it.
#[repr(C)]
pub struct Shared {
    /// Control steps since the start, wrapping.
    pub steps: AtomicU32,
    /// Control steps whose duties applied half a carrier period late.
    pub late_steps: AtomicU32,
    /// Control steps per streamed frame; 0 without a stream.
    pub stream_divider: AtomicU32,
    /// Frames dropped because the ring was full, since the stream started.
    pub frames_dropped: AtomicU32,
    /// Steps that lasted past the next crest.
    pub overruns: AtomicU32,
    /// Longest time from a crest to the end of its interrupt, core cycles.
    pub longest_cycles: AtomicU32,
    /// Shortest time so far from the end of a crest's work to the valley, core cycles.
    pub(super) least_margin: AtomicU32,
    /// True if the gate drivers are enabled and configured, so that the bridges may be connected.
    pub gate_ready: AtomicBool,
    /// True while a flash operation may stall the program, so that missed crests do not count as overruns.
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
            least_margin: AtomicU32::new(0),
            gate_ready: AtomicBool::new(false),
            stall_expected: AtomicBool::new(false),
        }
    }
}

/// Adds 1 to a counter that only the control interrupt writes.
pub(super) fn increment(number: &AtomicU32) {
    number.store(number.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}
