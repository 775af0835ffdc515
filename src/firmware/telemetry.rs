//! The telemetry stream: frames from the control interrupt, packed into batches for the link.

use core::sync::atomic::Ordering;

use embassy_time::{Duration, Instant};
use haptic_bridge::telemetry::{Batch, Packer, StreamRequest};

use crate::machine::Panel;
use crate::servo;

/// Longest time that a row waits for its batch to fill.
const PATIENCE: Duration = Duration::from_millis(40);

/// A stream as one tool asked for it.
#[derive(Default)]
pub struct TelemetryStream {
    packer: Packer,
    batch: Batch,
    last: Option<Instant>,
}

impl TelemetryStream {
    /// Starts a stream for a device of `axes` joints, or stops it when the request's divider is 0.
    pub fn start(&mut self, request: &StreamRequest, axes: usize, panel: &mut Panel) {
        self.stop();
        while panel.frames.dequeue().is_some() {}
        self.packer.start(request, axes);
        servo::FRAMES_DROPPED.store(0, Ordering::Relaxed);
        servo::STREAM_DIVIDER.store(request.divider, Ordering::Relaxed);
        self.last = (request.divider > 0).then(Instant::now);
    }

    /// Ends it.
    pub fn stop(&mut self) {
        servo::STREAM_DIVIDER.store(0, Ordering::Relaxed);
        self.last = None;
    }

    /// Whether one is on.
    pub fn runs(&self) -> bool {
        self.last.is_some()
    }

    /// Packs what frames there are; a batch that is full or has waited long enough.
    pub fn batch(&mut self, panel: &mut Panel) -> Option<&Batch> {
        let last = self.last?;
        let dropped = servo::FRAMES_DROPPED.load(Ordering::Relaxed);
        let mut ready = None;
        while ready.is_none() {
            let Some(frame) = panel.frames.dequeue() else { break };
            if self.packer.wants(frame.step) {
                ready = self.packer.push(&frame, dropped);
            }
        }
        if ready.is_none() && last.elapsed() > PATIENCE {
            ready = self.packer.flush();
        }
        self.batch = ready?;
        self.last = Some(Instant::now());
        Some(&self.batch)
    }
}
