//! The simulated board's end of the link, which converts bytes to frames and frames to bytes.

use haptic_bridge::board::dispatch;
use haptic_bridge::board::protocol::MAX_FRAME;
use haptic_host::link::{Deframer, encode_plain};
use postcard_rpc::Topic;
use serde::Serialize;
use std::collections::VecDeque;

/// Size of the buffer for replies in addition to the buffer for telemetry, bytes.
const REPLY_BUFFER_BYTES: usize = 64 * 1024;

/// Incoming and outgoing bytes.
#[derive(Debug)]
pub(super) struct Port {
    deframer: Deframer,
    out: VecDeque<u8>,
    capacity: usize,
    sequence: u16,
}

impl Port {
    /// Creates a port with a buffer of `capacity` bytes for telemetry.
    pub(super) fn new(capacity: usize) -> Self {
        Self { deframer: Deframer::default(), out: VecDeque::new(), capacity, sequence: 0 }
    }
    /// Returns the frames that these bytes complete.
    pub(super) fn take_in(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut frames = Vec::new();
        self.deframer.feed_plain(bytes, |frame| frames.push(frame.to_vec()));
        frames
    }

    /// Moves bytes for the host to `buffer` and returns their number.
    pub(super) fn take_out(&mut self, buffer: &mut [u8]) -> usize {
        let count = buffer.len().min(self.out.len());
        for (to, from) in buffer.iter_mut().zip(self.out.drain(..count)) {
            *to = from;
        }
        count
    }

    pub(super) fn is_empty(&self) -> bool {
        self.out.is_empty()
    }
    /// Returns true if the buffer has room for more telemetry.
    pub(super) fn has_room(&self) -> bool {
        self.out.len() < self.capacity
    }
    /// Drops all bytes, and begins the next output with a delimiter, because the host may have a partial frame.
    pub(super) fn clear(&mut self) {
        self.deframer = Deframer::default();
        self.out.clear();
        self.out.push_back(0);
    }

    /// Sends a frame. Drops the frame if the buffer is full, as a board does; a tool that reads its replies never fills
    /// the buffer.
    pub(super) fn send(&mut self, frame: &[u8]) {
        if self.out.len() < self.capacity + REPLY_BUFFER_BYTES {
            self.out.extend(encode_plain(frame));
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
