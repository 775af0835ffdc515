//! The control step of every mechanism and nothing else, for the chip.
//!
//! The panic handler calls a function that does not exist. If any way from the step to a panic is left after
//! optimisation, the handler is needed, the function is missing and linking fails. `cargo xtask no-panic` builds this
//! image and then reads its machine code: no indirect calls, no recursion, a bounded stack.
#![no_std]
#![no_main]

use haptic_bridge::math::Minimax;
use haptic_bridge::servo::Servo;
use haptic_bridge::servo::frame::{Outputs, Samples};
use haptic_bridge::servo::joints::Currents;
use haptic_bridge::servo::program::Program;

type OnBoard = Servo<&'static mut Program<Minimax>>;

unsafe extern "C" {
    /// Exists nowhere: its name is the linker's message.
    safe fn the_control_step_can_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    the_control_step_can_panic()
}

/// One control period, as the interrupt calls it.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn control_step(servo: &mut OnBoard, samples: &Samples, outputs: &mut Outputs) {
    *outputs = servo.control(samples);
}

/// The watch of a carrier period, as the interrupt calls it.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_guard(servo: &mut OnBoard, seen: &Samples, outputs: &mut Outputs) {
    *outputs = servo.guard(seen);
}

/// What it sums up at a valley, as the interrupt calls it.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_sums(servo: &mut OnBoard, seen: &Samples, outputs: &mut Outputs) {
    *outputs = servo.sum_up(seen);
}

/// One carrier period, as the interrupt calls it.
// SAFETY: no other symbol of the image has this name.
#[unsafe(no_mangle)]
pub extern "C" fn carrier_step(
    servo: &mut OnBoard,
    bus_voltage: f32,
    currents: &Currents,
    late: bool,
    duties: &mut [f32; 3],
) {
    *duties = servo.duties(bus_voltage, currents, late);
    #[cfg(feature = "broken")]
    {
        duties[0] = currents[servo.status().step as usize];
    }
}
