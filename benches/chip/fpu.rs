//! Elementary functions with the square root of the FPU, to count what the instruction would save on the board.
//!
//! `core` has no square root on this target and libm's is a loop over bits; the Cortex-M4F has an instruction for it
//! (`vsqrt.f32`, 14 cycles, correctly rounded, so equal to libm's bit for bit).

use core::arch::asm;
use haptic_bridge::math::{Math, minimax_sin_cos};

/// [`haptic_bridge::math::Minimax`] with `vsqrt`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fpu;

impl Math<f32> for Fpu {
    const NAME: &'static str = "minimax+vsqrt";
    #[inline(always)]
    fn sin_cos(angle: f32) -> (f32, f32) {
        minimax_sin_cos(angle)
    }
    #[inline(always)]
    fn sqrt(value: f32) -> f32 {
        vsqrt(value)
    }
}

/// Square root by the FPU; NaN for a negative number.
///
/// The compiler knows no single-precision register class on an FPU without doubles, so the number passes through core
/// registers and s0 is put back: seven instructions in all.
#[inline(always)]
pub fn vsqrt(value: f32) -> f32 {
    let root: u32;
    // SAFETY: moves and one instruction of the FPU, which is on before `main` on this target; s0 is as it was after.
    unsafe {
        asm!(
            "vmov {kept}, s0",
            "vmov s0, {value}",
            "vsqrt.f32 s0, s0",
            "vmov {value}, s0",
            "vmov s0, {kept}",
            kept = out(reg) _,
            value = inout(reg) value.to_bits() => root,
            options(pure, nomem, nostack, preserves_flags)
        );
    }
    f32::from_bits(root)
}
