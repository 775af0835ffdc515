//! The telemetry stream: frames from the control interrupt, packed into batches for the link.

use core::sync::atomic::Ordering;

use embassy_time::{Duration, Instant};
use haptic_bridge::board::telemetry::{Batch, Frames as _, Packer, RowShape, StreamRequest};

use crate::interrupt;
use crate::machine::BoardMachine;

/// Longest time that a row waits for its batch to fill.
const MAX_ROW_WAIT: Duration = Duration::from_millis(5);

/// A stream as a tool requested it.
#[derive(Default)]
pub struct TelemetryStream {
    packer: Packer,
    last_batch: Option<Instant>,
}

impl TelemetryStream {
    /// Starts a stream of rows of a shape, or stops it when the request's divider is 0.
    pub fn start(&mut self, request: &StreamRequest, shape: RowShape, machine: &mut BoardMachine) {
        self.stop();
        while machine.frames.first().is_some() {
            machine.frames.drop_first();
        }
        self.packer.start(request, shape);
        interrupt::shared().frames_dropped.store(0, Ordering::Relaxed);
        interrupt::shared().stream_divider.store(request.divider, Ordering::Relaxed);
        self.last_batch = (request.divider > 0).then(Instant::now);
    }

    pub fn stop(&mut self) {
        interrupt::shared().stream_divider.store(0, Ordering::Relaxed);
        self.packer.stop();
        self.last_batch = None;
    }

    /// Returns true while the stream runs.
    pub fn is_running(&self) -> bool {
        self.last_batch.is_some()
    }

    /// Packs the waiting frames. Returns a batch that is full or has waited for [`MAX_ROW_WAIT`].
    pub fn batch(&mut self, machine: &mut BoardMachine) -> Option<&Batch> {
        let late = Instant::now().saturating_duration_since(self.last_batch?) > MAX_ROW_WAIT;
        let dropped = interrupt::shared().frames_dropped.load(Ordering::Relaxed);
        let batch = self.packer.drain(&mut machine.frames, dropped, late)?;
        self.last_batch = Some(Instant::now());
        Some(batch)
    }
}
