//! Decodes the Thumb-2 instructions (ARMv7-M Architecture Reference Manual, chapter A7.7) that show the calls, the
//! indirect calls and the stack of each function in a linked image.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, SymbolKind};

/// A function's stack use and calls.
#[derive(Debug, Default, PartialEq)]
pub struct Function {
    pub name: String,
    /// Addresses of calls and jumps to other functions.
    pub calls: BTreeSet<u32>,
    /// Addresses of the calls and jumps through a register or a pointer.
    pub indirect: Vec<u32>,
    /// Upper bound of the stack, bytes: the sum of all decrements of the stack pointer.
    pub stack: u32,
}

/// The functions of an image by address.
pub struct Image(BTreeMap<u32, Function>);

impl Image {
    /// Reads the code of an ELF file with symbols.
    pub fn read(path: &Path) -> Result<Self> {
        let data = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let file = object::File::parse(&*data).context("not an ELF file")?;
        let mut marks = BTreeMap::new();
        let mut starts = BTreeMap::new();
        for symbol in file.symbols() {
            let name = symbol.name().unwrap_or_default();
            let address = symbol.address() as u32;
            match name {
                "$t" => drop(marks.insert(address, true)),
                "$d" => drop(marks.insert(address, false)),
                _ if symbol.kind() == SymbolKind::Text && symbol.is_definition() => {
                    starts.insert(address & !1, (symbol.size() as u32, name.to_string()));
                }
                _ => {}
            }
        }
        let mut functions = BTreeMap::new();
        for section in file.sections().filter(|section| section.kind() == object::SectionKind::Text) {
            let base = section.address() as u32;
            let bytes = section.data().context("the file does not contain the code")?;
            let end = base + bytes.len() as u32;
            for (start, (size, name)) in starts.range(base..end) {
                let stop = (start + size).min(end);
                let code = &bytes[(start - base) as usize..(stop - base) as usize];
                let is_code = |at: u32| marks.range(..=at).next_back().is_none_or(|(_, code)| *code);
                let mut function = decode(code, *start, is_code);
                function.name.clone_from(name);
                functions.insert(*start, function);
            }
        }
        Ok(Self(functions))
    }

    /// Follows the calls from the functions `roots`. Returns the number of functions, their indirect jumps, and the
    /// deepest stack of each root. Fails on recursion, and on a call to an address without a function.
    pub fn reach(&self, roots: &[&str]) -> Result<ReachedFunctions> {
        let mut depths = BTreeMap::new();
        let mut stack = Vec::new();
        for root in roots {
            let address = self.0.iter().find(|(_, function)| function.name == *root).map(|(address, _)| *address);
            let address = address.with_context(|| format!("the image has no function {root}"))?;
            stack.push((root.to_string(), self.depth(address, &mut Vec::new(), &mut depths)?));
        }
        let indirect = depths
            .keys()
            .filter_map(|address| self.0.get(address))
            .flat_map(|function| function.indirect.iter().map(|at| format!("{} at {at:#x}", function.name)))
            .collect();
        Ok(ReachedFunctions { functions: depths.len(), indirect, stack })
    }

    fn depth(&self, address: u32, path: &mut Vec<u32>, depths: &mut BTreeMap<u32, u32>) -> Result<u32> {
        if let Some(depth) = depths.get(&address) {
            return Ok(*depth);
        }
        let function =
            self.0.get(&address).with_context(|| format!("a call to {address:#x}, which is not a function"))?;
        if path.contains(&address) {
            bail!("{} is recursive: its stack has no bound", function.name);
        }
        path.push(address);
        let mut below = 0;
        for call in &function.calls {
            below = below.max(self.depth(*call, path, depths)?);
        }
        path.pop();
        depths.insert(address, function.stack + below);
        Ok(function.stack + below)
    }
}

/// Result of [`Image::reach`].
pub struct ReachedFunctions {
    pub functions: usize,
    /// Function and address of each jump through a register or a pointer.
    pub indirect: Vec<String>,
    /// Deepest stack of each root, bytes.
    pub stack: Vec<(String, u32)>,
}

/// Decodes the code of the function at the address `start`. `is_code` returns false for tables between instructions.
fn decode(code: &[u8], start: u32, is_code: impl Fn(u32) -> bool) -> Function {
    let mut function = Function::default();
    let end = start + code.len() as u32;
    let half = |at: u32| {
        let i = (at - start) as usize;
        code.get(i..i + 2).map_or(0, |pair| u32::from(u16::from_le_bytes([pair[0], pair[1]])))
    };
    let mut at = start;
    while at < end {
        if !is_code(at) {
            at += 2;
            continue;
        }
        let first = half(at);
        let wide = first >> 11 >= 0b11101;
        let second = if wide { half(at + 2) } else { 0 };
        let mut jump = |target: u32, call: bool| {
            if call || !(start..end).contains(&target) {
                function.calls.insert(target);
            }
        };
        if !wide {
            match first {
                // B (T2), B<c> (T1)
                _ if first & 0xF800 == 0xE000 => jump(branch_target(at, sign_extend(first & 0x7FF, 11) * 2), false),
                _ if first & 0xF000 == 0xD000 && first & 0x0F00 < 0x0E00 => {
                    jump(branch_target(at, sign_extend(first & 0xFF, 8) * 2), false);
                }
                // BLX register, BX register except the link register, MOV to the program counter
                _ if first & 0xFF87 == 0x4780 => function.indirect.push(at),
                _ if first & 0xFF87 == 0x4700 && first >> 3 & 0xF != 14 => function.indirect.push(at),
                _ if first & 0xFF87 == 0x4687 => function.indirect.push(at),
                // PUSH, SUB sp
                _ if first & 0xFE00 == 0xB400 => function.stack += 4 * (first & 0x1FF).count_ones(),
                _ if first & 0xFF80 == 0xB080 => function.stack += 4 * (first & 0x7F),
                _ => {}
            }
        } else if first & 0xF800 == 0xF000 && second & 0x8000 != 0 {
            let s = first >> 10 & 1;
            let (j1, j2) = (second >> 13 & 1, second >> 11 & 1);
            let long =
                s << 24 | (1 ^ j1 ^ s) << 23 | (1 ^ j2 ^ s) << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
            match second & 0x5000 {
                0x5000 => jump(branch_target(at, sign_extend(long, 25)), true), // BL
                0x1000 => jump(branch_target(at, sign_extend(long, 25)), false), // B (T4)
                0x0000 if first & 0x0380 != 0x0380 => {
                    let near = s << 20 | j2 << 19 | j1 << 18 | (first & 0x3F) << 12 | (second & 0x7FF) << 1;
                    jump(branch_target(at, sign_extend(near, 21)), false); // B<c> (T3)
                }
                _ => {}
            }
        } else {
            let modified = (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
            match first {
                0xE92D => function.stack += 4 * second.count_ones(),      // PUSH.W
                0xED2D | 0xED6D => function.stack += 4 * (second & 0xFF), // VPUSH
                0xF84D if second & 0x0F00 == 0x0D00 => function.stack += second & 0xFF, // STR before sp
                0xE96D => function.stack += 4 * (second & 0xFF),          // STRD before sp
                _ if first & 0xFBEF == 0xF1AD && second & 0x0F00 == 0x0D00 => {
                    function.stack += expand_immediate(modified)
                }
                _ if first & 0xFBFF == 0xF2AD && second & 0x0F00 == 0x0D00 => function.stack += modified,
                // LDR to the program counter, except a return from the stack
                _ if first & 0xFF70 == 0xF850 && second >> 12 == 15 && first & 0xF != 13 => function.indirect.push(at),
                _ => {}
            }
        }
        at += if wide { 4 } else { 2 };
    }
    function
}

/// Returns the target of a branch at `at`, relative to the program counter, which is four bytes ahead.
fn branch_target(at: u32, by: i32) -> u32 {
    at.wrapping_add(4).wrapping_add_signed(by)
}

fn sign_extend(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)) as i32 >> (32 - bits)
}

/// Expands a modified immediate constant (ARMv7-M ARM, A5.3.2).
fn expand_immediate(modified: u32) -> u32 {
    let byte = modified & 0xFF;
    match modified >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte << 24 | byte << 16 | byte << 8 | byte,
        _ => (byte | 0x80).rotate_right(modified >> 7),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(halves: &[u16]) -> Function {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        decode(&code, 0x1000, |_| true)
    }

    #[test]
    fn the_stack_is_the_sum_of_pushes_and_subtractions() {
        // push {r4, lr}; sub sp, #8; push.w {r4-r11, lr}; vpush {d8-d9}; sub.w sp, sp, #512; subw sp, sp, #4095
        let found = function(&[0xB510, 0xB082, 0xE92D, 0x4FF0, 0xED2D, 0x8B04, 0xF5AD, 0x7D00, 0xF6AD, 0x7DFF]);
        assert_eq!(found.stack, 8 + 8 + 36 + 16 + 512 + 4095);
    }

    #[test]
    fn jumps_through_registers_are_found_without_returns() {
        // blx r3; bx r3; mov pc, r1; ldr.w pc, [r0]; bx lr; pop {pc}
        let found = function(&[0x4798, 0x4718, 0x468F, 0xF8D0, 0xF000, 0x4770, 0xBD00]);
        assert_eq!(found.indirect, [0x1000, 0x1002, 0x1004, 0x1006]);
    }

    #[test]
    fn calls_and_jumps_to_other_functions_are_found() {
        // bl +0x100; b.w +0x200; b -2 (inside); beq to 0x1100
        let found = function(&[0xF000, 0xF87E, 0xF000, 0xB8FC, 0xE7FD, 0xD079]);
        assert_eq!(found.calls, BTreeSet::from([0x1100, 0x1200]), "{found:x?}");
    }
}
