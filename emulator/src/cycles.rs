//! Estimates the cycles of a path of instructions that a Cortex-M4F runs from the flash of an STM32F405 at 168 MHz.
//!
//! The core follows the instruction timings of ARM's Cortex-M4 technical reference manual (r0p1, sections 3.3 and
//! 7.2.3). A load after a load is pipelined. A taken branch refills the pipeline in two cycles (one to three in the
//! manual). A skipped instruction counts as executed.
//!
//! The flash has five wait states per line of 16 bytes, which an accelerator hides (RM0090 sections 3.5.1 and 3.5.2).
//! The accelerator has a cache of 64 instruction lines, a cache of 8 constant lines, and a prefetch of the next line. A
//! running fetch ends before the next begins. The caches are empty at the first instruction. SRAM and registers have no
//! wait states. The bus load of DMA and USB is not included.

use std::collections::VecDeque;

use crate::trace::Code;

/// A model of the flash's delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flash {
    /// No wait states, so that only the core needs time.
    NoWaitStates,
    /// Wait states with both caches and prefetch.
    WithCaches,
    /// Wait states for every line, as after a reset.
    WithoutCaches,
}

impl Flash {
    /// All models, fastest first.
    pub const ALL: [Self; 3] = [Self::NoWaitStates, Self::WithCaches, Self::WithoutCaches];
}

/// Wait states at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
const WAIT_STATES: u64 = 5;
const LINE_BYTES: u32 = 16;
const INSTRUCTION_LINES: usize = 64;
const DATA_LINES: usize = 8;
/// Cycles to refill the pipeline after a taken branch.
const REFILL_CYCLES: u64 = 2;
/// Cycles to enter and leave the exception, and to save and restore the FPU's registers (Cortex-M4 manual, section 3.9;
/// ARM application note 298).
pub const EXCEPTION_CYCLES: u64 = 12 + 12 + 17 + 17;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cost {
    /// Length of the instruction, bytes.
    length: u32,
    cycles: u64,
    /// True for a single load, which overlaps with a load that follows.
    is_load: bool,
    /// Address of the constant that the instruction loads from the code.
    constant: Option<u32>,
    /// FPU register that arithmetic writes.
    writes: Option<u16>,
    /// FPU registers that arithmetic reads.
    reads: [Option<u16>; 2],
}

impl Cost {
    fn new(length: u32, cycles: u64) -> Self {
        Self { length, cycles, is_load: false, constant: None, writes: None, reads: [None; 2] }
    }

    fn load(length: u32, constant: Option<u32>) -> Self {
        Self { is_load: true, constant, ..Self::new(length, 2) }
    }
}

/// Returns the address from which a PC-relative load at `at` with an offset of `words` words reads.
fn literal_address(at: u32, words: u16) -> Option<u32> {
    Some((at & !3).wrapping_add(4).wrapping_add(4 * u32::from(words)))
}

/// Returns the cost of the instruction at `at`, decoded as in the ARMv7-M Architecture Reference Manual (A5, A6).
fn cost(code: &Code, at: u32) -> Cost {
    let first = code.half_word(at);
    if first >> 11 >= 0b11101 {
        return wide_cost(first, code.half_word(at + 2), at);
    }
    match first {
        0x4800..0x5000 => Cost::load(2, literal_address(at, first & 0xFF)),
        0x5600..0x6000 => Cost::load(2, None),
        0x6000..0xA000 if first & 0x0800 != 0 => Cost::load(2, None),
        // PUSH and POP, then STM and LDM.
        0xB400..0xB600 | 0xBC00..0xBE00 => Cost::new(2, 1 + u64::from((first & 0x1FF).count_ones())),
        0xC000..0xD000 => Cost::new(2, 1 + u64::from((first & 0xFF).count_ones())),
        _ => Cost::new(2, 1),
    }
}

fn wide_cost(first: u16, second: u16, at: u32) -> Cost {
    let loads = first & 0x10 != 0;
    match first {
        // LDM and STM, then TBB, then LDRD, STRD and the exclusive variants.
        _ if first & 0xFE40 == 0xE800 => Cost::new(4, 1 + u64::from(second.count_ones())),
        0xE8D0..=0xE8DF if second & 0xFFE0 == 0xF000 => Cost::new(4, 2),
        _ if first & 0xFE40 == 0xE840 => Cost::new(4, 3),
        // VLDR and VSTR, then VMOV of two registers, then VLDM and VSTM.
        _ if first & 0xFF20 == 0xED00 => match (loads, first & 0xF) {
            (true, 0xF) => Cost::load(4, literal_address(at, second & 0xFF)),
            (true, _) => Cost::load(4, None),
            (false, _) => Cost::new(4, 2),
        },
        _ if first & 0xFFE0 == 0xEC40 => Cost::new(4, 2),
        _ if first & 0xFE00 == 0xEC00 => Cost::new(4, 1 + u64::from(second & 0xFF)),
        _ if first & 0xFF00 == 0xEE00 && second & 0x10 == 0 => fpu_cost(first, second),
        // LDR, also of a constant.
        _ if first & 0xFE00 == 0xF800 && loads => {
            let relative = first & 0xF == 0xF && first & 0x80 != 0;
            Cost::load(4, relative.then(|| (at & !3).wrapping_add(4 + u32::from(second & 0xFFF))))
        }
        // SDIV and UDIV in their longest time.
        _ if first & 0xFFD0 == 0xFB90 => Cost::new(4, 12),
        _ => Cost::new(4, 1),
    }
}

fn fpu_cost(first: u16, second: u16) -> Cost {
    let register = |number: u16, low: u16| Some((number & 0xF) << 1 | low & 1);
    let unary = first & 0xFFB0 == 0xEEB0;
    let cycles = match first & 0xFFB0 {
        // VMLA, VMLS, VNMLA, VNMLS, VFNMA, VFMA
        0xEE00 | 0xEE10 | 0xEE90 | 0xEEA0 => 3,
        0xEE80 => 14,
        // VSQRT
        0xEEB0 if first & 0xF == 1 && second & 0xC0 == 0xC0 => 14,
        _ => 1,
    };
    Cost {
        writes: register(second >> 12, first >> 6),
        reads: [if unary { None } else { register(first, second >> 7) }, register(second, second >> 5)],
        ..Cost::new(4, cycles)
    }
}

/// Cached lines, the most recently used line first.
#[derive(Debug, Default)]
struct CachedLines(VecDeque<u32>);

impl CachedLines {
    /// Makes `line` the newest of at most `capacity` cached lines. Returns true if it was cached before.
    fn use_line(&mut self, line: u32, capacity: usize) -> bool {
        let place = self.0.iter().position(|&kept| kept == line);
        if let Some(place) = place {
            self.0.remove(place);
        }
        self.0.push_front(line);
        self.0.truncate(capacity);
        place.is_some()
    }
}

/// State of the flash during a run.
#[derive(Debug)]
struct FlashState {
    flash: Flash,
    now: u64,
    /// Time at which the flash array is free again.
    free_at: u64,
    line: Option<u32>,
    prefetched_line: Option<u32>,
    instructions: CachedLines,
    constants: CachedLines,
}

impl FlashState {
    /// Reads a line of the flash array and waits until it arrives.
    fn read(&mut self) {
        self.now = self.now.max(self.free_at) + WAIT_STATES;
        self.free_at = self.now;
    }

    fn fetch_instruction(&mut self, at: u32) {
        let line = at / LINE_BYTES;
        if self.flash == Flash::NoWaitStates || self.line.replace(line) == Some(line) {
            return;
        }
        if self.flash == Flash::WithoutCaches {
            return self.read();
        }
        if !self.instructions.use_line(line, INSTRUCTION_LINES) {
            if self.prefetched_line == Some(line) {
                self.now = self.now.max(self.free_at);
            } else {
                self.read();
            }
        }
        if !self.instructions.0.contains(&(line + 1)) && self.prefetched_line != Some(line + 1) {
            self.prefetched_line = Some(line + 1);
            self.free_at = self.now.max(self.free_at) + 1 + WAIT_STATES;
        }
    }

    fn load_constant(&mut self, at: u32) {
        let is_cached = self.constants.use_line(at / LINE_BYTES, DATA_LINES) && self.flash == Flash::WithCaches;
        if self.flash != Flash::NoWaitStates && !is_cached {
            self.read();
        }
    }
}

/// Returns the cycles of an exception whose handler executes the instructions at the addresses in `path`, in order.
#[must_use]
pub fn estimate(code: &Code, path: &[u32], flash: Flash) -> u64 {
    let mut state = FlashState {
        flash,
        now: EXCEPTION_CYCLES,
        free_at: 0,
        line: None,
        prefetched_line: None,
        instructions: CachedLines::default(),
        constants: CachedLines::default(),
    };
    let mut before = Cost::new(0, 0);
    for (nth, &at) in path.iter().enumerate() {
        let cost = cost(code, at);
        state.fetch_instruction(at);
        state.fetch_instruction(at + cost.length - 1);
        if let Some(constant) = cost.constant {
            state.load_constant(constant);
        }
        let overlaps = u64::from(before.is_load && cost.is_load);
        let waits = u64::from(before.writes.is_some() && cost.reads.contains(&before.writes));
        let is_taken = path.get(nth + 1).is_some_and(|&next| next != at + cost.length);
        state.now += cost.cycles - overlaps + waits + if is_taken { REFILL_CYCLES } else { 0 };
        before = cost;
    }
    state.now
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOP: u16 = 0xBF00;

    fn cycles_of(halves: &[u16], path: &[u32], flash: Flash) -> u64 {
        estimate(&Code::new(0x1000, halves), path, flash) - EXCEPTION_CYCLES
    }

    #[test]
    fn prefetch_hides_all_lines_but_the_first() {
        let path: Vec<u32> = (0..24).map(|nth| 0x1000 + 2 * nth).collect();
        let code = [NOP; 24];
        assert_eq!(cycles_of(&code, &path, Flash::NoWaitStates), 24);
        // All three lines have their wait states.
        assert_eq!(cycles_of(&code, &path, Flash::WithoutCaches), 24 + 3 * 5);
        // Only the first line is late. A fetch takes six cycles, and executing the line before it takes eight.
        assert_eq!(cycles_of(&code, &path, Flash::WithCaches), 24 + 5);
    }

    #[test]
    fn wide_instructions_are_faster_than_the_prefetch() {
        // With four `movw r0, #0` per line, each further line arrives two cycles late.
        let code = [[0xF240, 0x0000]; 12].concat();
        let path: Vec<u32> = (0..12).map(|nth| 0x1000 + 4 * nth).collect();
        assert_eq!(cycles_of(&code, &path, Flash::WithCaches), 12 + 5 + 2 * 2);
    }

    #[test]
    fn a_loop_stays_in_the_cache() {
        // nop; b 0x1000
        let code = [NOP, 0xE7FD];
        let path: Vec<u32> = [0x1000, 0x1002].repeat(10);
        let core = 20 + 9 * REFILL_CYCLES;
        assert_eq!(cycles_of(&code, &path, Flash::NoWaitStates), core);
        assert_eq!(cycles_of(&code, &path, Flash::WithCaches), core + 5);
    }

    #[test]
    fn instructions_have_the_costs_of_the_manual() {
        let alone = |halves: &[u16]| cycles_of(halves, &[0x1000], Flash::NoWaitStates);
        assert_eq!(alone(&[0x6808]), 2, "ldr r0, [r1]");
        assert_eq!(alone(&[0x6008]), 1, "str r0, [r1]");
        assert_eq!(alone(&[0xB5F0]), 6, "push {{r4-r7, lr}}");
        assert_eq!(alone(&[0xE92D, 0x4FF0]), 10, "push.w {{r4-r11, lr}}");
        assert_eq!(alone(&[0xED2D, 0x8B10]), 17, "vpush {{d8-d15}}");
        assert_eq!(alone(&[0xED90, 0x0A00]), 2, "vldr s0, [r0]");
        assert_eq!(alone(&[0xEE30, 0x0A20]), 1, "vadd.f32 s0, s0, s1");
        assert_eq!(alone(&[0xEE80, 0x0A20]), 14, "vdiv.f32 s0, s0, s1");
        assert_eq!(alone(&[0xEEB1, 0x0AC0]), 14, "vsqrt.f32 s0, s0");
        assert_eq!(alone(&[0xEEB0, 0x0AC0]), 1, "vabs.f32 s0, s0");
        assert_eq!(alone(&[0xEEA0, 0x0A20]), 3, "vfma.f32 s0, s0, s1");
        assert_eq!(alone(&[0xFBB0, 0xF0F1]), 12, "udiv r0, r0, r1");
    }
}
