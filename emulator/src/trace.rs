//! Records every instruction of an interrupt handler, run by run, from the first instruction to the exception return.
//!
//! The tracer watches all code and keeps the instructions of the handler. A run ends where a return at call depth zero
//! goes to an unexpected address. This also covers a handler whose last instructions the compiler moved into a shared
//! function. Instructions of a preempting interrupt would be counted too, but nothing preempts the control interrupt.

use std::sync::Arc;

use rigless::emulator::Hit;

use crate::image::Firmware;

/// One run of a handler.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Run {
    /// Virtual time of the first instruction, ns.
    pub at: u64,
    /// Address of every instruction, in order.
    pub path: Vec<u32>,
}

/// Code of an image, which tells calls and returns from other instructions.
#[derive(Clone, Debug)]
pub struct Code {
    base: u32,
    bytes: Arc<[u8]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// BL or BLX.
    Call,
    /// BX lr, or the program counter loaded from the stack.
    Return,
    Other,
}

impl Code {
    /// Returns the code of `firmware`, or `None` for an image without code.
    #[must_use]
    pub fn from_firmware(firmware: &Firmware) -> Option<Self> {
        let (from, to) = firmware.text();
        let symbol = crate::image::Symbol { address: from, size: to - from };
        Some(Self { base: from as u32, bytes: firmware.code(symbol)?.into() })
    }

    /// Returns code that consists of `halves`, starting at `base`.
    #[cfg(test)]
    pub(crate) fn new(base: u32, halves: &[u16]) -> Self {
        Self { base, bytes: halves.iter().flat_map(|half| half.to_le_bytes()).collect() }
    }

    /// Returns every address at which an instruction could start.
    pub fn addresses(&self) -> impl Iterator<Item = u64> + use<> {
        let (base, len) = (u64::from(self.base), self.bytes.len() as u64);
        (base..base + len).step_by(2)
    }

    /// Returns the half-word at `at`, or 0 outside the code.
    pub(crate) fn half_word(&self, at: u32) -> u16 {
        let offset = at.wrapping_sub(self.base) as usize;
        self.bytes.get(offset..offset + 2).map_or(0, |pair| u16::from_le_bytes([pair[0], pair[1]]))
    }

    /// Returns the kind and the length (bytes) of the instruction at `at` (ARMv7-M Architecture Reference Manual, A5).
    fn decode(&self, at: u32) -> (Kind, u32) {
        let first = self.half_word(at);
        if first >> 11 < 0b11101 {
            let kind = match first {
                0x4770 => Kind::Return,
                _ if first & 0xFF80 == 0x4780 => Kind::Call,
                _ if first & 0xFF00 == 0xBD00 => Kind::Return,
                _ => Kind::Other,
            };
            return (kind, 2);
        }
        let second = self.half_word(at + 2);
        let kind = match first {
            _ if first & 0xF800 == 0xF000 && second & 0xD000 == 0xD000 => Kind::Call,
            0xE8BD if second & 0x8000 != 0 => Kind::Return,
            0xF85D if second & 0xF000 == 0xF000 => Kind::Return,
            _ => Kind::Other,
        };
        (kind, 4)
    }
}

/// Follows calls and returns along a path of instructions.
#[derive(Clone, Debug)]
struct Walker {
    code: Code,
    last: u32,
    returns: Vec<u32>,
}

impl Walker {
    /// Returns a walker at `entry` that has executed nothing.
    fn new(code: Code, entry: u32) -> Self {
        Self { code, last: entry, returns: Vec::new() }
    }

    /// Advances to the instruction at `next`. Returns true if this step ends the handler by returning from it.
    fn ends_handler(&mut self, next: u32) -> bool {
        let (kind, length) = self.code.decode(self.last);
        let following = self.last + length;
        self.last = next;
        match kind {
            _ if next == following => {}
            Kind::Call => self.returns.push(following),
            Kind::Return if self.returns.last() == Some(&next) => drop(self.returns.pop()),
            Kind::Return => return self.returns.is_empty(),
            Kind::Other => {}
        }
        false
    }
}

/// Collects the runs of a handler from hits of watches on all code.
#[derive(Debug)]
pub struct Tracer {
    code: Code,
    entry: u32,
    current_run: Option<(Run, Walker)>,
    last_count: u64,
    runs: Vec<Run>,
}

impl Tracer {
    /// Returns a tracer of the handler that starts at `entry`.
    #[must_use]
    pub fn new(code: Code, entry: u32) -> Self {
        Self { code, entry, current_run: None, last_count: 0, runs: Vec::new() }
    }

    /// Handles a hit. If a stop of the emulator reports an instruction twice, it is counted once.
    pub fn feed(&mut self, hit: &Hit) {
        if std::mem::replace(&mut self.last_count, hit.instruction_count) == hit.instruction_count {
            return;
        }
        let at = hit.address as u32;
        if let Some((run, walker)) = &mut self.current_run {
            if !walker.ends_handler(at) {
                run.path.push(at);
                return;
            }
            self.runs.extend(self.current_run.take().map(|(run, _)| run));
        }
        if at == self.entry {
            let run = Run { at: hit.at.0, path: vec![at] };
            self.current_run = Some((run, Walker::new(self.code.clone(), at)));
        }
    }

    /// Returns the complete runs so far. An unfinished run is dropped.
    #[must_use]
    pub fn finish(self) -> Vec<Run> {
        self.runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(halves: &[u16]) -> Code {
        Code::new(0x1000, halves)
    }

    #[test]
    fn a_walk_ends_when_the_first_function_returns() {
        // 1000: bl 1008; 1004: b.w 100A (a shared ending); 1008: bx lr; 100A: pop {pc}
        let code = code(&[0xF000, 0xF802, 0xF000, 0xB801, 0x4770, 0xBD00]);
        let mut walker = Walker::new(code, 0x1000);
        assert_eq!([0x1008, 0x1004, 0x100A, 0x2000].map(|at| walker.ends_handler(at)), [false, false, false, true]);
    }

    #[test]
    fn a_return_skipped_by_its_condition_is_not_a_return() {
        // 1000: bx lr, skipped in an IT block; 1002: nop
        let code = code(&[0x4770, 0xBF00]);
        assert!(!Walker::new(code, 0x1000).ends_handler(0x1002));
    }
}
