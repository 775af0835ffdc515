//! Frames on the wire: COBS, which removes all zeros from a frame, and a zero after each frame.
//!
//! Written for a 32-bit processor with little time: bytes without zeros are handled four at a time, and received bytes
//! are decoded as they arrive. tests/framing.rs compares the results with the `cobs` crate.

use crate::board::protocol::MAX_FRAME;
use core::cell::Cell;

/// Maximum number of bytes in a block. Its code is the distance to the next code. A zero follows all but full blocks.
const MAX_BLOCK: usize = 254;

/// Returns the maximum length on the wire of a frame with `length` bytes, including its delimiter.
pub const fn max_wire_length(length: usize) -> usize {
    length + length / MAX_BLOCK + 2
}

/// Returns a word in which the top bit of each byte is set if the byte of `word` is zero.
#[inline(always)]
fn zeros(word: u32) -> u32 {
    const LOW_BITS: u32 = 0x7F7F_7F7F;
    !(((word & LOW_BITS) + LOW_BITS) | word | LOW_BITS)
}

/// Encodes in place a frame of `length` bytes that starts at the second byte of `wire`, and adds a delimiter. Returns
/// the number of bytes on the wire, or `None` if `wire` is shorter than [`max_wire_length`].
#[inline(never)]
pub fn encode(wire: &mut [u8], length: usize) -> Option<usize> {
    wire.get(..max_wire_length(length))?;
    let (mut begin, mut end) = (0, length + 1);
    loop {
        let code = begin + link_zeros(wire.get_mut(begin..end)?);
        let full = code + MAX_BLOCK + 1;
        if end <= full {
            *wire.get_mut(code)? = (end - code) as u8;
            *wire.get_mut(end)? = 0;
            return Some(end + 1);
        }
        // No zero follows a full block, so the rest moves by one byte to make room for the next block's code.
        *wire.get_mut(code)? = u8::MAX;
        wire.copy_within(full..end, full + 1);
        (begin, end) = (full, end + 1);
    }
}

/// Writes the distance to the next zero into the first byte and into each zero, as long as no distance exceeds a block.
/// Returns the position of the last code without a distance.
#[inline(always)]
fn link_zeros(wire: &mut [u8]) -> usize {
    let Some((first, bytes)) = Cell::from_mut(wire).as_slice_of_cells().split_first() else { return 0 };
    let (mut block, mut next) = (Block { code: first, place: 0 }, 1);
    let mut words = bytes.chunks_exact(4);
    for word in &mut words {
        if !block.link_zeros(word, core::array::from_fn(|i| word[i].get()), next) {
            return block.place;
        }
        next += 4;
    }
    // The padding after the last byte contains no zero.
    let rest = words.remainder();
    let mut last = [u8::MAX; 4];
    last.iter_mut().zip(rest).for_each(|(to, from)| *to = from.get());
    block.link_zeros(rest, last, next);
    block.place
}

/// A block whose end is not known yet.
struct Block<'w> {
    code: &'w Cell<u8>,
    place: usize,
}

impl<'w> Block<'w> {
    /// Ends this block and the blocks that begin at the zeros of the word at position `next`. Returns false if a
    /// distance is too long.
    #[inline(always)]
    fn link_zeros(&mut self, word: &'w [Cell<u8>], bytes: [u8; 4], next: usize) -> bool {
        let mut zeros = zeros(u32::from_le_bytes(bytes));
        while zeros != 0 {
            let nth = zeros.trailing_zeros() as usize / 8;
            let distance = next + nth - self.place;
            let Some(zero) = word.get(nth).filter(|_| distance <= MAX_BLOCK) else { return false };
            self.code.set(distance as u8);
            *self = Self { code: zero, place: next + nth };
            zeros &= zeros - 1;
        }
        true
    }
}

/// Finds frames in received bytes, which may arrive in pieces of any size. Skips invalid bytes.
#[derive(Clone, Debug)]
pub struct Decoder {
    bytes: [u8; MAX_FRAME],
    length: usize,
    /// Length of the last completed frame.
    completed: usize,
    /// Number of bytes missing in the present block.
    missing: usize,
    /// True if a zero follows the present block.
    zero_follows: bool,
    /// True if the present frame is longer than any valid frame.
    overlong: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self { bytes: [0; MAX_FRAME], length: 0, completed: 0, missing: 0, zero_follows: false, overlong: false }
    }
}

impl Decoder {
    /// Consumes bytes up to the end of the first frame. Returns the number of consumed bytes, and true after a frame.
    #[inline(never)]
    pub fn take(&mut self, bytes: &[u8]) -> (usize, bool) {
        let (mut length, mut left, mut zero) = (self.length, self.missing, self.zero_follows);
        let mut rest = bytes;
        loop {
            // Four bytes are handled together if all are data, or all are codes of single zeros.
            while let Some((&four, after)) = rest.split_first_chunk::<4>()
                && let Some(place) = self.bytes.get_mut(length..).and_then(<[u8]>::first_chunk_mut)
            {
                let word = u32::from_le_bytes(four);
                if left >= 4 && zeros(word) == 0 {
                    *place = four;
                    left -= 4;
                } else if left == 0 && zero && word == 0x0101_0101 {
                    *place = [0; 4];
                } else {
                    break;
                }
                (length, rest) = (length + 4, after);
            }
            let Some((&byte, after)) = rest.split_first() else { break };
            rest = after;
            let data = if byte == 0 {
                let is_complete = left == 0 && !self.overlong && (zero || length > 0);
                self.forget();
                if is_complete {
                    self.completed = length;
                    return (bytes.len() - rest.len(), true);
                }
                (length, left, zero) = (0, 0, false);
                continue;
            } else if left > 0 {
                left -= 1;
                byte
            } else {
                left = usize::from(byte) - 1;
                if !core::mem::replace(&mut zero, left < MAX_BLOCK) {
                    continue;
                }
                0
            };
            match self.bytes.get_mut(length) {
                Some(place) => {
                    *place = data;
                    length += 1;
                }
                None => self.overlong = true,
            }
        }
        (self.length, self.missing, self.zero_follows) = (length, left, zero);
        (bytes.len(), false)
    }

    /// Returns the last completed frame. Valid until the next [`Decoder::take`].
    pub fn frame(&self) -> &[u8] {
        self.bytes.get(..self.completed).unwrap_or(&[])
    }

    /// Drops the unfinished frame.
    pub fn forget(&mut self) {
        (self.length, self.missing, self.zero_follows, self.overlong) = (0, 0, false, false);
    }
}
