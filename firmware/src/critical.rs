//! Critical sections that never delay the control interrupt.
//!
//! The usual implementation masks every interrupt. This one raises `BASEPRI` instead, which masks all of them but those
//! of priority 0, and priority 0 belongs to the control interrupt ([`CONTROL`]) and to a falling supply's, which ends
//! in a reset. The price: the control interrupt must not touch anything that a critical section protects. It uses
//! atomics, a ring with one writer and one reader, and requests that it takes one at a time; it never logs.

use cortex_m::register::{basepri, basepri_max};
use embassy_stm32::interrupt::Priority;

/// Priority of the control interrupt: the one that critical sections let through.
pub const CONTROL: Priority = Priority::P0;

/// Priority of all other interrupts.
pub const OTHERS: Priority = Priority::P6;

/// The highest priority that a critical section masks: level 1, in the upper four bits.
const CEILING: u8 = 1 << 4;

/// Gives every interrupt of the chip the lower priority, which after a reset all of them lack: an interrupt that keeps
/// priority 0 would run inside critical sections. Call before anything enables an interrupt; the control interrupt
/// takes its own afterwards.
pub fn lower_all() {
    // SAFETY: start-up code, no interrupt is enabled yet. The priority registers accept any value, also those of
    // interrupts that this chip lacks (ARMv7-M B3.4.9).
    let registers = unsafe { &(*cortex_m::peripheral::NVIC::PTR).ipr };
    for priority in registers.iter().take(82) {
        // SAFETY: as above; the upper four bits hold the priority.
        unsafe { priority.write(OTHERS as u8) };
    }
}

struct BasePriority;
critical_section::set_impl!(BasePriority);

// SAFETY: between acquire and release no interrupt of level 1 or lower urgency runs, and thread mode cannot be
// preempted by another thread on this single core. Interrupts of level 0 never enter a critical section and share no
// data that one protects (see the module's documentation). `basepri_max` only ever raises the mask and release restores
// what acquire found, so sections nest.
unsafe impl critical_section::Impl for BasePriority {
    unsafe fn acquire() -> critical_section::RawRestoreState {
        let before = basepri::read();
        basepri_max::write(CEILING);
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        before
    }

    unsafe fn release(before: critical_section::RawRestoreState) {
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        // SAFETY: `before` is what the matching `acquire` read.
        unsafe { basepri::write(before) }
    }
}
