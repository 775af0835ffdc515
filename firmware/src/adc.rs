//! Analog conversions by two converters. TIM1 starts one injected sequence of each at the crest of the carrier.
//!
//! The conversion clock is 21 MHz. A value takes 3 cycles of sampling and 12 of conversion, 0.71 us. STM32F405
//! reference manual RM0090, section 13.

use embassy_stm32::gpio::Flex;
use embassy_stm32::pac;
use embassy_stm32::pac::adc::regs::Sr;
use embassy_stm32::pac::adc::{Adc, vals};

/// Counts of a full-scale reading.
pub const FULL_SCALE: f32 = 4096.0;
pub const REFERENCE_V: f32 = 3.3;
/// Number of TIM1's trigger output among the F405's injected triggers.
const TIM1_TRIGGER: u8 = 1;

/// Assigns pins to the converters permanently.
pub fn inputs<const N: usize>(pins: [Flex<'static>; N]) {
    for mut pin in pins {
        pin.set_as_analog();
        core::mem::forget(pin);
    }
}

/// Configures a converter, whose clock must be on, for an injected sequence of up to four channels.
pub fn configure(adc: Adc, channels: &[u8]) {
    pac::ADC123_COMMON.ccr().modify(|w| w.set_adcpre(pac::adccommon::vals::Adcpre::DIV4));
    let channels = &channels[..channels.len().min(4)];
    adc.cr1().write(|w| w.set_scan(true));
    adc.jsqr().write(|w| {
        w.set_jl(channels.len() as u8 - 1);
        // A sequence shorter than four uses the last ranks, but the first data registers (RM0090 13.13.12).
        for (rank, channel) in channels.iter().enumerate() {
            w.set_jsq(4 - channels.len() + rank, *channel);
        }
    });
    for channel in channels {
        match usize::from(*channel) {
            low @ 0..=9 => adc.smpr2().modify(|w| w.set_smp(low, vals::SampleTime::CYCLES3)),
            high => adc.smpr1().modify(|w| w.set_smp(high - 10, vals::SampleTime::CYCLES3)),
        }
    }
    adc.cr2().write(|w| {
        w.set_adon(true);
        w.set_jextsel(TIM1_TRIGGER);
        w.set_jexten(vals::Exten::RISING_EDGE);
    });
}

/// Returns true if both converters have finished the sequence that the crest started.
#[inline(always)]
pub fn have_finished(one: Adc, other: Adc) -> bool {
    Sr(one.sr().read().0 & other.sr().read().0).jeoc()
}

/// Waits until both converters have finished. Returns false after about 10 us, if a converter was not triggered.
#[inline(never)]
pub fn wait(one: Adc, other: Adc) -> bool {
    (0..200).any(|_| have_finished(one, other))
}

/// Clears the flags of the last sequence, so that the next wait is for the next sequence. Call at every valley.
#[inline(always)]
pub fn clear_flags(adc: Adc) {
    adc.sr().write(|w| {
        // Writing 0 clears a flag, and writing 1 leaves the flag unchanged.
        w.0 = 0x3F;
        w.set_jeoc(false);
        w.set_jstrt(false);
    });
}

/// Returns the result of a rank, 0 to 4095.
#[inline(always)]
pub fn result(adc: Adc, rank: usize) -> i32 {
    // The register's upper half reads as 0 (RM0090 13.13.14).
    adc.jdr(rank).read().0 as i32
}
