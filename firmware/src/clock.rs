//! Clocks: an 8 MHz crystal to 168 MHz for the core, 84 MHz for the fast peripheral bus (168 MHz at its timers,
//! [`TIMER_HZ`]), 42 MHz for the slow one (84 MHz at its timers), 48 MHz for USB. STM32F405 reference manual RM0090,
//! section 7.2. The clock of the tasks is embassy's, on TIM5.

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

/// The supply monitor's line of the interrupt controller.
const SUPPLY_LINE: usize = 16;

/// The chip's identity (RM0090 section 38.6.1), except for its first revision, A (errata sheet ES0182, "MCU device ID
/// is incorrect").
const NOT_REVISION_A: u16 = 0x413;

/// Waits until the chip's own supply is above a `level` of its monitor: below 2.7 V, flash is too
/// slow for the clock that comes. The chip runs on its own oscillator meanwhile, which 1.8 V are enough for, and below
/// those its power-on reset holds it. So no brown-out level need be set in the option bytes.
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

/// The brown-out level in the option bytes, 0 (off) to 3 (2.7 V), which the firmware only reads (RM0090 section
/// 3.9.10).
pub fn brown_out_level() -> u8 {
    3 - pac::FLASH.optcr().read().bor_lev()
}

/// From here on a crystal that stops is a non-maskable interrupt (RM0090 section 7.2.7), and a supply that falls below
/// the `level` an interrupt (line 16, section 12.2.5) that neither a critical section nor a control step
/// holds back. [`crate::reset`] has both.
fn watch(level: u8) {
    pac::RCC.cr().modify(|w| w.set_csson(true));
    // embassy has reset the power controller.
    monitor_supply(level);
    pac::EXTI.rtsr(0).modify(|w| w.set_line(SUPPLY_LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(SUPPLY_LINE, true));
    interrupt::PVD.set_priority(critical::SUPPLY);
    // SAFETY: its handler shares nothing with what it interrupts.
    unsafe { interrupt::PVD.enable() };
    if pac::PWR.csr1().read().pvdo() {
        interrupt::PVD.pend();
    }
}

/// Starts the clocks and takes the chip's peripherals.
pub fn start(level: u8) -> Peripherals {
    // embassy's clock counts half turns of TIM5 by its interrupt. The update event that loads the timer matches its
    // count, 0, with the comparison that is still 0, and the flag of that would be taken for a half turn: the clock
    // would then be half a turn ahead, and read 65 ms early between any half turn and its interrupt. No half turn can
    // have passed before the section ends.
    critical_section::with(|_| {
        let chip = embassy_stm32::init(config());
        pac::TIM5.sr().write(|w| w.0 = 0);
        accelerate();
        watch(level);
        chip
    })
}

/// Hides most of the flash's five wait states: 64 lines of instructions, 8 of data, and the next line fetched ahead
/// (RM0090 section 3.5.2). A reset leaves all three off, and so does embassy; the control interrupt would then take
/// twice the time. Fetching ahead does not work in revision A.
fn accelerate() {
    let prefetch = pac::DBGMCU.idcode().read().dev_id() == NOT_REVISION_A;
    let control = pac::FLASH.acr();
    // Both caches empty, which they can be made only while they are off.
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

/// Empties the cache of constants: after a sector was erased, which it knows nothing of (RM0090 section 3.5.2).
/// embassy's driver does so on chips with two banks alone.
pub fn forget_constants() {
    let control = pac::FLASH.acr();
    control.modify(|w| w.set_dcen(false));
    control.modify(|w| w.set_dcrst(true));
    control.modify(|w| w.set_dcrst(false));
    control.modify(|w| w.set_dcen(true));
}

/// The clock tree, and all DMA interrupts below the control interrupt.
fn config() -> Config {
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
