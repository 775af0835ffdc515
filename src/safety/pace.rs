//! Checks that the control loop runs at its rate.

/// Upper limit of the measured rate, % of the nominal rate. The loop's timer and the measuring clock run from one
/// crystal, so a correct loop is off by a step or two at most at either end.
const MAX_RATE_PERCENT: u64 = 110;
/// Lower limit of the measured rate, %. A slower loop sums up heat, stalls and silence over the wrong time.
const MIN_RATE_PERCENT: u64 = 90;
/// Largest error of a count of steps, because the interval does not begin and end with a step.
const END_STEPS: u64 = 4;
/// Number of due steps over which checks are accumulated, so that [`END_STEPS`] is only a twentieth of these steps.
const MIN_STEPS: u64 = 80;

/// Result of a check of the loop's rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The rate is right as far as the steps show.
    RightRate,
    /// The loop runs too often.
    TooFast,
    /// The loop runs too rarely.
    TooSlow,
}

/// Compares the number of steps with the elapsed time.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Steps since the accumulation began.
    steps: u64,
    /// Time since the accumulation began, µs.
    elapsed_us: u64,
    /// Rate at the last check, Hz.
    rate: u64,
    /// Last result. [`Verdict::TooFast`] and [`Verdict::TooSlow`] stay until enough steps have shown the right rate.
    found: Verdict,
}

impl Pace {
    /// Returns the state for a loop that starts at `rate_hz`.
    pub fn new(rate_hz: u32) -> Self {
        Self { steps: 0, elapsed_us: 0, rate: rate_hz.into(), found: Verdict::RightRate }
    }

    /// Checks `steps` taken in the `elapsed_us` (µs) since the last check at the present rate `rate_hz`. `excused` is
    /// true if there was a reason to take fewer steps.
    pub fn check_rate(&mut self, steps: u32, elapsed_us: u64, rate_hz: u32, excused: bool) -> Verdict {
        let before = core::mem::replace(&mut self.rate, rate_hz.into());
        self.steps = self.steps.saturating_add(steps.into());
        self.elapsed_us = self.elapsed_us.saturating_add(elapsed_us);
        // Slower and faster rate, if the rate changed since the last check.
        let rates = (before.min(self.rate), before.max(self.rate));
        let [alone, together] = [(u64::from(steps), elapsed_us), (self.steps, self.elapsed_us)]
            .map(|(taken, elapsed)| verdict(taken, elapsed, rates, excused));
        let now = if alone == Verdict::RightRate { together } else { alone };
        if now != Verdict::RightRate
            || excused
            || before != self.rate
            || expected_steps(self.elapsed_us, self.rate, 100) >= MIN_STEPS
        {
            self.found = now;
            (self.steps, self.elapsed_us) = (0, 0);
        }
        self.found
    }
}

/// Returns the number of steps in `elapsed` (µs) at `percent` of a rate (Hz).
fn expected_steps(elapsed: u64, rate: u64, percent: u64) -> u64 {
    elapsed.saturating_mul(rate).saturating_mul(percent) / 100_000_000
}

fn verdict(taken: u64, elapsed: u64, (slower, faster): (u64, u64), excused: bool) -> Verdict {
    if taken > expected_steps(elapsed, faster, MAX_RATE_PERCENT).saturating_add(END_STEPS) {
        Verdict::TooFast
    } else if !excused && taken.saturating_add(END_STEPS) < expected_steps(elapsed, slower, MIN_RATE_PERCENT) {
        Verdict::TooSlow
    } else {
        Verdict::RightRate
    }
}
