//! An image for the chip that contains only the control step of every mechanism.
//!
//! The panic handler calls a function that does not exist. If a path from the step to a panic remains after
//! optimisation, the handler remains too and linking fails. `cargo xtask no-panic` builds this image and then checks
//! that its machine code has no indirect calls, no recursion and a bounded stack.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use haptic_bridge::control::compiled::{self, BoardControlLoop as OnBoard, Legs};
use haptic_bridge::control::frame::{Outputs, Samples, StepRecord};
use haptic_bridge::control::joints::Counts;
use haptic_bridge::drive::carrier::Ticks;
use haptic_bridge::model::catalogue::MAX_JOINTS;

unsafe extern "C" {
    /// Does not exist. The name appears in the linker's error.
    safe fn the_control_step_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    the_control_step_can_panic()
}

/// Runs one control step like the simulated board.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn control_step(control_loop: &mut OnBoard, samples: &Samples, outputs: &mut Outputs) {
    *outputs = control_loop.control(samples);
}

/// Renders like the interrupt when only the encoder counts are known.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_render(control_loop: &mut OnBoard, counts: &Counts) {
    compiled::render(control_loop, counts);
}

/// Reads the absolute encoders, like the interrupt at a crest.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_angles(control_loop: &mut OnBoard, frames: &[Option<u16>; MAX_JOINTS], counts: &mut Counts) {
    compiled::read_angles(control_loop, frames, counts);
}

/// Runs the rest of a crest with a control step, like the interrupt.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_crest(
    control_loop: &mut OnBoard,
    seen: &mut Samples,
    ticks: &Ticks,
    legs: &mut Legs,
) -> bool {
    let on = compiled::crest(control_loop, seen, ticks, legs);
    #[cfg(feature = "broken")]
    {
        legs[0] = legs[control_loop.status().step as usize];
    }
    on
}

/// Runs any crest, like the interrupt.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_generally(
    control_loop: &mut OnBoard,
    seen: &mut Samples,
    due: bool,
    ticks: &Ticks,
    legs: &mut Legs,
) -> bool {
    compiled::crest_of_any_kind(control_loop, seen, due, ticks, legs)
}

/// Records the last step, like the interrupt at a valley.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_notes(
    control_loop: &mut OnBoard,
    seen: &Samples,
    frame: Option<&mut MaybeUninit<StepRecord>>,
) {
    compiled::note(control_loop, seen, frame);
}

/// Checks slow faults, like the interrupt at a valley.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_sums(control_loop: &mut OnBoard, seen: &Samples, outputs: &mut Outputs) {
    *outputs = compiled::check_slow_faults(control_loop, seen);
}
