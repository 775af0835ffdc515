//! Critical sections that never delay the control interrupt.
//!
//! The usual implementation masks every interrupt. This one raises `BASEPRI` instead, which masks only the tasks'
//! interrupts ([`OTHERS`]). Four interrupts have a higher priority and run inside critical sections, so they use no data
//! that a critical section protects, and never log. The interrupt of the supply monitor ([`SUPPLY`]) turns the bridges
//! off and resets. The interrupt of the encoders' bus has the same priority and uses its own frames. The control
//! interrupt ([`CONTROL`]) uses atomics, a ring with one writer and one reader, and one request at a time. The interrupt
//! that feeds the watchdog ([`WATCHDOG`]) uses atomics.

use cortex_m::register::{basepri, basepri_max};
use embassy_stm32::interrupt::Priority;

/// Priority of the supply monitor's interrupt, which turns the bridges off without waiting for a control step.
pub const SUPPLY: Priority = Priority::P0;
pub const CONTROL: Priority = Priority::P1;
/// Priority of the interrupt that feeds the watchdog. Tasks cannot delay it; an endless control interrupt stops it.
pub const WATCHDOG: Priority = Priority::P2;
/// Priority of all other interrupts.
pub const OTHERS: Priority = Priority::P6;
/// Highest priority that a critical section masks: level 3, in the upper four bits.
const MASKED_PRIORITY: u8 = 3 << 4;

/// Gives every interrupt of the chip the priority [`OTHERS`]. After a reset all have priority 0, at which they would
/// run inside critical sections. Call before any interrupt is enabled, and set the higher priorities afterwards.
pub fn lower_all() {
    // SAFETY: no interrupt is enabled yet at start-up. The priority registers accept any value, including the registers
    // of interrupts that this chip lacks (ARMv7-M B3.4.9).
    let registers = unsafe { &(*cortex_m::peripheral::NVIC::PTR).ipr };
    for priority in registers.iter().take(82) {
        // SAFETY: no interrupt is enabled yet. The upper four bits hold the priority.
        unsafe { priority.write(OTHERS as u8) };
    }
}

struct BasePriority;
critical_section::set_impl!(BasePriority);

// SAFETY: between acquire and release no interrupt of level 3 or lower urgency runs, and this core has no other thread.
// Interrupts of levels 0 to 2 never enter a critical section and use no protected data (see the module's
// documentation). Sections nest, because `basepri_max` only raises the mask and release restores the previous mask.
unsafe impl critical_section::Impl for BasePriority {
    unsafe fn acquire() -> critical_section::RawRestoreState {
        let before = basepri::read();
        basepri_max::write(MASKED_PRIORITY);
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        before
    }

    unsafe fn release(before: critical_section::RawRestoreState) {
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        // SAFETY: `before` is the value that the matching `acquire` read.
        unsafe { basepri::write(before) }
    }
}
