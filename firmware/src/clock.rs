//! Clocks: an 8 MHz crystal to 168 MHz for the core, 84 MHz for the fast peripheral bus (168 MHz at its timers,
//! [`TIMER_HZ`]), 42 MHz for the slow one (84 MHz at its timers), 48 MHz for USB. STM32F405 reference manual RM0090,
//! section 7.2. The clock of the tasks is embassy's, on TIM5.

use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk, mux,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, pac};

use crate::critical;

/// Frequency that the PWM timers count at, Hz.
pub const TIMER_HZ: u32 = 168_000_000;

/// Starts the clocks and takes the chip's peripherals.
pub fn start() -> Peripherals {
    // embassy's clock counts half turns of TIM5 by its interrupt. The update event that loads the timer matches its
    // count, 0, with the comparison that is still 0, and the flag of that would be taken for a half turn: the clock
    // would then be half a turn ahead, and read 65 ms early between any half turn and its interrupt. No half turn can
    // have passed before the section ends.
    critical_section::with(|_| {
        let chip = embassy_stm32::init(config());
        pac::TIM5.sr().write(|w| w.0 = 0);
        chip
    })
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
