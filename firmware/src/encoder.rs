//! Quadrature encoders. A 16-bit timer counts the edges of both channels (four counts per line). Software extends the
//! count by wrap-safe differences, which are exact if an encoder moves less than 32 768 counts between two readings.

use embassy_stm32::gpio::{AfType, Flex, Pull};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::{TimGp16, vals};

/// TIM2 as a timer of 16 bits.
// SAFETY: TIM2 has 32 bits and the registers of a 16-bit timer at the same places; `start` lets it count to 65 535.
#[cfg_attr(feature = "toy-board", allow(dead_code, reason = "the toy board has one encoder"))]
pub const TIM2: TimGp16 = unsafe { TimGp16::from_ptr(pac::TIM2.as_ptr()) };

/// Starts a timer that counts the encoder at its channels 1 and 2, from 0. The timer's clock must be on. The inputs are
/// pulled up for open-collector encoders, and filtered over eight timer clocks (95 ns), for up to two million counts
/// per second.
pub fn start(timer: TimGp16, mut a: Flex<'static>, mut b: Flex<'static>, alternate_function: u8) {
    a.set_as_af_unchecked(alternate_function, AfType::input(Pull::Up));
    b.set_as_af_unchecked(alternate_function, AfType::input(Pull::Up));
    // Dropping a pin would return it to analog mode.
    core::mem::forget(a);
    core::mem::forget(b);
    timer.ccmr_input(0).write(|w| {
        for channel in 0..2 {
            w.set_ccs(channel, vals::CcmrInputCcs::TI4);
            w.set_icf(channel, vals::FilterValue::FCK_INT_N8);
        }
    });
    timer.smcr().write(|w| w.set_sms(vals::Sms::ENCODER_MODE_3));
    timer.arr().write(|w| w.set_arr(u16::MAX));
    timer.cnt().write(|w| w.set_cnt(0));
    timer.cr1().write(|w| w.set_cen(true));
}

/// Updates a count, which was 0 when the timer started and wraps at the ends of `i32`. Its lower half is the timer's
/// last value.
#[inline(always)]
pub fn update_count(timer: TimGp16, count: &mut i32) {
    let moved = (timer.cnt().read().0 as u16).wrapping_sub(*count as u16) as i16;
    *count = count.wrapping_add(i32::from(moved));
}
