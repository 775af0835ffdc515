//! Measures the stack that was never used. Start-up paints the stack (cortex-m-rt's `paint-stack`), and the paint left at
//! the bottom was never overwritten. An overflow is a bus fault, see memory.x.

use core::ptr::addr_of;

/// The pattern of the paint.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Returns the number of bytes at the bottom of the stack that were never written.
pub fn never_used() -> u32 {
    let (bottom, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let mut word = bottom;
    // SAFETY: all words read lie between the two ends of the stack, which the linker script aligns. The stack in use is
    // above the first word without paint, so no word read here is written at the same time.
    while word < top && unsafe { word.read_volatile() } == PAINT {
        word = word.wrapping_add(1);
    }
    word as u32 - bottom as u32
}
