//! The control loop as the board runs it, compiled once in this module with the board's precision and trigonometry.
//!
//! The firmware's image is optimized for size and this crate for speed, but generic code is compiled in the crate that
//! uses it. The control interrupt therefore calls only functions of this module.

use crate::control::ControlLoop;
use crate::control::crest::PHASES_PASS;
use crate::control::frame::{Outputs, Samples, StepRecord};
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::carrier::{LegTicks, Ticks};
use crate::math::Tabulated;
use crate::model::catalogue::MAX_JOINTS;
use core::mem::MaybeUninit;

/// The board's trigonometry.
pub type BoardMath = Tabulated;
/// The board's handle to a program: a reference to its buffer, so that a program is handed over without a copy.
pub type BoardProgram = &'static mut Program<BoardMath>;
/// Compare values of each bridge's legs. A brushed motor is on the first two.
pub type Legs = [LegTicks; MAX_JOINTS];
/// The control loop of the board.
pub type BoardControlLoop = ControlLoop<BoardProgram>;

/// Computes the scene's joint torques, see [`ControlLoop::render`].
#[inline(never)]
pub fn render(control_loop: &mut BoardControlLoop, counts: &Counts) {
    control_loop.render(counts);
}

/// Replaces the counts of absolute encoders by those of their frames, see [`ControlLoop::read_angles`].
#[cold]
#[inline(never)]
pub fn read_angles(control_loop: &mut BoardControlLoop, frames: &[Option<u16>; MAX_JOINTS], counts: &mut Counts) {
    control_loop.read_angles(frames, counts);
}

/// Finishes a crest with a control step after [`render`]: checks the limits, finishes the step and writes the compare
/// values of every bridge's legs for the next carrier period. Returns true if the bridges may drive. Replaces the
/// currents of three-phase motors in `seen` by their torque currents.
///
/// `seen` holds a value for every sensor. A board that lacks a sensor fills in commanded values.
#[inline(always)]
pub fn crest(control_loop: &mut BoardControlLoop, seen: &mut Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    match control_loop.one_pass_joints {
        2 => crest_of_two_joints(control_loop, seen, ticks, legs),
        3 => crest_of_three_joints(control_loop, seen, ticks, legs),
        1 => crest_of_one_joint(control_loop, seen, ticks, legs),
        PHASES_PASS.. => crest_of_three_phase_motors(control_loop, seen, ticks, legs),
        _ => crest_of_any_kind(control_loop, seen, true, ticks, legs),
    }
}

// One function per number of joints, so that each saves only the registers it needs.

#[inline(never)]
fn crest_of_one_joint(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<1, false, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs)
}

#[inline(never)]
fn crest_of_two_joints(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<2, false, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs)
}

#[inline(never)]
fn crest_of_three_joints(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<3, false, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs)
}

/// Runs a crest of a device with three-phase motors in one pass.
#[inline(never)]
fn crest_of_three_phase_motors(
    control_loop: &mut BoardControlLoop,
    seen: &mut Samples,
    ticks: &Ticks,
    legs: &mut Legs,
) -> bool {
    control_loop.read_phases(seen);
    match control_loop.joint_count {
        2 => control_loop.crest_of::<2, true, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs),
        3 => control_loop.crest_of::<3, true, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs),
        _ => control_loop.crest_of::<1, true, _>(seen, &seen.currents, &|drive| ticks.legs(drive), legs),
    }
}

/// Runs any crest, with a control step if `due`, see [`crest`].
#[cold]
#[inline(never)]
pub fn crest_of_any_kind(
    control_loop: &mut BoardControlLoop,
    seen: &mut Samples,
    due: bool,
    ticks: &Ticks,
    legs: &mut Legs,
) -> bool {
    control_loop.read_phases(seen);
    control_loop.crest_of_any_kind(seen, &seen.currents, due, &|drive| ticks.legs(drive), legs)
}

/// Checks for slow faults at the valley, see [`ControlLoop::check_slow_faults`].
#[inline(never)]
pub fn check_slow_faults(control_loop: &mut BoardControlLoop, seen: &Samples) -> Outputs {
    control_loop.check_slow_faults_of(seen, Some(seen.bus_voltage), true);
    control_loop.outputs()
}

/// Computes the angles of encoders without motors, see [`ControlLoop::sense`]. Call before [`note`] if the device has
/// any.
#[inline(never)]
pub fn sense(control_loop: &mut BoardControlLoop, inputs: &Counts) {
    control_loop.sense(&inputs[..]);
}

/// Records the samples of the last crest's step, and writes its record to `frame` if telemetry streams. Call at the
/// valley after the step, before [`check_slow_faults`] and any command.
#[inline(never)]
pub fn note(control_loop: &mut BoardControlLoop, seen: &Samples, frame: Option<&mut MaybeUninit<StepRecord>>) {
    control_loop.note_late(seen);
    if let Some(frame) = frame {
        frame.write(control_loop.frame());
    }
}
