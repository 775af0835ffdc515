//! The independent watchdog: resets the chip, and with it the bridges, when it is not fed in time.
//!
//! An interrupt feeds it every millisecond ([`SysTick`]), for as long as the supervisor has given it credit for
//! ([`Watchdog::feed`]) and the control interrupt is served. So a core that stands still, and a control interrupt that
//! does not come or does not end, is reset within 4 to 17 ms, and a task that does not let the supervisor run after
//! another 100 ms. It counts the chip's own slow oscillator, 17 to 47 kHz (STM32F405 datasheet, table 35), so its times
//! hold within a factor.
//!
//! Erasing a flash sector stalls the whole program for up to 0.5 s, and looking through a full one takes tens of
//! milliseconds, so the time is stretched to at least 2.7 s around the writing of a setting and the reading of all of
//! them at start ([`patient`]): both while the bridges are off.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::{Peri, peripherals::IWDG};

use crate::clock::TIMER_HZ;
use crate::critical;

/// Ticks of the prescaled oscillator (32 kHz / 32 = 1 kHz nominal) until it bites: at least 5.4 ms at the fast end,
/// several times what holds up the interrupt that feeds it, and at most 17 ms (a tick more) at the slow end.
const NORMAL_TICKS: u16 = 8;
/// The most that its register holds.
const PATIENT_TICKS: u16 = 0xFFF;

/// Feedings, one a millisecond, for which the supervisor need not be heard: it looks every 20 ms, and arming keeps it from
/// that for 35.
const CREDIT: u32 = 100;

/// Feedings left.
static LEFT: AtomicU32 = AtomicU32::new(0);

/// Its registers are being set: a feeding in between would close them.
static BUSY: AtomicBool = AtomicBool::new(false);

/// Feeds the watchdog while there is credit and the control interrupt is served. That is above this one: a step that does
/// not end keeps this from running at all, and where it is not taken any more the carrier's flag stays up. A flag that
/// has risen just now, before that interrupt could come, costs one feeding of several.
#[cortex_m_rt::exception]
fn SysTick() {
    let left = LEFT.load(Ordering::Relaxed);
    LEFT.store(left.saturating_sub(1), Ordering::Relaxed);
    if left > 0 && !pac::TIM1.sr().read().uif() && !BUSY.load(Ordering::Relaxed) {
        reload();
    }
}

/// The running watchdog. There is no way to stop it.
pub struct Watchdog {
    _peripheral: Peri<'static, IWDG>,
}

impl Watchdog {
    /// Starts it, and what feeds it. The carrier must run.
    pub fn start(peripheral: Peri<'static, IWDG>) -> Self {
        pac::IWDG.kr().write(|w| w.set_key(Key::START));
        set(NORMAL_TICKS);
        // SAFETY: nothing else uses the core's timer, nor its priority.
        let mut core = unsafe { cortex_m::Peripherals::steal() };
        // SAFETY: its handler uses atomics, and shares nothing with what it interrupts but these.
        unsafe { core.SCB.set_priority(SystemHandler::SysTick, critical::WATCHDOG as u8) };
        core.SYST.set_clock_source(SystClkSource::Core);
        // The core runs at the frequency of the fast timers.
        core.SYST.set_reload(TIMER_HZ / 1000 - 1);
        core.SYST.clear_current();
        core.SYST.enable_interrupt();
        core.SYST.enable_counter();
        Self { _peripheral: peripheral }
    }

    /// All is well: postpones the reset by 100 ms.
    pub fn feed(&mut self) {
        LEFT.store(CREDIT, Ordering::Relaxed);
    }
}

/// Number of calls of [`patient`].
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

fn reload() {
    pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
}

/// Sets its time, and restarts the credit.
fn set(ticks: u16) {
    BUSY.store(true, Ordering::Relaxed);
    pac::IWDG.kr().write(|w| w.set_key(Key::ENABLE));
    pac::IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY32));
    pac::IWDG.rlr().write(|w| w.set_rl(ticks));
    // The new values cross into the oscillator's clock domain within five of its periods, 0.3 ms at worst; a register
    // that never says so must not hang the program until it bites.
    for _ in 0..20_000 {
        let busy = pac::IWDG.sr().read();
        if !busy.pvu() && !busy.rvu() {
            break;
        }
    }
    reload();
    LEFT.store(CREDIT, Ordering::Relaxed);
    BUSY.store(false, Ordering::Relaxed);
}
