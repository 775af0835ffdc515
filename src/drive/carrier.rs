//! The PWM carrier behind a control rate: which frequency, how many of its periods a control step has, and what delay
//! that makes.
//!
//! The carrier is centre-aligned: a timer counts up to a crest and back down to a valley. Encoders and currents are
//! sampled at the crest, and a duty written then applies at the next valley, half a carrier period later.

use super::stage::Duty;

/// Slowest carrier, Hz: above what people hear.
pub const CARRIER_MIN_HZ: u32 = 20_000;

/// Lowest and highest control rate, Hz.
pub const RATE_HZ: (u32, u32) = (200, 50_000);

/// The timer's setting for a control rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Carrier {
    /// Timer ticks from valley to crest.
    pub top: u16,
    /// Carrier periods in a control step, at least 1.
    pub divider: u16,
    /// Frequency that the timer counts at, Hz.
    pub timer_hz: u32,
}

impl Carrier {
    /// The carrier that a timer counting at `timer_hz` (Hz, at most 2.6 GHz) makes for a control rate in Hz. Rates
    /// outside [`RATE_HZ`] are moved to the nearer end, and NaN to the lower.
    ///
    /// It is the smallest multiple of the rate from 20 kHz up, so it lies between 20 and 50 kHz, and a duty has at
    /// least `timer_hz` / 100 kHz steps.
    pub fn for_rate(timer_hz: u32, rate_hz: f32) -> Self {
        let rate_hz = (rate_hz as u32).clamp(RATE_HZ.0, RATE_HZ.1);
        let divider = CARRIER_MIN_HZ.div_ceil(rate_hz);
        let twice = 2 * divider * rate_hz;
        let top = (timer_hz + twice / 2) / twice;
        Self { top: top as u16, divider: divider as u16, timer_hz }
    }

    /// Frequency of the carrier, Hz.
    pub fn carrier_hz(&self) -> f32 {
        self.timer_hz as f32 / (2.0 * f32::from(self.top))
    }

    /// The control rate that comes out, Hz: within 0.05 % of the one asked for with a timer of 168 MHz.
    pub fn rate_hz(&self) -> f32 {
        self.carrier_hz() / f32::from(self.divider)
    }

    /// The conversion from duties to its ticks.
    pub fn ticks(&self) -> Ticks {
        Ticks::of(self.top)
    }

    /// Delay from sampling to the duty that answers it, in control samples: half a carrier period.
    pub fn delay_samples(&self) -> f32 {
        0.5 / f32::from(self.divider)
    }
}

/// A carrier's duties as compare values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    /// Ticks from the middle to either end.
    half: f32,
    /// Compare values of two legs at the middle, one in each half, as they are for [`Ticks::OFFSET`] ticks from it.
    middle: u32,
}

impl Ticks {
    /// Added to the ticks from the middle, so that truncation rounds, below zero as above.
    const OFFSET: u32 = 1 << 15;

    fn of(top: u16) -> Self {
        let middle = u32::from(top).div_ceil(2);
        let [one, other] = [middle.wrapping_sub(Self::OFFSET), middle.wrapping_add(Self::OFFSET)];
        Self { half: 0.5 * f32::from(top), middle: one.wrapping_add(other << 16) }
    }

    /// Compare values of a bridge's two legs for a duty. One leg is as far above the middle as the other is below, so a
    /// duty of 0 is no voltage, to the tick.
    #[inline(always)]
    pub fn legs(&self, duty: Duty) -> [u16; 2] {
        let away = (Self::OFFSET as f32 + 0.5 + f32::from(duty) * self.half) as u32;
        // Both at once: what one half gains the other loses.
        let both = self.middle.wrapping_add(away.wrapping_sub(away << 16));
        [both as u16, (both >> 16) as u16]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A usual one, Hz.
    const TIMER_HZ: u32 = 168_000_000;

    #[test]
    fn the_usual_rates_come_out_exactly() {
        for (rate, top, divider) in [(200.0, 4200, 100), (1000.0, 4200, 20), (20_000.0, 4200, 1), (50_000.0, 1680, 1)] {
            let carrier = Carrier::for_rate(TIMER_HZ, rate);
            assert_eq!((carrier.top, carrier.divider), (top, divider));
            assert_eq!(carrier.rate_hz(), rate);
        }
        assert_eq!(Carrier::for_rate(TIMER_HZ, 1000.0).delay_samples(), 0.025);
    }

    #[test]
    fn every_rate_has_an_inaudible_carrier_and_comes_out_close() {
        for rate in (200..=50_000).step_by(7) {
            let carrier = Carrier::for_rate(TIMER_HZ, rate as f32);
            assert!((19_990.0..=50_000.0).contains(&carrier.carrier_hz()), "{rate} Hz: {carrier:?}");
            assert!((carrier.rate_hz() / rate as f32 - 1.0).abs() < 5.0e-4, "{rate} Hz: {carrier:?}");
        }
    }

    #[test]
    fn legs_stand_apart_by_the_duty_and_together_for_nonsense() {
        let legs_of = |top: u16, share: f32| {
            let carrier = Carrier { top, divider: 1, timer_hz: TIMER_HZ };
            carrier.ticks().legs(Duty::nearest(share))
        };
        // 0.92 of 2100 ticks is the most.
        for (share, legs) in [(0.0, [2100, 2100]), (0.5, [3150, 1050]), (-1.0, [168, 4032]), (9.0, [4032, 168])] {
            assert_eq!(legs_of(4200, share), legs, "{share}");
        }
        // An odd top has no tick in its middle: the legs still stand at the same one, and as far from it either way.
        for (share, legs) in [(0.0, [841, 841]), (0.5, [1261, 421]), (-0.5, [421, 1261])] {
            assert_eq!(legs_of(1681, share), legs, "{share}");
        }
        for nonsense in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(legs_of(4200, nonsense), [2100, 2100]);
        }
    }

    #[test]
    fn nonsense_becomes_the_nearest_rate() {
        for (asked, rate) in [(f32::NAN, 200.0), (-1.0, 200.0), (f32::INFINITY, 50_000.0), (1.0e9, 50_000.0)] {
            assert_eq!(Carrier::for_rate(TIMER_HZ, asked).rate_hz(), rate);
        }
    }
}
