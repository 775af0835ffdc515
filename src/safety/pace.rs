//! Checks that the control loop keeps its pace: as often as its rate says, no more and no less.

/// A loop that runs more often than this, % of its rate, is as broken as one that stops. Its timer and the clock that
/// measures it run from one crystal, so a sound loop is off by no more than a step or two at either end.
const TOO_OFTEN_PERCENT: u64 = 110;
/// A loop that runs less often than this sums up heat, stalls and silence over the wrong time.
const TOO_SELDOM_PERCENT: u64 = 90;
/// Steps by which a count may be off because it does not begin and end with a step.
const ENDS: u64 = 4;
/// Looks are added up until this many steps are due, so that [`ENDS`] is a twentieth of them at any rate.
const ENOUGH: u64 = 80;

/// The state of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As its rate says, as far as can be told yet.
    Kept,
    /// More often.
    TooOften,
    /// Less often.
    TooSeldom,
}

/// Holds the number of steps to the time that passed, look by look.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Steps and time (µs) since the looks were begun to be added up.
    taken: u64,
    elapsed: u64,
    /// The rate at the last look, Hz.
    rate: u64,
    /// The last finding. A loop that was found wrong stays so until enough steps have shown it right: the first looks
    /// after would tell nothing.
    found: Verdict,
}

impl Pace {
    /// A loop that begins at `rate_hz`.
    pub fn new(rate_hz: u32) -> Self {
        Self { taken: 0, elapsed: 0, rate: rate_hz.into(), found: Verdict::Kept }
    }

    /// `steps` were taken in the `elapsed_us` (µs) since the last look; the rate is `rate_hz` now. `excused`: there was
    /// a reason to take fewer.
    pub fn look(&mut self, steps: u32, elapsed_us: u64, rate_hz: u32, excused: bool) -> Verdict {
        let before = core::mem::replace(&mut self.rate, rate_hz.into());
        self.taken = self.taken.saturating_add(steps.into());
        self.elapsed = self.elapsed.saturating_add(elapsed_us);
        // The faster of two rates, where one replaced the other meanwhile; and the slower one.
        let rates = (before.min(self.rate), before.max(self.rate));
        let [alone, together] = [(u64::from(steps), elapsed_us), (self.taken, self.elapsed)]
            .map(|(taken, elapsed)| verdict(taken, elapsed, rates, excused));
        let now = if alone == Verdict::Kept { together } else { alone };
        if now != Verdict::Kept || excused || before != self.rate || expected(self.elapsed, self.rate, 100) >= ENOUGH {
            self.found = now;
            (self.taken, self.elapsed) = (0, 0);
        }
        self.found
    }
}

/// Steps in `elapsed` (µs) at so many per cent of a rate (Hz).
fn expected(elapsed: u64, rate: u64, percent: u64) -> u64 {
    elapsed.saturating_mul(rate).saturating_mul(percent) / 100_000_000
}

fn verdict(taken: u64, elapsed: u64, (slower, faster): (u64, u64), excused: bool) -> Verdict {
    if taken > expected(elapsed, faster, TOO_OFTEN_PERCENT).saturating_add(ENDS) {
        Verdict::TooOften
    } else if !excused && taken.saturating_add(ENDS) < expected(elapsed, slower, TOO_SELDOM_PERCENT) {
        Verdict::TooSeldom
    } else {
        Verdict::Kept
    }
}
