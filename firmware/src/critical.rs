//! Critical sections that never delay the control interrupt.
//!
//! The usual implementation masks every interrupt. This one raises `BASEPRI` instead, which masks only the tasks'
//! interrupts ([`OTHERS`]). Three interrupts are above them and run inside critical sections, so they use no data that a
//! critical section protects, and never log: the supply monitor's ([`SUPPLY`]), which turns the bridges off and resets;
//! the control interrupt ([`CONTROL`]), which uses atomics, a ring with one writer and one reader, and one request at a
//! time; and the watchdog's ([`WATCHDOG`]), which uses atomics.

use cortex_m::register::{basepri, basepri_max};
use embassy_stm32::interrupt::Priority;

/// Priority of the supply monitor's interrupt. Like hard faults and the non-maskable interrupt, which are above all
/// priorities and also turn the bridges off, it does not wait for the end of a control step, which may take a period.
pub const SUPPLY: Priority = Priority::P0;

/// Priority of the control interrupt.
pub const CONTROL: Priority = Priority::P1;

/// Priority of the interrupt that feeds the watchdog. No task can delay it; a control interrupt that does not end stops it.
pub const WATCHDOG: Priority = Priority::P2;

/// Priority of all other interrupts.
pub const OTHERS: Priority = Priority::P6;

/// The highest priority that a critical section masks: level 3, in the upper four bits.
const CEILING: u8 = 3 << 4;

/// Gives every interrupt of the chip the priority [`OTHERS`]. After a reset all have priority 0, at which they would run
/// inside critical sections. Call before any interrupt is enabled. The three higher priorities are set afterwards.
pub fn lower_all() {
    // SAFETY: no interrupt is enabled yet at start-up. The priority registers accept any value, including the registers of
    // interrupts that this chip lacks (ARMv7-M B3.4.9).
    let registers = unsafe { &(*cortex_m::peripheral::NVIC::PTR).ipr };
    for priority in registers.iter().take(82) {
        // SAFETY: as above. The upper four bits hold the priority.
        unsafe { priority.write(OTHERS as u8) };
    }
}

struct BasePriority;
critical_section::set_impl!(BasePriority);

// SAFETY: between acquire and release no interrupt of level 3 or lower urgency runs, and no other thread exists on this
// core. Interrupts of levels 0 to 2 never enter a critical section and use no data that one protects (see the module's
// documentation). Sections nest, because `basepri_max` only raises the mask and release restores the previous mask.
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
