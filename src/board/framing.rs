//! Frames on the wire: COBS, which leaves no zero in a frame, and a zero after each.
//!
//! Written for a 32-bit processor with no time to spare: bytes without a zero among them move four at a time, and what
//! comes in is decoded as it comes, packet by packet. tests/framing.rs holds both to the `cobs` crate.

use crate::board::protocol::MAX_FRAME;
use core::cell::Cell;

/// Most bytes in a block: its code says how many follow before the next code, and whether a zero stands between.
const BLOCK: usize = 254;

/// Most bytes that a frame of so many takes on the wire, its delimiter among them.
pub const fn most_on_wire(length: usize) -> usize {
    length + length / BLOCK + 2
}

/// The first bit of each of a word's bytes that is zero.
#[inline(always)]
fn zeros(word: u32) -> u32 {
    const REST: u32 = 0x7F7F_7F7F;
    !(((word & REST) + REST) | word | REST)
}

/// Encodes a frame of so many bytes where it lies, from the second place of `wire` on, and ends it with a delimiter:
/// how many bytes that makes from the first place on, or `None` where the wire is shorter than [`most_on_wire`].
#[inline(never)]
pub fn encode(wire: &mut [u8], length: usize) -> Option<usize> {
    wire.get(..most_on_wire(length))?;
    let (mut begin, mut end) = (0, length + 1);
    loop {
        let code = begin + link(wire.get_mut(begin..end)?);
        let full = code + BLOCK + 1;
        if end <= full {
            *wire.get_mut(code)? = (end - code) as u8;
            *wire.get_mut(end)? = 0;
            return Some(end + 1);
        }
        // Behind a full block stands no zero: the next one's code gets its place by moving the rest on.
        *wire.get_mut(code)? = u8::MAX;
        wire.copy_within(full..end, full + 1);
        (begin, end) = (full, end + 1);
    }
}

/// Puts into the first place, and into that of every zero, how far it is to the next zero, as long as that is no
/// further than a block: the place where this ends.
#[inline(always)]
fn link(wire: &mut [u8]) -> usize {
    let Some((first, bytes)) = Cell::from_mut(wire).as_slice_of_cells().split_first() else { return 0 };
    let (mut block, mut next) = (Block { code: first, place: 0 }, 1);
    let mut words = bytes.chunks_exact(4);
    for word in &mut words {
        if !block.link(word, core::array::from_fn(|i| word[i].get()), next) {
            return block.place;
        }
        next += 4;
    }
    // None of the bytes behind the last is zero.
    let rest = words.remainder();
    let mut last = [u8::MAX; 4];
    last.iter_mut().zip(rest).for_each(|(to, from)| *to = from.get());
    block.link(rest, last, next);
    block.place
}

/// A block whose end is looked for.
struct Block<'w> {
    code: &'w Cell<u8>,
    place: usize,
}

impl<'w> Block<'w> {
    /// Ends it, and those that begin there, at the zeros of a word from place `next` on; false where one is too far.
    #[inline(always)]
    fn link(&mut self, word: &'w [Cell<u8>], bytes: [u8; 4], next: usize) -> bool {
        let mut zeros = zeros(u32::from_le_bytes(bytes));
        while zeros != 0 {
            let nth = zeros.trailing_zeros() as usize / 8;
            let distance = next + nth - self.place;
            let Some(zero) = word.get(nth).filter(|_| distance <= BLOCK) else { return false };
            self.code.set(distance as u8);
            *self = Self { code: zero, place: next + nth };
            zeros &= zeros - 1;
        }
        true
    }
}

/// Finds frames in what comes in, however that is cut into pieces. Anything else is skipped.
#[derive(Clone, Debug)]
pub struct Decoder {
    bytes: [u8; MAX_FRAME],
    length: usize,
    /// Length of the frame that was completed last.
    completed: usize,
    /// Bytes of the present block that are yet to come.
    left: usize,
    /// True if a zero stands between the present block and the next.
    zero: bool,
    /// The present frame is longer than any valid frame.
    overlong: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self { bytes: [0; MAX_FRAME], length: 0, completed: 0, left: 0, zero: false, overlong: false }
    }
}

impl Decoder {
    /// Takes bytes in up to the end of the first frame among them: how many those are, and whether there was one.
    #[inline(never)]
    pub fn take(&mut self, bytes: &[u8]) -> (usize, bool) {
        let (mut length, mut left, mut zero) = (self.length, self.left, self.zero);
        let mut rest = bytes;
        loop {
            // Four bytes go together if none of them is special.
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
                let whole = left == 0 && !self.overlong && (zero || length > 0);
                self.forget();
                if whole {
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
                if !core::mem::replace(&mut zero, left < BLOCK) {
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
        (self.length, self.left, self.zero) = (length, left, zero);
        (bytes.len(), false)
    }

    /// The frame that was completed last, until more is taken in.
    pub fn frame(&self) -> &[u8] {
        self.bytes.get(..self.completed).unwrap_or(&[])
    }

    /// Ends the frame that is under way.
    pub fn forget(&mut self) {
        (self.length, self.left, self.zero, self.overlong) = (0, 0, false, false);
    }
}
