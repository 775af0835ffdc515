//! Critical sections that never delay the control interrupt.
//!
//! The usual implementation masks every interrupt. This one raises `BASEPRI` instead, which masks the tasks' interrupts
//! ([`OTHERS`]) alone. The three above them run inside critical sections, so they touch nothing that one protects and
//! never log: a falling supply's ([`SUPPLY`]), which turns the bridges off and resets; the control interrupt
//! ([`CONTROL`]), which uses atomics, a ring with one writer and one reader, and requests that it takes one at a time;
//! and the watchdog's ([`WATCHDOG`]), which uses atomics.

use cortex_m::register::{basepri, basepri_max};
use embassy_stm32::interrupt::Priority;

/// Priority of a falling supply's interrupt. Like hard faults and the non-maskable interrupt, which end with the bridges
/// off as well and are above all priorities, it does not wait for a control step to finish: that may take a period.
pub const SUPPLY: Priority = Priority::P0;

/// Priority of the control interrupt.
pub const CONTROL: Priority = Priority::P1;

/// Priority of the interrupt that feeds the watchdog: no task can hold it up, and a control interrupt that does not end
/// does.
pub const WATCHDOG: Priority = Priority::P2;

/// Priority of all other interrupts.
pub const OTHERS: Priority = Priority::P6;

/// The highest priority that a critical section masks: level 3, in the upper four bits.
const CEILING: u8 = 3 << 4;

/// Gives every interrupt of the chip the lower priority, which after a reset all of them lack: an interrupt that keeps
/// priority 0 would run inside critical sections. Call before anything enables an interrupt; the three that are above
/// the others take theirs afterwards.
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

// SAFETY: between acquire and release no interrupt of level 3 or lower urgency runs, and thread mode cannot be
// preempted by another thread on this single core. Interrupts of levels 0 to 2 never enter a critical section and share
// no data that one protects (see the module's documentation). `basepri_max` only ever raises the mask and release restores
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
