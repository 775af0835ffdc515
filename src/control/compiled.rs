//! The control loop as the board runs it: in its precision, with its trigonometry, and compiled once, here.
//!
//! The firmware's image is built for size, but this crate for speed; what is generic would be compiled where it is
//! used. These functions are what the control interrupt calls, and the only ones of the control loop whose time counts.

use crate::control::ControlLoop;
use crate::control::frame::{Outputs, Samples, StepRecord};
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::carrier::Ticks;
use crate::math::Tabulated;
use crate::model::catalogue::MAX_JOINTS;
use core::mem::MaybeUninit;

/// The trigonometry that the board computes with.
pub type BoardMath = Tabulated;

/// The board's handle to a program: the buffer it lies in, so handing it over moves a pointer.
pub type BoardProgram = &'static mut Program<BoardMath>;

/// Compare values of each bridge's two legs.
pub type Legs = [[u16; 2]; MAX_JOINTS];

/// The board's control_loop.
pub type BoardControlLoop = ControlLoop<BoardProgram>;

/// The part of a control period that needs only counts, see [`ControlLoop::render`].
#[inline(never)]
pub fn render(control_loop: &mut BoardControlLoop, counts: &Counts) {
    control_loop.render(counts);
}

/// All that a crest takes beside that, where a control step is due, its duties in time or late: it is held to its limits,
/// the step is finished, and the compare values of every bridge's legs over the next carrier period follow. Whether the
/// bridges may drive.
///
/// `seen` is all sensed: a board that lacks a sensor shows what it knows instead.
#[inline(always)]
pub fn crest(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    match control_loop.usual {
        2 => crest_of_two(control_loop, seen, ticks, legs),
        3 => crest_of_three(control_loop, seen, ticks, legs),
        1 => crest_of_one(control_loop, seen, ticks, legs),
        _ => crest_generally(control_loop, seen, true, ticks, legs),
    }
}

// A function for each number of joints: none saves more registers than it needs.

#[inline(never)]
fn crest_of_one(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<1, _>(seen, &seen.currents, &|duty| ticks.legs(duty), legs)
}

#[inline(never)]
fn crest_of_two(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<2, _>(seen, &seen.currents, &|duty| ticks.legs(duty), legs)
}

#[inline(never)]
fn crest_of_three(control_loop: &mut BoardControlLoop, seen: &Samples, ticks: &Ticks, legs: &mut Legs) -> bool {
    control_loop.crest_of::<3, _>(seen, &seen.currents, &|duty| ticks.legs(duty), legs)
}

/// The same at any crest, whether a control step is `due` or not, and its duties in time or late.
#[cold]
#[inline(never)]
pub fn crest_generally(
    control_loop: &mut BoardControlLoop,
    seen: &Samples,
    due: bool,
    ticks: &Ticks,
    legs: &mut Legs,
) -> bool {
    control_loop.crest_generally(seen, &seen.currents, due, &|duty| ticks.legs(duty), legs)
}

/// The checks at the valley, see [`ControlLoop::check_slow_faults`].
#[inline(never)]
pub fn check_slow_faults(control_loop: &mut BoardControlLoop, seen: &Samples) -> Outputs {
    control_loop.check_slow_faults_of(seen, Some(seen.bus_voltage), true);
    control_loop.outputs()
}

/// Notes what the step of the last crest saw, which that did not take the time for, and writes its frame where it is to lie,
/// if somebody wants it. At the valley after the step, before [`check_slow_faults`] and any command.
#[inline(never)]
pub fn note(control_loop: &mut BoardControlLoop, seen: &Samples, frame: Option<&mut MaybeUninit<StepRecord>>) {
    control_loop.note_late(seen);
    if let Some(frame) = frame {
        frame.write(control_loop.frame());
    }
}
