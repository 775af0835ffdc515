//! Index pulses of the encoders: the chip latches every rising edge (EXTI, RM0090 section 12.3), and the control step
//! looks at the latches. A pulse is seen at the step after it, so its count is late by at most what the joint moved in
//! that step.
//!
//! No interrupt is enabled for them: the lines pend in the controller and are read there. Index inputs are pins of port
//! C, named by a mask of their bits, as they are in every register of the controller.

use embassy_stm32::pac;
use embassy_stm32::pac::exti::regs::Lines;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::servo::joints::Counts;

/// Latches rising edges at these pins of port C, pulled up as the encoders' channels are.
pub fn latch(lines: u32) {
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    for four in 0..4 {
        // Port C in all four fields of the register.
        pac::SYSCFG.exticr(four).write(|w| w.0 = 0x2222);
    }
    // Inputs since the reset; two bits a pin: each pin's lower bit is the pull-up.
    pac::GPIOC.pupdr().modify(|w| (0..16).filter(|pin| lines >> pin & 1 == 1).for_each(|pin| w.0 |= 1 << (2 * pin)));
    pac::EXTI.rtsr(0).modify(|w| w.0 |= lines);
    pac::EXTI.imr(0).modify(|w| w.0 |= lines);
}

/// The lines of pins; the others are not index pulses.
const PINS: u32 = 0xFFFF;

/// The lines that saw a pulse since [`take`].
#[inline(always)]
pub fn seen() -> u32 {
    pac::EXTI.pr(0).read().0 & PINS
}

/// The counts of encoders whose line saw a pulse since the last call; `lines` are theirs.
#[cold]
pub fn take(lines: &[u32], counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
    let seen = seen();
    // A flag is cleared by writing 1.
    pac::EXTI.pr(0).write_value(Lines(seen));
    let mut marks = [None; MAX_JOINTS];
    for ((mark, line), count) in marks.iter_mut().zip(lines).zip(counts.iter()) {
        *mark = (seen & line != 0).then_some(*count);
    }
    marks
}
