//! The PWM carrier for a control rate: frequency, number of periods in a control step, and delay.
//!
//! The carrier is centre-aligned: a timer counts up to a crest and down to a valley. Encoders and currents are sampled
//! at the crest. A duty that is written after the crest applies at the next valley, half a carrier period later.

use super::motor_stage::MotorDrive;
use super::stage::Duty;

/// Lowest carrier frequency, Hz: above the audible range.
pub const CARRIER_MIN_HZ: u32 = 20_000;
/// Lowest and highest control rate, Hz.
pub const RATE_HZ: (u32, u32) = (200, 50_000);

/// The timer's setting for a control rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Carrier {
    /// Timer ticks from valley to crest.
    pub top: u16,
    /// Carrier periods in a control step; at least 1.
    pub divider: u16,
    /// Counting frequency of the timer, Hz.
    pub timer_hz: u32,
}

impl Carrier {
    /// Returns the carrier of a timer that counts at `timer_hz` (at most 2.6 GHz) for a control rate in Hz, which is
    /// clamped to [`RATE_HZ`]. NaN becomes the lowest rate. The carrier is the smallest multiple of the rate that is at
    /// least 20 kHz, so it is between 20 and 50 kHz.
    pub fn for_rate(timer_hz: u32, rate_hz: f32) -> Self {
        let rate_hz = (rate_hz as u32).clamp(RATE_HZ.0, RATE_HZ.1);
        let divider = CARRIER_MIN_HZ.div_ceil(rate_hz);
        let twice = 2 * divider * rate_hz;
        let top = (timer_hz + twice / 2) / twice;
        Self { top: top as u16, divider: divider as u16, timer_hz }
    }

    /// Returns the frequency of the carrier, Hz.
    pub fn carrier_hz(&self) -> f32 {
        self.timer_hz as f32 / (2.0 * f32::from(self.top))
    }

    /// Returns the resulting control rate, Hz: within 0.05 % of the requested rate with a timer of 168 MHz.
    pub fn rate_hz(&self) -> f32 {
        self.carrier_hz() / f32::from(self.divider)
    }

    /// Returns the conversion from duties to compare values.
    pub fn ticks(&self) -> Ticks {
        Ticks::of(self.top)
    }

    /// Returns the delay from a sample to its duty, in control periods: half a carrier period.
    pub fn delay_samples(&self) -> f32 {
        0.5 / f32::from(self.divider)
    }
}

/// Conversion of duties to a carrier's compare values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    /// Ticks from the middle of the range to either end.
    half: f32,
    /// Compare values of both legs, each in one half of the word, at [`Ticks::ROUNDING_OFFSET`] ticks from the middle.
    middle: u32,
}

/// Compare values of a bridge's legs, aligned so that one instruction stores a pair.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C, align(4))]
pub struct LegTicks {
    /// The legs of a brushed motor.
    pub pair: [u16; 2],
    /// Third leg of a three-phase motor.
    pub third: u16,
}

impl Ticks {
    /// Offset of the ticks from the middle, so that truncation rounds negative ticks like positive ticks.
    const ROUNDING_OFFSET: u32 = 1 << 15;

    fn of(top: u16) -> Self {
        let middle = u32::from(top).div_ceil(2);
        let [first, second] = [middle.wrapping_sub(Self::ROUNDING_OFFSET), middle.wrapping_add(Self::ROUNDING_OFFSET)];
        Self { half: 0.5 * f32::from(top), middle: first.wrapping_add(second << 16) }
    }

    /// Returns the compare values of a bridge's legs for a drive.
    #[inline(always)]
    pub fn legs(&self, drive: MotorDrive) -> LegTicks {
        match drive {
            MotorDrive::Bridge(duty) => LegTicks { pair: self.two_legs(duty), third: 0 },
            MotorDrive::ThreePhase { legs, .. } => {
                let [first, second, third] = legs.map(|leg| (2.0 * self.half * leg + 0.5) as u32 as u16);
                LegTicks { pair: [first, second], third }
            }
        }
    }

    /// Returns the compare values of a bridge's two legs for a duty. One leg is as far above the middle as the other
    /// leg is below, so a duty of 0 makes exactly no voltage.
    #[inline(always)]
    fn two_legs(&self, duty: Duty) -> [u16; 2] {
        let ticks = (Self::ROUNDING_OFFSET as f32 + 0.5 + f32::from(duty) * self.half) as u32;
        // One subtraction sets both legs, because the second leg loses the ticks that the first leg gains.
        let both = self.middle.wrapping_add(ticks.wrapping_sub(ticks << 16));
        [both as u16, (both >> 16) as u16]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counting frequency of the boards' timers, Hz.
    const TIMER_HZ: u32 = 168_000_000;

    #[test]
    fn usual_rates_are_exact() {
        for (rate, top, divider) in [(200.0, 4200, 100), (1000.0, 4200, 20), (20_000.0, 4200, 1), (50_000.0, 1680, 1)] {
            let carrier = Carrier::for_rate(TIMER_HZ, rate);
            assert_eq!((carrier.top, carrier.divider), (top, divider));
            assert_eq!(carrier.rate_hz(), rate);
        }
        assert_eq!(Carrier::for_rate(TIMER_HZ, 1000.0).delay_samples(), 0.025);
    }

    #[test]
    fn every_rate_is_close_and_has_an_inaudible_carrier() {
        for rate in (200..=50_000).step_by(7) {
            let carrier = Carrier::for_rate(TIMER_HZ, rate as f32);
            assert!((19_990.0..=50_000.0).contains(&carrier.carrier_hz()), "{rate} Hz: {carrier:?}");
            assert!((carrier.rate_hz() / rate as f32 - 1.0).abs() < 5.0e-4, "{rate} Hz: {carrier:?}");
        }
    }

    #[test]
    fn legs_differ_by_the_duty_and_coincide_for_invalid_duties() {
        let legs_of = |top: u16, share: f32| {
            let carrier = Carrier { top, divider: 1, timer_hz: TIMER_HZ };
            carrier.ticks().two_legs(Duty::nearest(share))
        };
        // The largest distance from the middle is 0.92 of 2100 ticks.
        for (share, legs) in [(0.0, [2100, 2100]), (0.5, [3150, 1050]), (-1.0, [168, 4032]), (9.0, [4032, 168])] {
            assert_eq!(legs_of(4200, share), legs, "{share}");
        }
        // An odd top has no tick in its middle. The legs still meet at one tick, at equal distances from both ends.
        for (share, legs) in [(0.0, [841, 841]), (0.5, [1261, 421]), (-0.5, [421, 1261])] {
            assert_eq!(legs_of(1681, share), legs, "{share}");
        }
        for invalid in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(legs_of(4200, invalid), [2100, 2100]);
        }
    }

    #[test]
    fn invalid_rates_become_the_nearest_rate() {
        for (requested, rate) in [(f32::NAN, 200.0), (-1.0, 200.0), (f32::INFINITY, 50_000.0), (1.0e9, 50_000.0)] {
            assert_eq!(Carrier::for_rate(TIMER_HZ, requested).rate_hz(), rate);
        }
    }
}
