//! `haptic arm`: motors on.

use super::port::Port;
use haptic::error::{Failure, print};
use haptic_bridge::servo::ARM_SECONDS;

/// Switch the motors on and render the scene
///
/// Torque ramps up over half a second. The board refuses, with the reason, while anything that it needs is missing.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Arms.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    board.arm()?;
    print(&format!(
        "armed: torque ramps up over {ARM_SECONDS} s; `haptic disarm` or the supply's switch turns the motors off\n"
    ))
}
