//! The servo as the board runs it: in its precision, with its trigonometry, and compiled once, here.
//!
//! The firmware's image is built for size, but this crate for speed; what is generic would be compiled where it is used.
//! These two functions are what the control interrupt calls, and the only ones of the servo whose time counts.

use crate::description::MAX_JOINTS;
use crate::math::Minimax;
use crate::program::Program;
use crate::servo::{Outputs, Samples, Servo};

/// The trigonometry that the board computes with.
pub type BoardMath = Minimax;

/// How the board holds a program: by the buffer it lies in, so handing it over moves a pointer.
pub type BoardProgram = &'static mut Program<BoardMath>;

/// The board's servo.
pub type BoardServo = Servo<BoardProgram>;

/// One control period, see [`Servo::control`].
#[inline(never)]
pub fn control(servo: &mut BoardServo, samples: &Samples) -> Outputs {
    servo.control(samples)
}

/// Duties for the next carrier period, see [`Servo::duties`].
#[inline(never)]
pub fn duties(servo: &mut BoardServo, bus_voltage: f32, currents: &[f32; MAX_JOINTS]) -> [f32; MAX_JOINTS] {
    servo.duties(bus_voltage, currents)
}
