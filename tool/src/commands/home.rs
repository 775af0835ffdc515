//! `haptic home`: declares the present pose to be the device file's home pose.

use super::port::{OnBoard, numbers};
use haptic_host::error::Failure;
use serde_json::json;

/// Declare the present pose to be the device's home pose
///
/// Incremental encoders know nothing at power-on. Hold the device still in the pose that [home] of its file names,
/// then run this; it waits up to a second for the device to be at rest. The motors must be off.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

/// Homes, and reports where the board believes the device to be.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    board.home_at_rest()?;
    // The next control step computes the new pose.
    let axes = board.device()?.map_or(0, |device| device.axes());
    let status = board.status()?;
    let (q, tip) = (&status.q[..axes], &status.tip[..axes]);
    let said = format!("homed: joints {}, tip {}\n", numbers(q, "rad"), numbers(tip, "m"));
    args.on.answer(json!({ "homed": status.homed, "q": q, "tip": tip }), &said)
}
