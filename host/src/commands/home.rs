//! `haptic home`: declares the present pose to be the device file's home pose.

use super::port::{Port, numbers};
use haptic::error::{Failure, print};

/// Declare the present pose to be the device's home pose
///
/// Incremental encoders know nothing at power-on. Hold the device still in the pose that [home] of its file names,
/// then run this. The motors must be off.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Homes, and reports where the board believes the device to be.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    board.home()?;
    // The next control step computes the new pose.
    let axes = board.device()?.map_or(0, |device| device.axes());
    let status = board.status()?;
    print(&format!("homed: joints {}, tip {}\n", numbers(&status.q[..axes], "rad"), numbers(&status.tip[..axes], "m")))
}
