//! Clocks from an 8 MHz crystal: 168 MHz for the core, 84 MHz for the fast peripheral bus (168 MHz at its timers,
//! [`TIMER_HZ`]), 42 MHz for the slow bus (84 MHz at its timers), 48 MHz for USB. STM32F405 reference manual RM0090,
//! section 7.2. The tasks use embassy's clock, on TIM5.

use embassy_stm32::interrupt;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk, mux,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, pac};

use crate::critical;

/// Frequency that the PWM timers count at, Hz.
pub const TIMER_HZ: u32 = 168_000_000;
/// Line of the supply monitor's interrupt in the interrupt controller.
const SUPPLY_LINE: usize = 16;
/// Device identifier of the chip (RM0090 section 38.6.1). Revision A has another identifier (errata sheet ES0182).
const DEVICE_ID_AFTER_REVISION_A: u16 = 0x413;

/// Waits until the chip's supply is above `level` of its monitor, because below 2.7 V the flash is too slow for the
/// full clock. The chip meanwhile runs on its own oscillator, which needs 1.8 V; below 1.8 V the power-on reset holds
/// the chip. The option bytes therefore need no brown-out level.
pub fn await_supply(level: u8) {
    pac::RCC.apb1enr().modify(|w| w.set_pwren(true));
    monitor_supply(level);
    while pac::PWR.csr1().read().pvdo() {}
}

fn monitor_supply(level: u8) {
    pac::PWR.cr1().modify(|w| {
        w.set_pls(level);
        w.set_pvde(true);
    });
}

/// Returns the brown-out level in the option bytes, 0 (off) to 3 (2.7 V), which no code writes (RM0090 section 3.9.10).
pub fn brown_out_level() -> u8 {
    3 - pac::FLASH.optcr().read().bor_lev()
}

/// Enables two interrupts that neither a critical section nor a control step delays, handled in [`crate::reset`]: a
/// stopped crystal (non-maskable, RM0090 section 7.2.7) and a supply below `level` (line 16, section 12.2.5).
fn enable_monitors(level: u8) {
    pac::RCC.cr().modify(|w| w.set_csson(true));
    // embassy has reset the power controller.
    monitor_supply(level);
    pac::EXTI.rtsr(0).modify(|w| w.set_line(SUPPLY_LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(SUPPLY_LINE, true));
    interrupt::PVD.set_priority(critical::SUPPLY);
    // SAFETY: the handler shares no data with the code that it interrupts.
    unsafe { interrupt::PVD.enable() };
    if pac::PWR.csr1().read().pvdo() {
        interrupt::PVD.pend();
    }
}

/// Starts the clocks and takes the chip's peripherals.
pub fn start(level: u8) -> Peripherals {
    // embassy's clock counts half turns of TIM5 by interrupt. The update event that loads the timer compares count 0
    // with a compare value that is still 0, and sets the flag of a half turn. With this flag, the clock would be half a
    // turn ahead and, between a half turn and its interrupt, 65 ms early. It is cleared before a real half turn.
    critical_section::with(|_| {
        let chip = embassy_stm32::init(clock_tree());
        pac::TIM5.sr().write(|w| w.0 = 0);
        enable_flash_caches();
        enable_monitors(level);
        chip
    })
}

/// Enables 64 cache lines for instructions, 8 for data, and prefetch (RM0090 section 3.5.2), which hide most of the
/// flash's five wait states. Reset and embassy leave all three off, which doubles the duration of the control
/// interrupt. Prefetch does not work in revision A.
fn enable_flash_caches() {
    let prefetch = pac::DBGMCU.idcode().read().dev_id() == DEVICE_ID_AFTER_REVISION_A;
    let control = pac::FLASH.acr();
    // The caches can be cleared only while they are off.
    control.modify(|w| {
        w.set_icrst(true);
        w.set_dcrst(true);
    });
    control.modify(|w| {
        w.set_icrst(false);
        w.set_dcrst(false);
    });
    control.modify(|w| {
        w.set_icen(true);
        w.set_dcen(true);
        w.set_prften(prefetch);
    });
}

/// Clears the data cache. Call after an erase of a sector, because the cache does not follow erases (RM0090 section
/// 3.5.2). embassy's driver clears it only on chips with two banks.
pub fn clear_data_cache() {
    let control = pac::FLASH.acr();
    control.modify(|w| w.set_dcen(false));
    control.modify(|w| w.set_dcrst(true));
    control.modify(|w| w.set_dcrst(false));
    control.modify(|w| w.set_dcen(true));
}

/// Returns the clock tree, with all DMA interrupts below the control interrupt.
fn clock_tree() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = false;
    config.rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Oscillator });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.mux.clk48sel = mux::Clk48sel::PLL1_Q;
    config.dma_interrupt_priority = critical::OTHERS;
    config
}
