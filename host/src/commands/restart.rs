//! `haptic restart`: a board begins anew.

use super::port::Port;
use haptic::error::{Failure, print};

/// Restart a board: the motors go off, and it begins with what was saved
///
/// Device, scene and rules that were not saved are forgotten, and so is homing.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    args.port.open()?.restart()?;
    print("the board restarts: it has what was saved, and is not homed\n")
}
