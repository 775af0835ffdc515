//! The square root of the Cortex-M4F's floating-point unit (`vsqrt.f32`, 14 cycles, correctly rounded).
//!
//! `core` has no square root for this target, so assembly is necessary, but the library with the control step forbids
//! `unsafe` code. This crate contains the assembly in one safe function that accepts any number.

#![no_std]
#![cfg(target_arch = "arm")]

use core::arch::asm;

/// Returns the square root; NaN for a negative number.
///
/// The compiler passes no single-precision number to assembly in a register of an FPU without doubles, so the number
/// goes through a core register: five instructions in total.
#[inline(always)]
#[must_use]
pub fn sqrt(value: f32) -> f32 {
    let root: u32;
    // SAFETY: moves and one instruction of the FPU, which is on before `main` on this target. Only the FPU's status
    // flags change (inexact, invalid), and the compiler does not expect assembly to preserve flags.
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
