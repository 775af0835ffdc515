//! The independent watchdog: resets the chip, and with it the bridges, when it is not fed in time.
//!
//! It counts the chip's own slow oscillator, 17 to 47 kHz (STM32F405 datasheet, table 35), so its times hold within a
//! factor. In normal running it bites after 68 to 188 ms. Erasing a flash sector stalls the whole program for up to 0.5
//! s, and looking through a full one takes tens of milliseconds, so the time is stretched to at least 2.7 s around the
//! writing of a setting and the reading of all of them at start ([`patient`]): both while the bridges are off.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::{Peri, peripherals::IWDG};

/// Ticks of the prescaled oscillator (32 kHz / 32 = 1 kHz nominal) until it bites.
const NORMAL_TICKS: u16 = 100;
/// The most that its register holds.
const PATIENT_TICKS: u16 = 0xFFF;

/// The running watchdog. There is no way to stop it.
pub struct Watchdog {
    _peripheral: Peri<'static, IWDG>,
}

impl Watchdog {
    /// Starts it.
    pub fn start(peripheral: Peri<'static, IWDG>) -> Self {
        pac::IWDG.kr().write(|w| w.set_key(Key::START));
        set(NORMAL_TICKS);
        Self { _peripheral: peripheral }
    }

    /// Postpones the reset.
    pub fn feed(&mut self) {
        feed();
    }
}

/// How often [`patient`] has been called.
static STALLS: AtomicU32 = AtomicU32::new(0);

/// Stretches so far in which the program may have stalled, wrapping.
pub fn stalls() -> u32 {
    STALLS.load(Ordering::Relaxed)
}

/// Runs something that stalls the program for long, with a watchdog that waits for it. It must be running:
/// a write before its oscillator runs is lost, and blocks every write after it.
pub fn patient<R>(work: impl FnOnce() -> R) -> R {
    STALLS.store(stalls().wrapping_add(1), Ordering::Relaxed);
    set(PATIENT_TICKS);
    let result = work();
    set(NORMAL_TICKS);
    result
}

fn feed() {
    pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
}

fn set(ticks: u16) {
    pac::IWDG.kr().write(|w| w.set_key(Key::ENABLE));
    pac::IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY32));
    pac::IWDG.rlr().write(|w| w.set_rl(ticks));
    // The new values cross into the oscillator's clock domain within five of its periods, 0.3 ms at worst; a register
    // that never says so must not hang the program.
    for _ in 0..100_000 {
        let busy = pac::IWDG.sr().read();
        if !busy.pvu() && !busy.rvu() {
            break;
        }
    }
    feed();
}
