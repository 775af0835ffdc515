//! The control interrupt: at the crest of the carrier it samples, steps and writes the duties that apply at the next valley.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::interrupt;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::Dir;

use crate::board::Io;
use crate::critical;

/// A value that start-up hands to the control interrupt for good.
struct Owned<T>(UnsafeCell<Option<T>>);

// SAFETY: written once by `start` before the interrupt is enabled, and touched by nothing but the interrupt from then on.
unsafe impl<T> Sync for Owned<T> {}

struct Step {
    io: Io,
    countdown: u16,
}

static STEP: Owned<Step> = Owned(UnsafeCell::new(None));

/// Control steps since the start, wrapping.
pub static STEPS: AtomicU32 = AtomicU32::new(0);

/// Gives the board to the control interrupt and starts the carrier.
pub fn start(mut io: Io) {
    io.start();
    // SAFETY: the interrupt is not enabled yet.
    unsafe { *STEP.0.get() = Some(Step { io, countdown: 1 }) };
    interrupt::TIM1_UP_TIM10.set_priority(critical::CONTROL);
    pac::TIM1.sr().write(|w| w.0 = 0);
    pac::TIM1.dier().modify(|w| w.set_uie(true));
    // SAFETY: the state it needs is in place.
    unsafe { interrupt::TIM1_UP_TIM10.enable() };
}

#[interrupt]
fn TIM1_UP_TIM10() {
    pac::TIM1.sr().write(|w| {
        w.0 = !0;
        w.set_uif(false);
    });
    // At the valley the duties of the last step have just been taken over; there is nothing to do.
    if pac::TIM1.cr1().read().dir() == Dir::UP {
        return;
    }
    // SAFETY: this interrupt is the only user since `start` enabled it, and it does not preempt itself.
    let Some(step) = (unsafe { (*STEP.0.get()).as_mut() }) else { return };
    step.countdown -= 1;
    if step.countdown != 0 {
        return;
    }
    step.countdown = step.io.carrier().divider;
    step.io.counts();
    step.io.analog(false);
    step.io.write([0.0; crate::board::AXES]);
    step.io.drive(false);
    STEPS.fetch_add(1, Ordering::Relaxed);
}
