//! Measures how much of the stack was never used: start-up paints it (cortex-m-rt's `paint-stack`), and paint that is
//! left from the bottom up was never touched. An overflow itself is a bus fault, see memory.x.

use core::ptr::addr_of;

/// The pattern that the stack is painted with.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Bytes at the bottom of the stack that were never written.
pub fn never_used() -> u32 {
    let (bottom, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let mut word = bottom;
    // SAFETY: all words read lie between the two ends of the stack, which the linker script aligns; the stack in use is
    // above the first word that is not painted, so nothing read here is written at the same time.
    while word < top && unsafe { word.read_volatile() } == PAINT {
        word = word.wrapping_add(1);
    }
    word as u32 - bottom as u32
}
