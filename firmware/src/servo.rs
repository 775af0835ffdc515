//! The control interrupt: at the crest of the carrier it samples, steps and writes the duties that apply at the next
//! valley.
//!
//! It runs at every update of TIM1, crests and valleys. At a valley it notes what the step before saw, sums up what takes
//! long to do harm, and takes at most one request from the tasks, so that none of it lengthens a step. At every crest it
//! holds what it sees to the limits and runs the current loops; at every k-th crest (k = [`Carrier::divider`]) it runs the
//! library's control step. All that it shares with tasks are atomics, a ring of frames and one exchange, so nothing here
//! waits and nothing is torn; a full queue drops and counts.
//!
//! Time bound: a step that reaches past the following crest is counted, and turns the motors off if they are on
//! ([`Fault::ControlOverrun`]). One that only reaches past the valley applies half a carrier period later than usual,
//! which the current loops are told.

mod exchange;
mod shared;
mod valley;

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicPtr, Ordering};

use cortex_m::peripheral::DWT;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::Dir;
use haptic_bridge::drive::carrier::{Carrier, Ticks};
use haptic_bridge::drive::heat::Heat;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::servo::Rules;
use haptic_bridge::servo::compiled::{self, BoardServo};
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::program::Hardware;

use crate::board::{Board, Io as _, This};
use crate::critical;
use crate::frames::{FrameReader, Frames};

use exchange::Exchange;
pub use exchange::{Request, Requests};
pub use shared::Shared;
use shared::count;

/// The tasks' ends.
pub struct Ends {
    /// Of the requests.
    pub requests: Requests,
    /// Frames of the telemetry stream.
    pub frames: FrameReader,
}

/// The control interrupt's own. In this order in memory: what the FPU loads lies within the 1 KB that its loads reach.
#[repr(C)]
struct Step {
    io: <This as Board>::Io,
    /// Samples of the last crest.
    seen: Samples,
    /// Compare values of the legs.
    legs: [[u16; 2]; MAX_JOINTS],
    ticks: Ticks,
    /// Work at crests before the next control step: the number of crests without a step, and flags that the last step
    /// left, see [`OVERRAN`]. `after_step` is its value right after a step.
    before_step: u32,
    after_step: u32,
    /// The core's cycle count at the last valley.
    valley_at: u32,
    /// Crests for which duties are late yet, and whether those worked out last wait for the valley.
    late: u8,
    pending: bool,
    /// The bridges are connected to the carrier; and, while they are to be, for how many valleys they have not been.
    driving: bool,
    unconnected: u8,
    servo: BoardServo,
}

/// All state of the control interrupt, at one address.
#[repr(C)]
struct Control {
    shared: Shared,
    /// Start-up hands it to the interrupt for good.
    step: UnsafeCell<MaybeUninit<Step>>,
    /// A task's request, until it is answered.
    asked: AtomicPtr<Exchange<'static>>,
    frames: Frames,
}

// SAFETY: `step` is written once by `start` before the interrupt is enabled, and touched by nothing but the interrupt from
// then on.
unsafe impl Sync for Control {}

static CONTROL: Control = Control {
    shared: Shared::new(),
    step: UnsafeCell::new(MaybeUninit::uninit()),
    asked: AtomicPtr::new(core::ptr::null_mut()),
    frames: Frames::new(),
};

/// The numbers that the control interrupt and the tasks share.
pub fn shared() -> &'static Shared {
    &CONTROL.shared
}

/// Gives the board to the control interrupt and starts the carrier; `heat` is what the run before left of it in the
/// motors. Call once.
pub fn start(mut io: <This as Board>::Io, hardware: Hardware, rules: Rules, heat: [Heat; MAX_JOINTS]) -> Ends {
    io.start();
    let mut servo = BoardServo::new(hardware, rules);
    servo.start_heat(heat);
    let step = Step {
        ticks: io.carrier().ticks(),
        servo,
        after_step: after_step(io.carrier()),
        before_step: 0,
        valley_at: DWT::cycle_count(),
        seen: Samples::default(),
        late: 0,
        pending: false,
        legs: [[0; 2]; MAX_JOINTS],
        driving: false,
        unconnected: 0,
        io,
    };
    CONTROL.shared.least_left.store(u32::MAX, Ordering::Relaxed);
    // SAFETY: the interrupt is not enabled yet.
    unsafe { (*CONTROL.step.get()).write(step) };
    interrupt::TIM1_UP_TIM10.set_priority(critical::CONTROL);
    pac::TIM1.sr().write(|w| w.0 = 0);
    pac::TIM1.dier().modify(|w| w.set_uie(true));
    // SAFETY: the state it needs is in place.
    unsafe { interrupt::TIM1_UP_TIM10.enable() };
    Ends { requests: Requests(&CONTROL.asked), frames: FrameReader::new(&CONTROL.frames) }
}

#[interrupt]
fn TIM1_UP_TIM10() {
    pac::TIM1.sr().write(|w| {
        w.0 = !0;
        w.set_uif(false);
    });
    // SAFETY: `start` has written it before it enabled this interrupt, which is its only user since and does not preempt
    // itself.
    let step = unsafe { (*CONTROL.step.get()).assume_init_mut() };
    if past_valley() {
        step.valley();
    } else {
        step.crest();
    }
}

impl Step {
    /// Everything there is to do at a crest.
    #[inline(always)]
    fn crest(&mut self) {
        if self.before_step != 0 && self.crest_before_step() {
            return;
        }
        self.io.follow(&mut self.seen.counts);
        // Right behind the counts that they belong to.
        if self.io.marked() {
            self.mark();
        }
        compiled::render(&mut self.servo, &self.seen.counts);
        if passed_an_extreme() {
            self.see_whether_missed();
        }
        // The converters have worked meanwhile.
        self.sample();
        if self.is_late() {
            self.crest_late();
        } else {
            let drives = compiled::crest(&mut self.servo, &self.seen, &self.ticks, &mut self.legs);
            self.write(drives);
        }
        // Work that is not urgent is left to the valley.
        self.before_step = self.after_step;
        self.keep_time();
    }

    /// Finishes the last step, and does the whole work of a crest without a step. Returns true if this was such a crest.
    #[cold]
    #[inline(never)]
    fn crest_before_step(&mut self) -> bool {
        if self.before_step & UNCONNECTED != 0 {
            self.before_step &= !UNCONNECTED;
            let top = u32::from(self.io.carrier().top);
            if self.may_connect() && pac::TIM1.cnt().read().0 > top.saturating_sub(EXTREME_CYCLES) {
                self.connect();
            }
        }
        if self.before_step & (UNRECORDED | BETWEEN) != 0 {
            self.valley_missed();
        }
        if self.before_step & OVERRAN != 0 {
            if self.driving {
                self.miss();
                self.float();
            } else if self.servo.status().state.drives() {
                self.wait_on();
            }
        }
        self.before_step &= !(OVERRAN | BETWEEN);
        let between = self.before_step > 0;
        if between {
            self.before_step = (self.before_step - 1) | BETWEEN;
            self.crest_between();
        }
        between
    }

    /// Everything there is to do at a crest between two control steps.
    fn crest_between(&mut self) {
        self.io.follow(&mut self.seen.counts);
        self.sample();
        self.seen.late = self.is_late();
        let drives = compiled::crest_generally(&mut self.servo, &self.seen, false, &self.ticks, &mut self.legs);
        if self.seen.late {
            self.write_late(drives);
            self.seen.late = false;
        } else {
            self.write(drives);
        }
        self.keep_time();
    }

    /// Takes what the crest started to sample, and sees that it is well with the power stage.
    #[inline(always)]
    fn sample(&mut self) {
        if !self.io.sampled() {
            self.await_samples();
        }
        self.io.sample(&mut self.seen);
        if self.io.fault() {
            self.trip_driving(This::POWER_FAULT);
        }
    }

    /// Has the legs take their duties, and the bridges drive or not.
    #[inline(always)]
    fn write(&mut self, drives: bool) {
        self.io.write(&self.legs);
        if self.driving && !drives {
            self.float();
        }
    }

    /// The rest of a crest with a control step whose duties are late.
    #[cold]
    #[inline(never)]
    fn crest_late(&mut self) {
        self.seen.late = true;
        let drives = compiled::crest(&mut self.servo, &self.seen, &self.ticks, &mut self.legs);
        self.write_late(drives);
        self.seen.late = false;
        count(&CONTROL.shared.late_steps);
    }

    /// As [`Step::write`] where the duties are late: they wait for the valley, if that is yet to come.
    fn write_late(&mut self, drives: bool) {
        if self.driving && !drives {
            self.float();
        }
        self.pending = !past_valley();
        if !self.pending {
            self.io.write(&self.legs);
        }
    }

    #[cold]
    #[inline(never)]
    fn mark(&mut self) {
        self.servo.mark(self.io.marks(&self.seen.counts));
    }

    /// Returns true if the duties of this crest are late: the next valley is too near for them, or has just passed, or
    /// was too near at one of the last crests.
    #[inline(always)]
    fn is_late(&mut self) -> bool {
        // Core and timer count at the same frequency, and the timer down to its valley and up from it.
        if pac::TIM1.cnt().read().0 < LEGS_CYCLES {
            self.late = LATE_CRESTS;
        } else if self.late > 0 {
            self.late -= 1;
        }
        self.late > 0
    }

    /// Trips because a step overran. Call while the motors are on.
    fn miss(&mut self) {
        let overruns = CONTROL.shared.overruns.load(Ordering::Relaxed).wrapping_add(1);
        self.servo.trip(Fault::ControlOverrun, None, overruns as f32);
    }

    /// This step is past its valley: its duties are late, and what the converters have may belong to the next crest.
    #[cold]
    #[inline(never)]
    fn see_whether_missed(&mut self) {
        self.late = LATE_CRESTS;
        if self.driving && self.outlasts() {
            self.miss();
        }
    }

    /// Waits for the converters, which have not finished yet.
    #[cold]
    #[inline(never)]
    fn await_samples(&mut self) {
        if !self.io.await_samples() {
            self.trip_driving(Fault::SensorStale);
        }
    }

    /// Trips a fault that counts only while the motors are on.
    #[cold]
    #[inline(never)]
    fn trip_driving(&mut self, fault: Fault) {
        if self.driving {
            self.servo.trip(fault, None, 0.0);
        }
    }

    /// The bridges should drive but cannot yet, because this interrupt was late. If it always is, this counts as missed
    /// steps instead of waiting forever.
    fn wait_on(&mut self) {
        self.unconnected = self.unconnected.saturating_add(1);
        if self.unconnected > LATE_CRESTS {
            self.miss();
        }
    }

    /// Returns true if the bridges are to drive, and can.
    fn may_connect(&self) -> bool {
        self.servo.status().state.drives() && CONTROL.shared.gate_ready.load(Ordering::Relaxed)
    }

    /// Connects the bridges to the carrier.
    fn connect(&mut self) {
        self.io.drive(true);
        self.driving = true;
        // The duration of steps while they floated does not matter.
        self.before_step &= !OVERRAN;
    }

    /// Lets bridges that drive float, and drops the gate drivers as well.
    #[cold]
    #[inline(never)]
    fn float(&mut self) {
        self.io.drive(false);
        CONTROL.shared.gate_ready.store(false, Ordering::Relaxed);
        self.driving = false;
    }

    /// Sees to crests that took the longest so far, or reached past the valley.
    #[inline(always)]
    fn keep_time(&mut self) {
        if passed_an_extreme() || pac::TIM1.cnt().read().0 < CONTROL.shared.least_left.load(Ordering::Relaxed) {
            self.note_time();
        }
    }

    /// Notes how long this crest takes, that duties came too late where it is past the valley, and counts it where it is
    /// past the next crest.
    #[cold]
    #[inline(never)]
    fn note_time(&mut self) {
        if passed_an_extreme() {
            self.late = LATE_CRESTS;
        }
        let Shared { stall_expected, longest_cycles, least_left, overruns, .. } = &CONTROL.shared;
        if stall_expected.load(Ordering::Relaxed) {
            return;
        }
        let top = u32::from(self.io.carrier().top);
        let cycles = self.since_valley().saturating_sub(top);
        if cycles > longest_cycles.load(Ordering::Relaxed) {
            longest_cycles.store(cycles, Ordering::Relaxed);
            least_left.store(top.saturating_sub(cycles), Ordering::Relaxed);
        }
        if passed_an_extreme() && self.outlasts() {
            self.before_step |= OVERRAN;
            count(overruns);
        }
    }

    /// Core cycles since the last valley. Core and timer count at the same frequency.
    fn since_valley(&self) -> u32 {
        DWT::cycle_count().wrapping_sub(self.valley_at)
    }

    /// Returns true if what is past its valley is past the next crest, too.
    fn outlasts(&self) -> bool {
        !past_valley() || self.since_valley() > 3 * u32::from(self.io.carrier().top)
    }
}

/// Flags that a crest leaves, above its count of crests without a step: the last crest had no step; the bridges should
/// drive and do not yet; its step overran; its step is not recorded yet.
const BETWEEN: u32 = 1 << 28;
const UNCONNECTED: u32 = 1 << 29;
const OVERRAN: u32 = 1 << 30;
const UNRECORDED: u32 = 1 << 31;

/// The work that is due right after a step.
fn after_step(carrier: &Carrier) -> u32 {
    UNRECORDED | (u32::from(carrier.divider) - 1)
}

/// Crests for which duties stay late after a step that came too late for its valley: a duty in time before a late one
/// acts for half a carrier period too long, and where some steps are late, most will be.
const LATE_CRESTS: u8 = 64;

/// Core cycles from here until duties are written: limits, torques and current loops of two motors take up to 350
/// instructions where something is unusual, those of three 460, at up to 2.4 cycles each.
const LEGS_CYCLES: u32 = 288 * (This::AXES as u32 + 1);

/// Core cycles after a crest or a valley, 1.5 us, up to which the bridges may begin to drive: twice what the interrupt is
/// estimated to take to get there (emulator/src/cycles.rs, with a cold flash). Each microsecond is worth 0.24 A to a motor
/// of 0.1 mH at 24 V.
const EXTREME_CYCLES: u32 = 252;

/// Returns true if the carrier has passed a crest or a valley since this interrupt began.
#[inline(always)]
fn passed_an_extreme() -> bool {
    pac::TIM1.sr().read().uif()
}

/// Returns true if the carrier has passed its valley since the crest.
#[inline(always)]
fn past_valley() -> bool {
    pac::TIM1.cr1().read().dir() == Dir::UP
}
