//! The valley of the carrier: it records the last step, checks for slow faults, and answers at most one request.

use core::sync::atomic::Ordering;

use cortex_m::peripheral::DWT;
use embassy_stm32::pac;
use haptic_bridge::servo::{Command, compiled};

use super::exchange::{Answer, Exchange, Request};
use super::shared::count;
use super::{BETWEEN, CONTROL, EXTREME_CYCLES, OVERRAN, Step, UNCONNECTED, UNRECORDED, after_step};
use crate::board::Io as _;
use crate::warmth;

impl Step {
    /// Everything there is to do at a valley.
    #[inline(always)]
    pub(super) fn valley(&mut self) {
        self.valley_at = DWT::cycle_count();
        if !self.driving {
            self.valley_at_rest();
        }
        self.io.forget();
        // The duties of the last step have just been taken over, or are late and come next.
        if self.pending {
            self.pending = false;
            self.io.write(&self.legs);
        }
        if self.before_step & UNRECORDED != 0 {
            self.record();
        } else {
            self.see_whether_between();
        }
        let drives = compiled::check_slow_faults(&mut self.servo, &self.seen).bridges;
        if !drives && self.driving {
            self.float();
        }
        let asked = CONTROL.asked.load(Ordering::Acquire);
        if !asked.is_null() {
            // SAFETY: `Requests::exchange` has put it there, and keeps it, with what it borrows, until it is null again. There
            // is one `Requests`, which can be in but one exchange.
            if self.take(unsafe { &mut *asked }) {
                CONTROL.asked.store(core::ptr::null_mut(), Ordering::Release);
            }
            if self.driving && self.since_valley() > 2 * u32::from(self.io.carrier().top) {
                self.crest_missed();
            }
        }
    }

    /// Sees whether there was a crest without a step before this valley. Where there was none at all, it came and went while
    /// the core did something else.
    #[cold]
    #[inline(never)]
    fn see_whether_between(&mut self) {
        if self.before_step & BETWEEN == 0 && self.driving {
            self.crest_missed();
        }
        self.before_step &= !BETWEEN;
    }

    /// A crest came and went.
    #[cold]
    #[inline(never)]
    fn crest_missed(&mut self) {
        count(&CONTROL.shared.overruns);
        self.miss();
        self.float();
    }

    /// No valley has come since the last crest: it came and went while the core did something else, and crests may have.
    pub(super) fn valley_missed(&mut self) {
        if self.before_step & UNRECORDED != 0 {
            self.record();
        }
        if self.before_step & OVERRAN == 0 && self.driving {
            self.before_step |= OVERRAN;
            count(&CONTROL.shared.overruns);
        }
    }

    /// The first work of a valley while the bridges float: they begin to drive at an extreme of the carrier, here or,
    /// where this interrupt is late, at the next crest. Between two extremes, a bridge whose ends follow one channel
    /// and its complement would drive its motor for the rest of half a period, which is worth whole amperes.
    #[cold]
    #[inline(never)]
    fn valley_at_rest(&mut self) {
        if !self.may_connect() {
            if !self.servo.status().state.drives() {
                self.unconnected = 0;
            }
            if self.io.sampled() {
                self.io.learn();
            }
        } else if pac::TIM1.cnt().read().0 < EXTREME_CYCLES {
            self.connect();
        } else {
            self.before_step |= UNCONNECTED;
            self.wait_on();
        }
    }

    /// Carries out one request and answers it; false where there is more to do of it at the next valley. Not inlined: it is
    /// rare, and would only lengthen the way to the step.
    #[inline(never)]
    fn take(&mut self, exchange: &mut Exchange) -> bool {
        let (request, answer) = match exchange {
            Exchange::Force(request, answer) => {
                **answer = Some(self.servo.force(request));
                return true;
            }
            Exchange::Request(request, answer) => (request, answer),
        };
        let (mut reply, mut more) = ((Ok(()), None), false);
        match request {
            Request::None | Request::Status => {}
            Request::Command(Command::Program(_)) => {
                if let Request::Command(Command::Program(mut program)) = core::mem::replace(request, Request::None) {
                    match self.servo.accepts(&mut program) {
                        Ok(()) => (*request, more) = (Request::Install(program), true),
                        Err(refusal) => reply = (Err(refusal), Some(program)),
                    }
                }
            }
            Request::Install(_) => {
                if let Request::Install(program) = core::mem::replace(request, Request::None) {
                    reply.1 = self.servo.install(program);
                }
            }
            Request::Command(command) => {
                reply.0 = self.servo.obey(command);
                if reply.0.is_ok() {
                    (*request, more) = (Request::Settle, true);
                }
            }
            Request::Settle => more = self.servo.settle_next(),
            Request::Retime(carrier) => {
                if !self.driving {
                    self.io.set_carrier(*carrier);
                    self.ticks = carrier.ticks();
                    (self.after_step, self.before_step) = (after_step(carrier), 0);
                    let longest = CONTROL.shared.longest_cycles.load(Ordering::Relaxed);
                    CONTROL.shared.least_left.store(u32::from(carrier.top).saturating_sub(longest), Ordering::Relaxed);
                }
            }
        }
        if matches!(request, Request::Status) {
            // Some fifty times a second, what a reset must not cool is put where it stays.
            warmth::keep(self.servo.heat());
        }
        let status = self.servo.status();
        if !status.state.drives() && self.driving {
            self.float();
        }
        if more {
            return false;
        }
        **answer = Some(Answer { reply, status });
        true
    }

    /// Notes and hands on what the last step left.
    #[inline(never)]
    fn record(&mut self) {
        self.before_step &= !UNRECORDED;
        let steps = self.servo.steps();
        CONTROL.shared.steps.store(steps, Ordering::Relaxed);
        let wanted = steps.checked_rem(CONTROL.shared.stream_divider.load(Ordering::Relaxed)) == Some(0);
        let pushed = wanted && CONTROL.frames.push(|place| compiled::note(&mut self.servo, &self.seen, Some(place)));
        if !pushed {
            compiled::note(&mut self.servo, &self.seen, None);
            if wanted {
                // This interrupt is the only writer while a stream runs.
                count(&CONTROL.shared.frames_dropped);
            }
        }
    }
}
