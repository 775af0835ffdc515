//! Measures the unused part of the stack. Start-up fills the stack with a pattern (cortex-m-rt's `paint-stack`), and
//! the unused part keeps the pattern. An overflow is a bus fault, see memory.x.

use core::ptr::addr_of;

/// Pattern of the unused stack.
const UNUSED_PATTERN: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Returns the number of bytes at the bottom of the stack that were never written.
pub fn unused_bytes() -> u32 {
    let (bottom, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let mut word = bottom;
    // SAFETY: all words read lie between the two ends of the stack, which the linker script aligns. The stack in use is
    // above the first word without the pattern, so no word is written while it is read.
    while word < top && unsafe { word.read_volatile() } == UNUSED_PATTERN {
        word = word.wrapping_add(1);
    }
    word as u32 - bottom as u32
}
