//! Index pulses of the encoders. The chip latches every rising edge (EXTI, RM0090 section 12.3), and the control
//! interrupt reads the latches at every step, so the count of a pulse is late by at most the motion of one step.
//!
//! No interrupt is enabled for the lines. They pend in the interrupt controller and are read there. Index inputs are
//! pins of port C, given as bit masks like in every register of the controller.

use embassy_stm32::pac;
use embassy_stm32::pac::exti::regs::Lines;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::model::catalogue::MAX_JOINTS;

/// Latches rising edges at these pins of port C, with pull-ups like the encoders' channels.
pub fn latch(lines: u32) {
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    for four in 0..4 {
        // Selects port C in all four fields of the register.
        pac::SYSCFG.exticr(four).write(|w| w.0 = 0x2222);
    }
    // The pins are inputs since the reset. Each pin has two bits, and the lower one is the pull-up.
    pac::GPIOC.pupdr().modify(|w| (0..16).filter(|pin| lines >> pin & 1 == 1).for_each(|pin| w.0 |= 1 << (2 * pin)));
    pac::EXTI.rtsr(0).modify(|w| w.0 |= lines);
    pac::EXTI.imr(0).modify(|w| w.0 |= lines);
}

/// Lines of the interrupt controller that belong to pins.
const PINS: u32 = 0xFFFF;

/// Returns the lines with a pulse since the last call of [`take_pulses`].
#[inline(always)]
pub fn pending_lines() -> u32 {
    pac::EXTI.pr(0).read().0 & PINS
}

/// Returns the counts of the encoders with an index pulse since the last call, and clears the latches. `lines` are the
/// index lines.
#[cold]
pub fn take_pulses(lines: &[u32], counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
    let pending = pending_lines();
    // A flag is cleared by writing 1.
    pac::EXTI.pr(0).write_value(Lines(pending));
    let mut marks = [None; MAX_JOINTS];
    for ((mark, line), count) in marks.iter_mut().zip(lines).zip(counts.iter()) {
        *mark = (pending & line != 0).then_some(*count);
    }
    marks
}
