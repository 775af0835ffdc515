//! The simulated board's end of the link: bytes in, frames out of them; frames in, bytes out of them.

use haptic_bridge::board::dispatch;
use haptic_bridge::board::protocol::MAX_FRAME;
use haptic_host::link::{Deframer, envelope};
use postcard_rpc::Topic;
use serde::Serialize;
use std::collections::VecDeque;

/// Room for answers beside the telemetry that was not read, bytes.
const ANSWERS: usize = 64 * 1024;

/// Bytes on their way in and out.
#[derive(Debug)]
pub(super) struct Port {
    deframer: Deframer,
    out: VecDeque<u8>,
    capacity: usize,
    sequence: u16,
}

impl Port {
    /// A port with room for `capacity` bytes of telemetry that the host has not read.
    pub(super) fn new(capacity: usize) -> Self {
        Self { deframer: Deframer::default(), out: VecDeque::new(), capacity, sequence: 0 }
    }

    /// Frames that these bytes complete.
    pub(super) fn take_in(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut frames = Vec::new();
        self.deframer.feed_plain(bytes, |frame| frames.push(frame.to_vec()));
        frames
    }

    /// Bytes for the host, as many as fit; returns how many.
    pub(super) fn take_out(&mut self, buffer: &mut [u8]) -> usize {
        let count = buffer.len().min(self.out.len());
        for (to, from) in buffer.iter_mut().zip(self.out.drain(..count)) {
            *to = from;
        }
        count
    }

    /// Returns true if no bytes wait for the host.
    pub(super) fn is_empty(&self) -> bool {
        self.out.is_empty()
    }

    /// Returns true if the host reads fast enough for more telemetry.
    pub(super) fn has_room(&self) -> bool {
        self.out.len() < self.capacity
    }

    /// Forgets everything on its way. What goes out next begins with a delimiter: the host may hold half a frame.
    pub(super) fn clear(&mut self) {
        self.deframer = Deframer::default();
        self.out.clear();
        self.out.push_back(0);
    }

    /// Sends an answer. There is room for more of them than a tool asks for before it reads; to one that asks and does
    /// not read, the rest is lost, as it is on a board.
    pub(super) fn send(&mut self, frame: &[u8]) {
        if self.out.len() < self.capacity + ANSWERS {
            self.out.extend(envelope(frame));
        }
    }

    /// Sends a topic message.
    pub(super) fn publish<T: Topic>(&mut self, message: &T::Message)
    where
        T::Message: Serialize + Sized,
    {
        let mut frame = [0; MAX_FRAME];
        if let Some(frame) = dispatch::publish::<T>(self.sequence, message, &mut frame) {
            self.sequence = self.sequence.wrapping_add(1);
            self.send(frame);
        }
    }
}
