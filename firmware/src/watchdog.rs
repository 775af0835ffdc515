//! The independent watchdog, which resets the chip and so turns the bridges off if it is not fed in time.
//!
//! An interrupt ([`SysTick`]) feeds the watchdog every millisecond while the supervisor's credit lasts
//! ([`Watchdog::feed`]) and the control interrupt is served. A stopped core, or a control interrupt that does not come
//! or does not end, leads to a reset within 4 to 17 ms. A task that blocks the supervisor leads to a reset after
//! another 100 ms. The watchdog counts a slow oscillator of 17 to 47 kHz (STM32F405 datasheet, table 35).
//!
//! A sector erase stalls the program for up to 0.5 s, and a search of a full sector takes tens of milliseconds. During
//! both, the watchdog waits for at least 2.7 s ([`with_longest_time`]), and the bridges are off.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::{Peri, peripherals::IWDG};

use crate::clock::TIMER_HZ;
use crate::critical;

/// Ticks of the prescaled oscillator (32 kHz / 32 = 1 kHz nominal) until the reset. They last at least 5.4 ms, several
/// times the longest delay of the feeding interrupt, and at most 17 ms (one tick more).
const NORMAL_TICKS: u16 = 8;
/// Ticks during a write of flash: the maximum of the register.
const LONGEST_TICKS: u16 = 0xFFF;
/// Number of feedings, one per millisecond, for each passed check of the supervisor. The supervisor checks every 20 ms,
/// but an arming delays a check by 35 ms.
const FEEDINGS_PER_CHECK: u32 = 100;
/// Number of feedings left.
static FEEDINGS_LEFT: AtomicU32 = AtomicU32::new(0);
/// True while the watchdog's registers are being set, because a feeding in between would lock the registers.
static IS_BEING_SET: AtomicBool = AtomicBool::new(false);

/// Feeds the watchdog while credit is left and the control interrupt is served. A control step that does not end has
/// the higher priority and keeps this handler from running. If the control interrupt is no longer served, the carrier's
/// flag stays set. A flag that was set just now costs one feeding of several.
#[cortex_m_rt::exception]
fn SysTick() {
    let left = FEEDINGS_LEFT.load(Ordering::Relaxed);
    FEEDINGS_LEFT.store(left.saturating_sub(1), Ordering::Relaxed);
    if left > 0 && !pac::TIM1.sr().read().uif() && !IS_BEING_SET.load(Ordering::Relaxed) {
        reload();
    }
}

/// The running watchdog, which cannot be stopped.
pub struct Watchdog {
    _peripheral: Peri<'static, IWDG>,
}

impl Watchdog {
    /// Starts the watchdog and the interrupt that feeds it. The carrier must run.
    pub fn start(peripheral: Peri<'static, IWDG>) -> Self {
        pac::IWDG.kr().write(|w| w.set_key(Key::START));
        set_ticks(NORMAL_TICKS);
        // SAFETY: no other code uses the core's timer or its priority.
        let mut core = unsafe { cortex_m::Peripherals::steal() };
        // SAFETY: the handler shares only atomics with the code that it interrupts.
        unsafe { core.SCB.set_priority(SystemHandler::SysTick, critical::WATCHDOG as u8) };
        core.SYST.set_clock_source(SystClkSource::Core);
        // The core runs at the frequency of the fast timers.
        core.SYST.set_reload(TIMER_HZ / 1000 - 1);
        core.SYST.clear_current();
        core.SYST.enable_interrupt();
        core.SYST.enable_counter();
        Self { _peripheral: peripheral }
    }

    /// Postpones the reset by 100 ms.
    pub fn feed(&mut self) {
        FEEDINGS_LEFT.store(FEEDINGS_PER_CHECK, Ordering::Relaxed);
    }
}

/// Number of calls of [`with_longest_time`].
static LONGEST_TIME_CALLS: AtomicU32 = AtomicU32::new(0);

/// Returns the number of calls of [`with_longest_time`], wrapping.
pub fn longest_time_calls() -> u32 {
    LONGEST_TIME_CALLS.load(Ordering::Relaxed)
}

/// Runs `work`, which may stall the program, with the watchdog's longest time. The watchdog must be running, because a
/// write before its oscillator runs is lost and blocks every later write.
pub fn with_longest_time<R>(work: impl FnOnce() -> R) -> R {
    LONGEST_TIME_CALLS.store(longest_time_calls().wrapping_add(1), Ordering::Relaxed);
    set_ticks(LONGEST_TICKS);
    let result = work();
    set_ticks(NORMAL_TICKS);
    result
}

fn reload() {
    pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
}

/// Sets the watchdog's time and restores the credit.
fn set_ticks(ticks: u16) {
    IS_BEING_SET.store(true, Ordering::Relaxed);
    pac::IWDG.kr().write(|w| w.set_key(Key::ENABLE));
    pac::IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY32));
    pac::IWDG.rlr().write(|w| w.set_rl(ticks));
    // The new values cross into the oscillator's clock domain within five of its periods, 0.3 ms at worst. The loop is
    // bounded, so that a register that stays busy does not hang the program.
    for _ in 0..20_000 {
        let busy = pac::IWDG.sr().read();
        if !busy.pvu() && !busy.rvu() {
            break;
        }
    }
    reload();
    FEEDINGS_LEFT.store(FEEDINGS_PER_CHECK, Ordering::Relaxed);
    IS_BEING_SET.store(false, Ordering::Relaxed);
}
