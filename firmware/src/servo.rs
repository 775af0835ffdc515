//! The control interrupt: at the crest of the carrier it samples, steps and writes the duties that apply at the next
//! valley.
//!
//! It runs at every update of TIM1, crests and valleys. At a valley it sums up what takes long to do harm, and takes at
//! most one request from the tasks, so that neither lengthens a step. At every crest it holds what it sees to the limits and runs the current
//! loops; at every k-th crest (k = [`Carrier::divider`]) it runs the library's control step. Everything it shares with tasks is an atomic or a
//! single-producer single-consumer queue, so nothing here waits and nothing is torn; a full queue drops and counts.
//!
//! Time bound: a step that reaches past the following crest is counted, and turns the motors off if they are on
//! ([`Fault::ControlOverrun`]). One that only reaches past the valley applies half a carrier period later than usual,
//! which the current loops are told.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering};

use cortex_m::peripheral::DWT;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::Dir;
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::drive::heat::Heat;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::servo::compiled::{self, BoardProgram, BoardServo};
use haptic_bridge::servo::frame::{Samples, StepRecord};
use haptic_bridge::servo::host_force::{ForceAnswer, ForceRequest};
use haptic_bridge::servo::program::Hardware;
use haptic_bridge::servo::{Command, Reply, Rules, Status};
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::StaticCell;

use crate::board::{Board, Io as _, This};
use crate::critical;
use crate::warmth;

/// What tasks ask of the control interrupt, one at a time.
pub enum Request {
    /// Something for the servo.
    Command(Command<BoardProgram>),
    /// Only the status.
    Status,
    /// What the host asks the motors for.
    Force(ForceRequest),
    /// Another carrier; motors off.
    Retime(Carrier),
}

/// What came of it.
pub struct Answer {
    /// Of a command.
    pub reply: Reply<BoardProgram>,
    /// The servo's state after it.
    pub status: Status,
    /// Of a [`Request::Force`].
    pub force: Option<ForceAnswer>,
}

/// Most requests and answers under way.
const REQUESTS: usize = 2;

/// Frames of telemetry on their way to the link: 5 ms at 20 kHz.
const FRAMES: usize = 100;

/// The tasks' ends of the queues.
pub struct ServoQueues {
    /// Requests to the control interrupt.
    pub requests: Producer<'static, Request>,
    /// Its answers, one each.
    pub answers: Consumer<'static, Answer>,
    /// Frames of the telemetry stream.
    pub frames: Consumer<'static, StepRecord>,
}

/// Control steps since the start, wrapping.
pub static STEPS: AtomicU32 = AtomicU32::new(0);
/// Every how many control steps a frame is wanted; 0 for none.
pub static STREAM_DIVIDER: AtomicU32 = AtomicU32::new(0);
/// Frames that found the queue full since the stream started.
pub static FRAMES_DROPPED: AtomicU32 = AtomicU32::new(0);
/// Steps that reached past the next crest.
pub static OVERRUNS: AtomicU32 = AtomicU32::new(0);
/// The share of steps whose duties apply half a carrier period later than usual, over some [`LATE_WINDOW`] steps, in
/// parts of [`WHOLE`].
pub static LATE_SHARE: AtomicI32 = AtomicI32::new(0);
/// All of it.
pub const WHOLE: i32 = 1 << 24;
/// Steps over which that share is taken: a fifth of a second at 20 kHz.
const LATE_WINDOW: i32 = 4096;
/// Longest run of the interrupt at a crest, core cycles.
pub static LONGEST_CYCLES: AtomicU32 = AtomicU32::new(0);
/// The gate drivers are up and set: the bridges may be connected, and while they are not, no current flows.
pub static GATE_READY: AtomicBool = AtomicBool::new(false);
/// A flash operation is about to stall the program: missed crests are no overruns.
pub static STALL_EXPECTED: AtomicBool = AtomicBool::new(false);

/// In this order in memory: what the FPU loads lies within the 1 KB that its loads reach.
#[repr(C)]
struct Step {
    io: <This as Board>::Io,
    /// What was sampled at the last crest.
    seen: Samples,
    legs: [[u16; 2]; MAX_JOINTS],
    /// Crests until the next control step.
    countdown: u16,
    /// Crests for which duties are late yet, and whether those worked out last wait for the valley.
    late: u8,
    pending: bool,
    /// The bridges are connected to the carrier.
    driving: bool,
    /// The last step overran.
    overrun: bool,
    servo: BoardServo,
    requests: Consumer<'static, Request>,
    answers: Producer<'static, Answer>,
    frames: Producer<'static, StepRecord>,
}

/// A value that start-up hands to the control interrupt for good.
struct Owned<T>(UnsafeCell<Option<T>>);

// SAFETY: written once by `start` before the interrupt is enabled, and touched by nothing but the interrupt from then
// on.
unsafe impl<T> Sync for Owned<T> {}

static STEP: Owned<Step> = Owned(UnsafeCell::new(None));

/// Gives the board to the control interrupt and starts the carrier; `heat` is what the run before left of it in the
/// motors. Call once.
pub fn start(mut io: <This as Board>::Io, hardware: Hardware, rules: Rules, heat: [Heat; MAX_JOINTS]) -> ServoQueues {
    static REQUEST_QUEUE: StaticCell<Queue<Request, REQUESTS>> = StaticCell::new();
    static ANSWER_QUEUE: StaticCell<Queue<Answer, REQUESTS>> = StaticCell::new();
    static FRAME_QUEUE: StaticCell<Queue<StepRecord, FRAMES>> = StaticCell::new();
    let (to_servo, requests) = REQUEST_QUEUE.init(Queue::new()).split();
    let (answers, from_servo) = ANSWER_QUEUE.init(Queue::new()).split();
    let (frames, from_steps) = FRAME_QUEUE.init(Queue::new()).split();

    io.start();
    let mut servo = BoardServo::new(hardware, rules);
    servo.start_heat(heat);
    let step = Step {
        io,
        servo,
        requests,
        answers,
        frames,
        countdown: 1,
        seen: Samples::default(),
        late: 0,
        pending: false,
        legs: [[0; 2]; MAX_JOINTS],
        driving: false,
        overrun: false,
    };
    // SAFETY: the interrupt is not enabled yet.
    unsafe { *STEP.0.get() = Some(step) };
    interrupt::TIM1_UP_TIM10.set_priority(critical::CONTROL);
    pac::TIM1.sr().write(|w| w.0 = 0);
    pac::TIM1.dier().modify(|w| w.set_uie(true));
    // SAFETY: the state it needs is in place.
    unsafe { interrupt::TIM1_UP_TIM10.enable() };
    ServoQueues { requests: to_servo, answers: from_servo, frames: from_steps }
}

#[interrupt]
fn TIM1_UP_TIM10() {
    let began = DWT::cycle_count();
    pac::TIM1.sr().write(|w| {
        w.0 = !0;
        w.set_uif(false);
    });
    let valley = past_valley();
    // SAFETY: this interrupt is the only user since `start` enabled it, and it does not preempt itself.
    let Some(step) = (unsafe { (*STEP.0.get()).as_mut() }) else { return };
    if valley {
        step.io.forget();
        // The duties of the last step have just been taken over, or are late and come next.
        if core::mem::take(&mut step.pending) {
            step.io.write(&step.legs);
        }
        if !compiled::sum_up(&mut step.servo, &step.seen).bridges {
            step.connect(false);
        }
        if let Some(request) = step.requests.dequeue() {
            step.take(request);
        }
    } else {
        step.crest(began);
        step.keep_time(DWT::cycle_count().wrapping_sub(began));
    }
}

impl Step {
    /// Everything there is to do at a crest, whose interrupt `began` at that cycle.
    #[inline(always)]
    fn crest(&mut self, began: u32) {
        self.seen.counts = self.io.counts();
        self.countdown -= 1;
        let steps = self.countdown == 0;
        // Of no interest while the motors are off.
        let mut overran = core::mem::take(&mut self.overrun) && self.driving;
        if steps {
            // Right behind the counts that they belong to.
            self.seen.index = self.io.index();
        }
        if steps && !overran {
            compiled::render(&mut self.servo, &self.seen.counts);
            // What the converters have by now may belong to the next crest.
            overran = self.driving && self.outlasted(DWT::cycle_count().wrapping_sub(began));
        }
        if overran {
            self.servo.trip(Fault::ControlOverrun, None, OVERRUNS.load(Ordering::Relaxed).wrapping_add(1) as f32);
        }
        // The converters have worked meanwhile.
        let fresh = self.io.analog(&mut self.seen);
        if let Some((fault, axis, value)) = self.hardware_fault(fresh) {
            self.servo.trip(fault, axis, value);
        }
        let outputs = compiled::judge(&mut self.servo, &self.seen, steps);
        if steps {
            self.countdown = self.io.carrier().divider;
        }
        // At every crest: current loops that ran while their bridges float would wind up.
        self.connect(outputs.bridges);
        self.late = if too_late() { LATE_CRESTS } else { self.late.saturating_sub(1) };
        let late = self.late > 0;
        compiled::legs(&mut self.servo, &self.seen, late, self.io.carrier(), &mut self.legs);
        self.pending = late && !past_valley();
        if !self.pending {
            self.io.write(&self.legs);
        }
        if !late && past_valley() {
            // The duties took longer than they were given, and come too late after all.
            self.late = LATE_CRESTS;
        }
        // What the motors do not wait for.
        if steps {
            let share = LATE_SHARE.load(Ordering::Relaxed);
            let now = if self.late > 0 { WHOLE } else { 0 };
            LATE_SHARE.store(share + (now - share) / LATE_WINDOW, Ordering::Relaxed);
            self.record();
            STEPS.store(self.servo.steps(), Ordering::Relaxed);
        }
    }

    /// Carries out one request and answers it. Not inlined: it is rare, and would only lengthen the way to the step.
    /// The queue of answers has room: there is one answer to a request, and one request at a time.
    #[inline(never)]
    fn take(&mut self, request: Request) {
        let mut force = None;
        let reply = match request {
            Request::Command(command) => self.servo.execute(command),
            Request::Status => (Ok(()), None),
            Request::Force(request) => {
                force = Some(self.servo.force(&request));
                (Ok(()), None)
            }
            Request::Retime(carrier) => {
                if !self.driving {
                    self.io.set_carrier(carrier);
                    self.countdown = 1;
                }
                (Ok(()), None)
            }
        };
        // A few times a second, what a reset must not cool is put where it stays.
        warmth::keep(self.servo.heat());
        let status = self.servo.status();
        if !status.state.drives() {
            self.connect(false);
        }
        let _ = self.answers.enqueue(Answer { reply, status, force });
    }

    /// Connects the bridges or lets them float. Floating drops the gate drivers as well; connecting needs them ready.
    #[inline(always)]
    fn connect(&mut self, on: bool) {
        match (on, self.driving) {
            (true, false) if GATE_READY.load(Ordering::Relaxed) => {
                self.io.drive(true);
                self.driving = true;
            }
            (false, true) => {
                self.io.drive(false);
                GATE_READY.store(false, Ordering::Relaxed);
                self.driving = false;
            }
            _ => {}
        }
    }

    /// What hardware or time say is wrong; only of interest while the motors are on.
    #[inline(always)]
    fn hardware_fault(&mut self, fresh: bool) -> Option<(Fault, Option<u8>, f32)> {
        if !self.driving {
            return None;
        }
        if !fresh {
            return Some((Fault::SensorStale, None, 0.0));
        }
        self.io.fault().map(|fault| (fault, None, 0.0))
    }

    #[inline(always)]
    fn record(&mut self) {
        let wanted = self.servo.steps().checked_rem(STREAM_DIVIDER.load(Ordering::Relaxed)) == Some(0);
        if wanted && !compiled::record(&self.servo, &mut self.frames) {
            // This interrupt is the only writer while a stream runs.
            FRAMES_DROPPED.store(FRAMES_DROPPED.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
    }

    /// Counts runs that took too long: past the next crest.
    #[inline(always)]
    fn keep_time(&mut self, cycles: u32) {
        if STALL_EXPECTED.load(Ordering::Relaxed) {
            return;
        }
        if cycles > LONGEST_CYCLES.load(Ordering::Relaxed) {
            LONGEST_CYCLES.store(cycles, Ordering::Relaxed);
        }
        if self.outlasted(cycles) {
            self.overrun = true;
            OVERRUNS.store(OVERRUNS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
    }

    /// Whether a run of so many core cycles reaches past the crest after the one where it began.
    #[inline(always)]
    fn outlasted(&self, cycles: u32) -> bool {
        let crest_passed = pac::TIM1.sr().read().uif() && !past_valley();
        // Core and timer count at the same frequency.
        crest_passed || cycles > 2 * u32::from(self.io.carrier().top)
    }
}

/// Crests for which duties stay late after a step that came too late for its valley: a duty in time before a late one
/// acts for half a carrier period too long, and where some steps are late, most will be.
const LATE_CRESTS: u8 = 64;

/// Core cycles from here until duties are written: the current loops of two motors take some 230 instructions, those of
/// three 310 (docs/results/timing.md), at up to 2.4 cycles each.
const LEGS_CYCLES: u16 = 192 * (This::AXES as u16 + 1);

/// Whether the carrier has passed its valley since the crest.
fn past_valley() -> bool {
    pac::TIM1.cr1().read().dir() == Dir::UP
}

/// Whether the next valley is too near, or past, for duties worked out now to apply from it on.
fn too_late() -> bool {
    // Core and timer count at the same frequency, and the timer down to its valley.
    past_valley() || pac::TIM1.cnt().read().cnt() < LEGS_CYCLES
}
