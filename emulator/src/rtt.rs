//! Reads the firmware's log like a debug probe, from RTT up-channel 0 in RAM, and writes the read offset back.

use rigless::emulator::Memory;
use rigless::soc::Width;

/// Offset of the first up-channel's descriptor in the control block, after a name of 16 bytes and two counts.
const CHANNEL_OFFSET: u64 = 24;
const BUFFER_OFFSET: u64 = CHANNEL_OFFSET + 4;
const SIZE_OFFSET: u64 = CHANNEL_OFFSET + 8;
const WRITE_INDEX_OFFSET: u64 = CHANNEL_OFFSET + 12;
const READ_INDEX_OFFSET: u64 = CHANNEL_OFFSET + 16;

/// A reader of the firmware's log.
#[derive(Debug)]
pub struct Rtt {
    block: Option<u64>,
    read: Vec<u8>,
}

impl Rtt {
    /// Returns a reader of the control block at address `block`, or of nothing if the image has no log.
    #[must_use]
    pub fn new(block: Option<u64>) -> Self {
        Self { block, read: Vec::new() }
    }

    /// Empties the firmware's buffer.
    pub fn drain(&mut self, memory: &mut (impl Memory + ?Sized)) {
        let Some(block) = self.block else { return };
        let mut word = |offset| memory.read(block + offset, Width::W32).unwrap_or(0);
        let (buffer, size) = (word(BUFFER_OFFSET), word(SIZE_OFFSET));
        let (write, mut read) = (word(WRITE_INDEX_OFFSET), word(READ_INDEX_OFFSET));
        // Before the start-up code has run, the control block holds random RAM contents.
        if size == 0 || size > 1 << 16 || write >= size || read >= size {
            return;
        }
        while read != write {
            if let Ok(byte) = memory.read(buffer + read, Width::W8) {
                self.read.push(byte as u8);
            }
            read = (read + 1) % size;
        }
        // The control block is in RAM, so the write succeeds.
        let _ = memory.write(block + READ_INDEX_OFFSET, Width::W32, read);
    }

    /// Returns the bytes that were read since the last call.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.read)
    }
}
