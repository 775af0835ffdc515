//! The control interrupt, which samples at a crest of the carrier, runs the control step and writes the next duties.
//!
//! The interrupt runs at every update of TIM1: at crests and valleys. Every crest checks the limits and runs the
//! current loops; every k-th crest (k = [`Carrier::divider`]) also runs the library's control step. A valley records
//! the last step, checks for slow faults and carries out at most one request of the tasks, so that this work does not
//! lengthen a step. The interrupt shares atomics, a ring of frames and one exchange with the tasks, and never waits for
//! a task. A full ring drops the frame and counts it.
//!
//! Time bound: a step that lasts past the next crest is counted, and turns the motors off if they are on
//! ([`Fault::ControlOverrun`]). The duties of a step that lasts past the valley apply half a carrier period late, which
//! the current loops take into account.

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
use haptic_bridge::control::Rules;
use haptic_bridge::control::compiled::{self, BoardControlLoop, Legs};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::program::Hardware;
use haptic_bridge::drive::carrier::{Carrier, Ticks};
use haptic_bridge::drive::heat::Heat;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;

use crate::board::{Board, Io as _, This};
use crate::critical;
use crate::frames::{FrameReader, Frames};

use exchange::Exchange;
pub use exchange::{Request, Requests};
pub use shared::Shared;
use shared::increment;

/// The tasks' ends of the channels to the control interrupt.
pub struct TaskChannels {
    pub requests: Requests,
    pub frames: FrameReader,
}

/// The state that the control interrupt owns. The field order keeps every float within the 1 KB reach of FPU loads.
#[repr(C)]
struct InterruptState {
    io: <This as Board>::Io,
    samples: Samples,
    legs: Legs,
    ticks: Ticks,
    /// Number of crests before the next control step, with flags for unfinished work of the last step, see [`OVERRAN`].
    step_countdown: u32,
    /// Value of `step_countdown` at the end of a step.
    initial_countdown: u32,
    /// Cycle count of the core at the last valley.
    cycles_at_valley: u32,
    /// Number of crests until duties no longer count as late.
    late_crests: u8,
    /// True if late duties wait for the valley.
    duties_pending: bool,
    /// True while the bridges are connected to the carrier.
    is_driving: bool,
    /// Number of crests and valleys at which the interrupt was too late to connect the bridges.
    missed_connections: u8,
    control_loop: BoardControlLoop,
}

/// All state of the control interrupt, at one address.
#[repr(C)]
struct Control {
    shared: Shared,
    /// Owned by the interrupt after `start` has written it.
    state: UnsafeCell<MaybeUninit<InterruptState>>,
    /// Request of a task that has no reply yet.
    request: AtomicPtr<Exchange<'static>>,
    frames: Frames,
}

// SAFETY: `start` writes `state` once, before it enables the interrupt. Afterwards only the interrupt uses it.
unsafe impl Sync for Control {}

static CONTROL: Control = Control {
    shared: Shared::new(),
    state: UnsafeCell::new(MaybeUninit::uninit()),
    request: AtomicPtr::new(core::ptr::null_mut()),
    frames: Frames::new(),
};

/// Returns the numbers that the control interrupt and the tasks share.
pub fn shared() -> &'static Shared {
    &CONTROL.shared
}

/// Passes the board to the control interrupt and starts the carrier. `heat` is from the end of the previous run. Call
/// once.
pub fn start(mut io: <This as Board>::Io, hardware: Hardware, rules: Rules, heat: [Heat; MAX_JOINTS]) -> TaskChannels {
    io.start();
    let mut control_loop = BoardControlLoop::new(hardware, rules);
    control_loop.start_heat(heat);
    let state = InterruptState {
        ticks: io.carrier().ticks(),
        control_loop,
        initial_countdown: initial_countdown(io.carrier()),
        step_countdown: 0,
        cycles_at_valley: DWT::cycle_count(),
        samples: Samples::default(),
        late_crests: 0,
        duties_pending: false,
        legs: Legs::default(),
        is_driving: false,
        missed_connections: 0,
        io,
    };
    CONTROL.shared.least_margin.store(u32::MAX, Ordering::Relaxed);
    // SAFETY: the interrupt is not enabled yet.
    unsafe { (*CONTROL.state.get()).write(state) };
    interrupt::TIM1_UP_TIM10.set_priority(critical::CONTROL);
    pac::TIM1.sr().write(|w| w.0 = 0);
    pac::TIM1.dier().modify(|w| w.set_uie(true));
    // SAFETY: the state that the interrupt needs is written.
    unsafe { interrupt::TIM1_UP_TIM10.enable() };
    TaskChannels { requests: Requests(&CONTROL.request), frames: FrameReader::new(&CONTROL.frames) }
}

#[interrupt]
fn TIM1_UP_TIM10() {
    pac::TIM1.sr().write(|w| {
        w.0 = !0;
        w.set_uif(false);
    });
    // SAFETY: `start` wrote the state before it enabled this interrupt. Only the interrupt uses the state, without
    // nesting.
    let state = unsafe { (*CONTROL.state.get()).assume_init_mut() };
    if is_past_valley() {
        state.valley();
    } else {
        state.crest();
    }
}

impl InterruptState {
    #[inline(always)]
    fn crest(&mut self) {
        if self.step_countdown != 0 && self.crest_before_step() {
            return;
        }
        self.io.update_counts(&mut self.samples.counts);
        // Read directly after the counts, because an index mark belongs to the counts.
        if self.io.has_marks() {
            self.record_index_pulses();
        }
        compiled::render(&mut self.control_loop, &self.samples.counts);
        if has_passed_an_extreme() {
            self.check_missed_crest();
        }
        // The conversions have finished while the scene was rendered.
        self.sample();
        if self.is_late() {
            self.crest_late();
        } else {
            let drives = compiled::crest(&mut self.control_loop, &mut self.samples, &self.ticks, &mut self.legs);
            self.write(drives);
        }
        // The valley does the work that is not urgent.
        self.step_countdown = self.initial_countdown;
        self.record_long_crest();
    }

    /// Finishes the last step. At a crest without a step, does all of the crest's work and returns true.
    #[cold]
    #[inline(never)]
    fn crest_before_step(&mut self) -> bool {
        if self.step_countdown & UNCONNECTED != 0 {
            self.step_countdown &= !UNCONNECTED;
            let top = u32::from(self.io.carrier().top);
            if self.may_connect() && pac::TIM1.cnt().read().0 > top.saturating_sub(EXTREME_CYCLES) {
                self.connect();
            }
        }
        if self.step_countdown & ABSOLUTE != 0 {
            self.read_angles();
        }
        if self.step_countdown & (UNRECORDED | NO_STEP) != 0 {
            self.valley_missed();
        }
        if self.step_countdown & OVERRAN != 0 {
            if self.is_driving {
                self.trip_overrun();
                self.float_bridges();
            } else if self.control_loop.status().state.drives() {
                self.count_missed_connection();
            }
        }
        self.step_countdown &= !(OVERRAN | NO_STEP);
        let between = self.step_countdown & !ABSOLUTE > 0;
        if between {
            self.step_countdown = (self.step_countdown - 1) | NO_STEP;
            self.crest_between_steps();
        }
        between
    }

    /// Reads the absolute encoders, and shows their counts in the timers.
    fn read_angles(&mut self) {
        if let Some(sensors) = self.io.angle_sensors() {
            let frames = sensors.frames();
            compiled::read_angles(&mut self.control_loop, &frames, &mut self.samples.counts);
            sensors.show(&self.samples.counts);
        }
    }

    /// Uses the absolute encoders of the loaded device, or none.
    fn connect_angle_sensors(&mut self) {
        let axes = self.control_loop.absolute_axes();
        if let Some(sensors) = self.io.angle_sensors() {
            sensors.connect(axes);
            for countdown in [&mut self.initial_countdown, &mut self.step_countdown] {
                *countdown = *countdown & !ABSOLUTE | if axes.contains(&true) { ABSOLUTE } else { 0 };
            }
        }
    }

    /// Does the work of a crest between two control steps.
    fn crest_between_steps(&mut self) {
        self.io.update_counts(&mut self.samples.counts);
        self.sample();
        self.samples.late = self.is_late();
        let drives =
            compiled::crest_of_any_kind(&mut self.control_loop, &mut self.samples, false, &self.ticks, &mut self.legs);
        if self.samples.late {
            self.write_late(drives);
            self.samples.late = false;
        } else {
            self.write(drives);
        }
        self.record_long_crest();
    }

    /// Reads the conversions that the crest started, and checks the power stage for a fault.
    #[inline(always)]
    fn sample(&mut self) {
        if !self.io.has_sampled() {
            self.await_samples();
        }
        self.io.sample(&mut self.samples);
        if self.io.has_fault() {
            self.trip_driving(This::POWER_FAULT);
        }
    }

    /// Writes the duties of the legs, and lets the bridges float unless `drives`.
    #[inline(always)]
    fn write(&mut self, drives: bool) {
        self.io.write(&self.legs);
        if self.is_driving && !drives {
            self.float_bridges();
        }
    }

    /// Finishes a crest with a control step whose duties are late.
    #[cold]
    #[inline(never)]
    fn crest_late(&mut self) {
        self.samples.late = true;
        let drives = compiled::crest(&mut self.control_loop, &mut self.samples, &self.ticks, &mut self.legs);
        self.write_late(drives);
        self.samples.late = false;
        increment(&CONTROL.shared.late_steps);
    }

    /// Writes late duties as [`InterruptState::write`] does. The duties wait for the valley if it is still ahead.
    fn write_late(&mut self, drives: bool) {
        if self.is_driving && !drives {
            self.float_bridges();
        }
        self.duties_pending = !is_past_valley();
        if !self.duties_pending {
            self.io.write(&self.legs);
        }
    }

    #[cold]
    #[inline(never)]
    fn record_index_pulses(&mut self) {
        self.control_loop.mark(self.io.marks(&self.samples.counts));
    }

    /// Returns true if the duties of this crest are late, because the valley came too soon at one of the last
    /// [`LATE_CRESTS`] crests.
    #[inline(always)]
    fn is_late(&mut self) -> bool {
        // Core and timer count at the same frequency. The timer counts down to its valley and then up.
        if pac::TIM1.cnt().read().0 < LEGS_CYCLES {
            self.late_crests = LATE_CRESTS;
        } else if self.late_crests > 0 {
            self.late_crests -= 1;
        }
        self.late_crests > 0
    }

    /// Trips [`Fault::ControlOverrun`]. Call while the motors are on.
    fn trip_overrun(&mut self) {
        let overruns = CONTROL.shared.overruns.load(Ordering::Relaxed).wrapping_add(1);
        self.control_loop.trip(Fault::ControlOverrun, None, overruns as f32);
    }

    /// Handles a step that lasted past its valley, so that its duties are late. If it also lasted past the next crest,
    /// the conversions may belong to that crest, and the motors go off.
    #[cold]
    #[inline(never)]
    fn check_missed_crest(&mut self) {
        self.late_crests = LATE_CRESTS;
        if self.is_driving && self.outlasts_crest() {
            self.trip_overrun();
        }
    }

    /// Waits for conversions that have not finished yet.
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
        if self.is_driving {
            self.control_loop.trip(fault, None, 0.0);
        }
    }

    /// Counts a crest or valley at which the interrupt was too late to connect the bridges. Trips a fault after
    /// [`LATE_CRESTS`], so that arming does not wait forever.
    fn count_missed_connection(&mut self) {
        self.missed_connections = self.missed_connections.saturating_add(1);
        if self.missed_connections > LATE_CRESTS {
            self.trip_overrun();
        }
    }

    /// Returns true if the bridges should drive and the gate drivers are ready.
    fn may_connect(&self) -> bool {
        self.control_loop.status().state.drives() && CONTROL.shared.gate_ready.load(Ordering::Relaxed)
    }

    fn connect(&mut self) {
        self.io.drive(true);
        self.is_driving = true;
        // An overrun while the bridges floated has no effect.
        self.step_countdown &= !OVERRAN;
    }

    /// Lets driving bridges float, and disables the gate drivers.
    #[cold]
    #[inline(never)]
    fn float_bridges(&mut self) {
        self.io.drive(false);
        CONTROL.shared.gate_ready.store(false, Ordering::Relaxed);
        self.is_driving = false;
    }

    /// Records the duration of a crest that is the longest so far or lasted past the valley.
    #[inline(always)]
    fn record_long_crest(&mut self) {
        if has_passed_an_extreme() || pac::TIM1.cnt().read().0 < CONTROL.shared.least_margin.load(Ordering::Relaxed) {
            self.record_time();
        }
    }

    /// Records the duration of this crest's work. If the work lasts past the valley, the duties of the next crests
    /// count as late. If the work lasts past the next crest, an overrun is counted.
    #[cold]
    #[inline(never)]
    fn record_time(&mut self) {
        if has_passed_an_extreme() {
            self.late_crests = LATE_CRESTS;
        }
        let Shared { stall_expected, longest_cycles, least_margin, overruns, .. } = &CONTROL.shared;
        if stall_expected.load(Ordering::Relaxed) {
            return;
        }
        let top = u32::from(self.io.carrier().top);
        let cycles = self.cycles_since_valley().saturating_sub(top);
        if cycles > longest_cycles.load(Ordering::Relaxed) {
            longest_cycles.store(cycles, Ordering::Relaxed);
            least_margin.store(top.saturating_sub(cycles), Ordering::Relaxed);
        }
        if has_passed_an_extreme() && self.outlasts_crest() {
            self.step_countdown |= OVERRAN;
            increment(overruns);
        }
    }

    /// Returns the core cycles since the last valley. Core and timer count at the same frequency.
    fn cycles_since_valley(&self) -> u32 {
        DWT::cycle_count().wrapping_sub(self.cycles_at_valley)
    }

    /// Returns true if the interrupt lasted past the crest after its valley.
    fn outlasts_crest(&self) -> bool {
        !is_past_valley() || self.cycles_since_valley() > 3 * u32::from(self.io.carrier().top)
    }
}

/// Flag in `step_countdown`: the device has absolute encoders.
const ABSOLUTE: u32 = 1 << 27;
/// Flag: the last crest had no step.
const NO_STEP: u32 = 1 << 28;
/// Flag: the bridges should drive and are not connected yet.
const UNCONNECTED: u32 = 1 << 29;
/// Flag: the last step overran.
const OVERRAN: u32 = 1 << 30;
/// Flag: the last step is not recorded yet.
const UNRECORDED: u32 = 1 << 31;

/// Returns the value of `step_countdown` at the end of a step.
fn initial_countdown(carrier: &Carrier) -> u32 {
    UNRECORDED | (u32::from(carrier.divider) - 1)
}

/// Number of crests for which duties stay late after a step that missed its valley. A duty in time before a late duty
/// would act for half a carrier period too long.
const LATE_CRESTS: u8 = 64;
/// Core cycles from the lateness check to the write of the duties. Limits, torques and current loops take at most 350
/// instructions for two motors and 460 for three, at up to 2.4 cycles each.
const LEGS_CYCLES: u32 = 288 * (This::AXES as u32 + 1);
/// Core cycles after a crest or a valley within which the bridges may be connected, 1.5 us. This is twice the estimate
/// of the interrupt's time to that point (emulator/src/cycles.rs, with a cold flash). A microsecond adds 0.24 A at 0.1
/// mH and 24 V.
const EXTREME_CYCLES: u32 = 252;

/// Returns true if the carrier has passed a crest or a valley since this interrupt began.
#[inline(always)]
fn has_passed_an_extreme() -> bool {
    pac::TIM1.sr().read().uif()
}

/// Returns true if the carrier has passed its valley since the crest.
#[inline(always)]
fn is_past_valley() -> bool {
    pac::TIM1.cr1().read().dir() == Dir::UP
}
