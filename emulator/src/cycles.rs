//! An estimate, no measurement, of the cycles that a path of instructions takes on a Cortex-M4F that runs from the
//! flash of an STM32F405 at 168 MHz.
//!
//! The core: the tables of instruction timings of ARM's Cortex-M4 technical reference manual (r0p1, sections 3.3 and
//! 7.2.3). A load after a load is pipelined, a taken branch refills the pipeline in two cycles of the one to three that
//! the manual gives, a skipped instruction is taken for an executed one. The flash: five wait states for each line of
//! sixteen bytes, and what hides them (RM0090 sections 3.5.1 and 3.5.2): a cache of 64 lines of instructions, one of 8
//! lines of constants, and the line after the present one fetched ahead; a fetch under way is waited for before another
//! begins. The caches are empty at the first instruction. SRAM and registers answer at once; what DMA and USB take from
//! the buses is not in it.

use std::collections::VecDeque;

use crate::trace::Code;

/// The model of the flash's delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flash {
    /// At once: what the core alone takes.
    AtOnce,
    /// With its wait states behind both caches and the fetching ahead.
    Accelerated,
    /// With its wait states for every line: what a reset leaves.
    Bare,
}

impl Flash {
    /// Every way, from the fastest.
    pub const ALL: [Self; 3] = [Self::AtOnce, Self::Accelerated, Self::Bare];
}

/// Wait states at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
const WAIT_STATES: u64 = 5;
const LINE: u32 = 16;
const INSTRUCTION_LINES: usize = 64;
const DATA_LINES: usize = 8;
/// Cycles to refill the pipeline after a taken branch.
const REFILL: u64 = 2;
/// Cycles into the exception and out of it, and those that put the FPU's registers away and fetch them again (Cortex-M4
/// manual, section 3.9; ARM application note 298).
pub const EXCEPTION: u64 = 12 + 12 + 17 + 17;

/// The purpose of an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Arithmetic of the FPU.
    Arithmetic,
    /// Loads and stores.
    Memory,
    /// Jumps, calls and returns.
    Branch,
    /// Integers, moves, comparisons.
    Rest,
}

impl Kind {
    /// Each, and its name in a table.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Arithmetic, "arithmetic of the FPU"),
        (Self::Memory, "loads and stores"),
        (Self::Branch, "branches"),
        (Self::Rest, "integers, moves, comparisons"),
    ];
}

/// Counts the instructions of a path by [`Kind::ALL`].
#[must_use]
pub fn kinds(code: &Code, path: &[u32]) -> [u64; Kind::ALL.len()] {
    let mut counts = [0; Kind::ALL.len()];
    for &at in path {
        let kind = cost(code, at).kind;
        counts[Kind::ALL.iter().position(|(one, _)| *one == kind).unwrap_or(0)] += 1;
    }
    counts
}

/// The cost of an instruction by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cost {
    kind: Kind,
    /// Bytes of the instruction.
    length: u32,
    cycles: u64,
    /// True for a single load, which the next one overlaps.
    load: bool,
    /// The address of the constant that it loads from the code.
    constant: Option<u32>,
    /// Registers of the FPU: the one that its arithmetic writes, and those that it reads.
    writes: Option<u16>,
    reads: [Option<u16>; 2],
}

impl Cost {
    fn of(length: u32, cycles: u64) -> Self {
        Self { kind: Kind::Rest, length, cycles, load: false, constant: None, writes: None, reads: [None; 2] }
    }

    fn memory(length: u32, cycles: u64) -> Self {
        Self { kind: Kind::Memory, ..Self::of(length, cycles) }
    }

    fn load(length: u32, constant: Option<u32>) -> Self {
        Self { load: true, constant, ..Self::memory(length, 2) }
    }

    fn branch(length: u32) -> Self {
        Self { kind: Kind::Branch, ..Self::of(length, 1) }
    }
}

/// The constant at `offset` words from the word after `at`'s, as instructions relative to the program counter name it.
fn constant(at: u32, words: u16) -> Option<u32> {
    Some((at & !3).wrapping_add(4).wrapping_add(4 * u32::from(words)))
}

/// Encodings as in the ARMv7-M Architecture Reference Manual, chapters A5 and A6.
fn cost(code: &Code, at: u32) -> Cost {
    let first = code.half(at);
    if first >> 11 >= 0b11101 {
        return wide(first, code.half(at + 2), at);
    }
    match first {
        0x4800..0x5000 => Cost::load(2, constant(at, first & 0xFF)),
        0x4700..0x4800 | 0xD000..0xE800 => Cost::branch(2),
        0x5000..0x5600 => Cost::memory(2, 1),
        0x5600..0x6000 => Cost::load(2, None),
        0x6000..0xA000 if first & 0x0800 != 0 => Cost::load(2, None),
        0x6000..0xA000 => Cost::memory(2, 1),
        // CBZ, CBNZ
        _ if first & 0xF500 == 0xB100 => Cost::branch(2),
        // PUSH, POP, STM, LDM
        0xB400..0xB600 | 0xBC00..0xBE00 => Cost::memory(2, 1 + u64::from((first & 0x1FF).count_ones())),
        0xC000..0xD000 => Cost::memory(2, 1 + u64::from((first & 0xFF).count_ones())),
        _ => Cost::of(2, 1),
    }
}

fn wide(first: u16, second: u16, at: u32) -> Cost {
    let loads = first & 0x10 != 0;
    match first {
        // LDM, STM; TBB; LDRD, STRD and the exclusive ones.
        _ if first & 0xFE40 == 0xE800 => Cost::memory(4, 1 + u64::from(second.count_ones())),
        0xE8D0..=0xE8DF if second & 0xFFE0 == 0xF000 => Cost { cycles: 2, ..Cost::branch(4) },
        _ if first & 0xFE40 == 0xE840 => Cost::memory(4, 3),
        // VLDR, VSTR; VMOV of two; VLDM, VSTM.
        _ if first & 0xFF20 == 0xED00 => match (loads, first & 0xF) {
            (true, 0xF) => Cost::load(4, constant(at, second & 0xFF)),
            (true, _) => Cost::load(4, None),
            (false, _) => Cost::memory(4, 2),
        },
        _ if first & 0xFFE0 == 0xEC40 => Cost::of(4, 2),
        _ if first & 0xFE00 == 0xEC00 => Cost::memory(4, 1 + u64::from(second & 0xFF)),
        _ if first & 0xFF00 == 0xEE00 && second & 0x10 == 0 => arithmetic(first, second),
        // LDR and STR; those of a constant.
        _ if first & 0xFE00 == 0xF800 && loads => {
            let relative = first & 0xF == 0xF && first & 0x80 != 0;
            Cost::load(4, relative.then(|| (at & !3).wrapping_add(4 + u32::from(second & 0xFFF))))
        }
        _ if first & 0xFE00 == 0xF800 => Cost::memory(4, 1),
        // B and BL; what has no condition there are barriers and special registers.
        _ if first & 0xF800 == 0xF000 && second & 0x8000 != 0 => {
            let other = second & 0x5000 == 0 && first & 0x0380 == 0x0380;
            if other { Cost::of(4, 1) } else { Cost::branch(4) }
        }
        // SDIV, UDIV at their longest.
        _ if first & 0xFFD0 == 0xFB90 => Cost::of(4, 12),
        _ => Cost::of(4, 1),
    }
}

/// Arithmetic of the FPU.
fn arithmetic(first: u16, second: u16) -> Cost {
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
    // VMOV and VCMP
    let other = unary && (first & 0xF == 0 && second & 0xC0 != 0xC0 || matches!(first & 0xF, 4 | 5));
    Cost {
        kind: if other { Kind::Rest } else { Kind::Arithmetic },
        writes: register(second >> 12, first >> 6),
        reads: [if unary { None } else { register(first, second >> 7) }, register(second, second >> 5)],
        ..Cost::of(4, cycles)
    }
}

/// Lines that were used last, the newest first.
#[derive(Debug, Default)]
struct Lines(VecDeque<u32>);

impl Lines {
    /// Returns true if `line` is there; it becomes the newest of at most `most`.
    fn take(&mut self, line: u32, most: usize) -> bool {
        let place = self.0.iter().position(|&kept| kept == line);
        if let Some(place) = place {
            self.0.remove(place);
        }
        self.0.push_front(line);
        self.0.truncate(most);
        place.is_some()
    }
}

/// The flash during a run.
#[derive(Debug)]
struct Fetching {
    flash: Flash,
    now: u64,
    /// When the array is free again.
    free: u64,
    line: Option<u32>,
    ahead: Option<u32>,
    instructions: Lines,
    constants: Lines,
}

impl Fetching {
    /// Reads a line of the array, and waits for it.
    fn read(&mut self) {
        self.now = self.now.max(self.free) + WAIT_STATES;
        self.free = self.now;
    }

    fn instruction(&mut self, at: u32) {
        let line = at / LINE;
        if self.flash == Flash::AtOnce || self.line.replace(line) == Some(line) {
            return;
        }
        if self.flash == Flash::Bare {
            return self.read();
        }
        if !self.instructions.take(line, INSTRUCTION_LINES) {
            if self.ahead == Some(line) {
                self.now = self.now.max(self.free);
            } else {
                self.read();
            }
        }
        if !self.instructions.0.contains(&(line + 1)) && self.ahead != Some(line + 1) {
            self.ahead = Some(line + 1);
            self.free = self.now.max(self.free) + 1 + WAIT_STATES;
        }
    }

    fn constant(&mut self, at: u32) {
        let there = self.constants.take(at / LINE, DATA_LINES) && self.flash == Flash::Accelerated;
        if self.flash != Flash::AtOnce && !there {
            self.read();
        }
    }
}

/// Cycles of the exception whose handler executes the instructions at `path`, in this order.
#[must_use]
pub fn estimate(code: &Code, path: &[u32], flash: Flash) -> u64 {
    let mut fetching = Fetching {
        flash,
        now: EXCEPTION,
        free: 0,
        line: None,
        ahead: None,
        instructions: Lines::default(),
        constants: Lines::default(),
    };
    let mut before = Cost::of(0, 0);
    for (nth, &at) in path.iter().enumerate() {
        let cost = cost(code, at);
        fetching.instruction(at);
        fetching.instruction(at + cost.length - 1);
        if let Some(constant) = cost.constant {
            fetching.constant(constant);
        }
        let overlaps = u64::from(before.load && cost.load);
        let waits = u64::from(before.writes.is_some() && cost.reads.contains(&before.writes));
        let taken = path.get(nth + 1).is_some_and(|&next| next != at + cost.length);
        fetching.now += cost.cycles - overlaps + waits + if taken { REFILL } else { 0 };
        before = cost;
    }
    fetching.now
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOP: u16 = 0xBF00;

    fn straight(halves: &[u16], path: &[u32], flash: Flash) -> u64 {
        estimate(&Code::at(0x1000, halves), path, flash) - EXCEPTION
    }

    #[test]
    fn a_line_of_eight_instructions_hides_the_next_but_for_nothing() {
        let path: Vec<u32> = (0..24).map(|nth| 0x1000 + 2 * nth).collect();
        let code = [NOP; 24];
        assert_eq!(straight(&code, &path, Flash::AtOnce), 24);
        // Three lines, each waited for.
        assert_eq!(straight(&code, &path, Flash::Bare), 24 + 3 * 5);
        // The first alone: fetching takes six cycles, executing the line before it eight.
        assert_eq!(straight(&code, &path, Flash::Accelerated), 24 + 5);
    }

    #[test]
    fn wide_instructions_outrun_the_fetching_ahead() {
        // movw r0, #0, four a line: each further line is there two cycles late.
        let code = [[0xF240, 0x0000]; 12].concat();
        let path: Vec<u32> = (0..12).map(|nth| 0x1000 + 4 * nth).collect();
        assert_eq!(straight(&code, &path, Flash::Accelerated), 12 + 5 + 2 * 2);
    }

    #[test]
    fn a_loop_stays_in_the_cache() {
        // nop; b 0x1000
        let code = [NOP, 0xE7FD];
        let path: Vec<u32> = [0x1000, 0x1002].repeat(10);
        let core = 20 + 9 * REFILL;
        assert_eq!(straight(&code, &path, Flash::AtOnce), core);
        assert_eq!(straight(&code, &path, Flash::Accelerated), core + 5);
    }

    #[test]
    fn instructions_cost_what_the_manual_says() {
        let alone = |halves: &[u16]| straight(halves, &[0x1000], Flash::AtOnce);
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

    #[test]
    fn instructions_are_told_apart() {
        let kind = |halves: &[u16]| cost(&Code::at(0x1000, halves), 0x1000).kind;
        for (halves, expected) in [
            (&[0xEE30, 0x0A20][..], Kind::Arithmetic),
            (&[0xEEB0, 0x0AC0], Kind::Arithmetic),
            (&[0xEEB0, 0x0A40], Kind::Rest),
            (&[0xEEB4, 0x0A60], Kind::Rest),
            (&[0xED80, 0x0A00], Kind::Memory),
            (&[0x6008], Kind::Memory),
            (&[0xF8C1, 0x0010], Kind::Memory),
            (&[0xB5F0], Kind::Memory),
            (&[0xD001], Kind::Branch),
            (&[0xB108], Kind::Branch),
            (&[0x4770], Kind::Branch),
            (&[0xF000, 0xF802], Kind::Branch),
            (&[0xF43F, 0xAE9E], Kind::Branch),
            (&[0xF3BF, 0x8F5F], Kind::Rest),
            (&[0xF240, 0x0000], Kind::Rest),
            (&[0x1808], Kind::Rest),
        ] {
            assert_eq!(kind(halves), expected, "{halves:x?}");
        }
    }

    #[test]
    fn what_is_needed_at_once_is_waited_for() {
        // vadd s0, s1, s2; vadd s3, s0, s2; vadd s4, s1, s2
        let code = [0xEE30, 0x0A81, 0xEE70, 0x1A01, 0xEE30, 0x2A81];
        assert_eq!(straight(&code, &[0x1000, 0x1004, 0x1008], Flash::AtOnce), 4);
        // ldr r0, [r1] twice
        assert_eq!(straight(&[0x6808, 0x6808], &[0x1000, 0x1002], Flash::AtOnce), 3);
    }

    #[test]
    fn a_constant_in_the_code_is_waited_for_once() {
        // ldr r0, [pc, #0x3C] twice: the word at 0x1040.
        let code = [0x480F, 0x480F];
        let path = [0x1000, 0x1002];
        assert_eq!(straight(&code, &path, Flash::AtOnce), 3);
        // The line of the code, and that of the constant twice.
        assert_eq!(straight(&code, &path, Flash::Bare), 3 + 5 + 2 * 5);
        // Once, after the line that is being fetched ahead.
        assert_eq!(straight(&code, &path, Flash::Accelerated), 3 + 5 + 6 + 5);
    }
}
