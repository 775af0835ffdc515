//! The servo as the board runs it: in its precision, with its trigonometry, and compiled once, here.
//!
//! The firmware's image is built for size, but this crate for speed; what is generic would be compiled where it is
//! used. These functions are what the control interrupt calls, and the only ones of the servo whose time counts.

use crate::drive::carrier::Carrier;
use crate::math::Minimax;
use crate::model::catalogue::MAX_JOINTS;
use crate::servo::frame::{Outputs, Samples, StepRecord};
use crate::servo::joints::Counts;
use crate::servo::program::Program;
use crate::servo::{Servo, for_joints};
use heapless::spsc::Producer;

/// The trigonometry that the board computes with.
pub type BoardMath = Minimax;

/// How the board holds a program: by the buffer it lies in, so handing it over moves a pointer.
pub type BoardProgram = &'static mut Program<BoardMath>;

/// The board's servo.
pub type BoardServo = Servo<BoardProgram>;

/// The part of a control period that needs only counts, see [`Servo::render`].
#[inline(never)]
pub fn render(servo: &mut BoardServo, counts: &Counts) {
    servo.render(counts);
}

/// What every crest is held to and, where a control step is due, the rest of that: see [`Servo::guard`] and
/// [`Servo::act`].
#[inline(never)]
pub fn judge(servo: &mut BoardServo, seen: &Samples, due: bool) -> Outputs {
    for_joints!(servo.joints(), J => {
        let outputs = servo.guard_of::<J>(seen);
        if due { servo.act_of::<J>(seen) } else { outputs }
    })
}

/// What builds up, at the valley, see [`Servo::sum_up`].
#[inline(never)]
pub fn sum_up(servo: &mut BoardServo, seen: &Samples) -> Outputs {
    servo.sum_up(seen)
}

/// Compare values for the legs of every bridge over the next carrier period, see [`Servo::duties`] and
/// [`Carrier::legs`].
#[inline(never)]
pub fn legs(servo: &mut BoardServo, seen: &Samples, late: bool, carrier: &Carrier, legs: &mut [[u16; 2]; MAX_JOINTS]) {
    for_joints!(servo.joints(), J => *legs = legs_of::<J>(servo, seen, late, carrier));
}

/// [`legs`] of J joints: what has none stays at the middle.
#[inline(always)]
fn legs_of<const J: usize>(
    servo: &mut BoardServo,
    seen: &Samples,
    late: bool,
    carrier: &Carrier,
) -> [[u16; 2]; MAX_JOINTS] {
    let duties = servo.duties_of::<J>(seen.bus_voltage, &seen.currents, late);
    core::array::from_fn(|axis| carrier.legs(if axis < J { duties[axis] } else { 0.0 }))
}

/// Puts the last step's frame into the queue; false when it is full.
#[inline(never)]
pub fn record(servo: &BoardServo, frames: &mut Producer<'static, StepRecord>) -> bool {
    // A full queue is known before anything is copied.
    frames.ready() && frames.enqueue(servo.frame()).is_ok()
}
