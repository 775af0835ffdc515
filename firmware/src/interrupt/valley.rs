//! The work at a valley of the carrier: records the last step, checks for slow faults, carries out at most one request.

use core::sync::atomic::Ordering;

use cortex_m::peripheral::DWT;
use embassy_stm32::pac;
use haptic_bridge::control::{Command, compiled};

use super::exchange::{Exchange, Outcome, Request};
use super::shared::increment;
use super::{
    ABSOLUTE, CONTROL, EXTREME_CYCLES, InterruptState, NO_STEP, OVERRAN, UNCONNECTED, UNRECORDED, initial_countdown,
};
use crate::board::Io as _;
use crate::warmth;

impl InterruptState {
    #[inline(always)]
    pub(super) fn valley(&mut self) {
        self.cycles_at_valley = DWT::cycle_count();
        if self.step_countdown & ABSOLUTE != 0 {
            self.latch_angles();
        }
        if !self.is_driving {
            self.valley_floating();
        }
        self.io.clear_flags();
        // The timer has just loaded the duties of the last step, unless the duties are late.
        if self.duties_pending {
            self.duties_pending = false;
            self.io.write(&self.legs);
        }
        if self.step_countdown & UNRECORDED != 0 {
            self.record();
        } else {
            self.check_crest_between();
        }
        let drives = compiled::check_slow_faults(&mut self.control_loop, &self.samples).bridges;
        if !drives && self.is_driving {
            self.float_bridges();
        }
        let request = CONTROL.request.load(Ordering::Acquire);
        if !request.is_null() {
            // SAFETY: `Requests::exchange` stored the pointer and keeps the exchange, with everything it borrows, alive
            // until the pointer is null again. There is one `Requests`, and it is in one exchange at a time.
            if self.carry_out(unsafe { &mut *request }) {
                CONTROL.request.store(core::ptr::null_mut(), Ordering::Release);
            }
            if self.is_driving && self.cycles_since_valley() > 2 * u32::from(self.io.carrier().top) {
                self.crest_missed();
            }
        }
    }

    #[cold]
    #[inline(never)]
    fn latch_angles(&mut self) {
        if let Some(sensors) = self.io.angle_sensors() {
            sensors.latch();
        }
    }

    /// Checks that a crest without a step preceded this valley. Otherwise a crest passed while the core was busy.
    #[cold]
    #[inline(never)]
    fn check_crest_between(&mut self) {
        if self.step_countdown & NO_STEP == 0 && self.is_driving {
            self.crest_missed();
        }
        self.step_countdown &= !NO_STEP;
    }

    /// Turns the motors off because a crest passed without its interrupt.
    #[cold]
    #[inline(never)]
    fn crest_missed(&mut self) {
        increment(&CONTROL.shared.overruns);
        self.trip_overrun();
        self.float_bridges();
    }

    /// Handles a missed valley: the valley, and perhaps crests, passed while the core was busy.
    pub(super) fn valley_missed(&mut self) {
        if self.step_countdown & UNRECORDED != 0 {
            self.record();
        }
        if self.step_countdown & OVERRAN == 0 && self.is_driving {
            self.step_countdown |= OVERRAN;
            increment(&CONTROL.shared.overruns);
        }
    }

    /// Begins a valley while the bridges float. The bridges are connected at an extreme of the carrier: here or, if
    /// this interrupt is late, at the next crest. Between two extremes, a bridge whose legs follow one channel and its
    /// complement would drive its motor for the rest of half a period, which adds amperes.
    #[cold]
    #[inline(never)]
    fn valley_floating(&mut self) {
        if !self.may_connect() {
            if !self.control_loop.status().state.drives() {
                self.missed_connections = 0;
            }
            if self.io.has_sampled() {
                self.io.learn_zeros();
            }
        } else if pac::TIM1.cnt().read().0 < EXTREME_CYCLES {
            self.connect();
        } else {
            self.step_countdown |= UNCONNECTED;
            self.count_missed_connection();
        }
    }

    /// Carries out one request and writes its outcome. Returns false if work remains for the next valley. Not inlined,
    /// because requests are rare and inlining would lengthen the path to the step.
    #[inline(never)]
    fn carry_out(&mut self, exchange: &mut Exchange) -> bool {
        let (request, outcome) = match exchange {
            Exchange::Force(request, reply) => {
                **reply = Some(self.control_loop.force(request));
                return true;
            }
            Exchange::Request(request, outcome) => (request, outcome),
        };
        let (mut reply, mut more) = ((Ok(()), None), false);
        match request {
            Request::None | Request::Status => {}
            Request::Command(Command::Program(_)) => {
                if let Request::Command(Command::Program(mut program)) = core::mem::replace(request, Request::None) {
                    match self.control_loop.accepts(&mut program) {
                        Ok(()) => (*request, more) = (Request::Install(program), true),
                        Err(refusal) => reply = (Err(refusal), Some(program)),
                    }
                }
            }
            Request::Install(_) => {
                if let Request::Install(program) = core::mem::replace(request, Request::None) {
                    reply.1 = self.control_loop.install(program);
                    self.io.connect_third_legs(self.control_loop.three_phase_axes());
                    self.connect_angle_sensors();
                }
            }
            Request::Command(command) => {
                reply.0 = self.control_loop.obey(command);
                if reply.0.is_ok() {
                    (*request, more) = (Request::Settle, true);
                }
            }
            Request::Settle => more = self.control_loop.settle_next(),
            Request::Retime(carrier) => {
                if !self.is_driving {
                    self.io.set_carrier(*carrier);
                    self.ticks = carrier.ticks();
                    let absolute = self.initial_countdown & ABSOLUTE;
                    (self.initial_countdown, self.step_countdown) = (initial_countdown(carrier) | absolute, absolute);
                    let longest = CONTROL.shared.longest_cycles.load(Ordering::Relaxed);
                    CONTROL
                        .shared
                        .least_margin
                        .store(u32::from(carrier.top).saturating_sub(longest), Ordering::Relaxed);
                }
            }
        }
        if matches!(request, Request::Status) {
            // Copies the heat about fifty times a second to memory that survives a reset.
            warmth::store(self.control_loop.heat());
        }
        let status = self.control_loop.status();
        if !status.state.drives() && self.is_driving {
            self.float_bridges();
        }
        if more {
            return false;
        }
        **outcome = Some(Outcome { reply, status });
        true
    }

    /// Records the last step, in a frame of telemetry if a frame is due.
    #[inline(never)]
    fn record(&mut self) {
        self.step_countdown &= !UNRECORDED;
        let steps = self.control_loop.steps();
        CONTROL.shared.steps.store(steps, Ordering::Relaxed);
        if self.control_loop.has_sensed() {
            self.io.update_other_counts(&mut self.samples.counts);
            compiled::sense(&mut self.control_loop, &self.samples.counts);
        }
        let due = steps.checked_rem(CONTROL.shared.stream_divider.load(Ordering::Relaxed)) == Some(0);
        let pushed =
            due && CONTROL.frames.push(|place| compiled::note(&mut self.control_loop, &self.samples, Some(place)));
        if !pushed {
            compiled::note(&mut self.control_loop, &self.samples, None);
            if due {
                // This interrupt is the only writer while a stream runs.
                increment(&CONTROL.shared.frames_dropped);
            }
        }
    }
}
