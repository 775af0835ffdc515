//! The square root of the Cortex-M4F's floating-point unit (`vsqrt.f32`, 14 cycles, correctly rounded).
//!
//! `core` offers none on this target, so it takes assembly, and the library that holds the control step has no `unsafe`
//! code: it is here, in one function that any number may be given to.

#![no_std]
#![cfg(target_arch = "arm")]

use core::arch::asm;

/// Square root; NaN for a negative number.
///
/// The compiler hands a single-precision number to assembly in no register of an FPU without doubles, so it passes through
/// a core register: five instructions in all.
#[inline(always)]
#[must_use]
pub fn sqrt(value: f32) -> f32 {
    let root: u32;
    // SAFETY: moves and one instruction of the FPU, which is on before `main` on this target. What it says of an inexact or
    // invalid number stays in the FPU's status: flags are not preserved.
    unsafe {
        asm!(
            "vmov s0, {value}",
            "vsqrt.f32 s0, s0",
            "vmov {value}, s0",
            value = inout(reg) value.to_bits() => root,
            out("s0") _,
            options(pure, nomem, nostack)
        );
    }
    f32::from_bits(root)
}
