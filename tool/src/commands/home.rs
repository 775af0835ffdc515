//! `haptic home`: declares the present pose to be the home pose of the device file.

use super::port::{OnBoard, numbers_in_words};
use haptic_host::error::Failure;
use haptic_host::words::joint_units;
use serde_json::json;

/// Declare the present pose to be the device's home pose
///
/// Incremental encoders have no position at power-on. Hold the device still in the pose in [home] of its file, then run
/// this command; it waits up to a second for the device to be at rest. The motors must be off.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    board.home_at_rest()?;
    // Reads the status, whose pose the next control step computes.
    let units = board.device()?.map(|device| device.mechanism.units()).unwrap_or_default();
    let status = board.status()?;
    let (q, tip) = (&status.q[..units.len()], &status.tip[..units.len()]);
    let joints = numbers_in_words(q, &joint_units(&units, |unit| unit.travel));
    let words = format!("homed: joints {joints}, tip {}\n", numbers_in_words(tip, "m"));
    args.on.answer(json!({ "homed": status.homed, "q": q, "tip": tip }), &words)
}
