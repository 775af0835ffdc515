//! `haptic dfu`: restarts a board into its boot loader, to be flashed over USB.

use super::port::Port;
use haptic::error::{Failure, print};

/// Restart a board into its boot loader, to be flashed over USB
///
/// The motors go off. The board is gone from `haptic list` until it is flashed (docs/flashing.md) or switched off and
/// on.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    args.port.open()?.enter_dfu()?;
    print("the board restarts into its boot loader: flash it with dfu-util, or switch it off and on\n")
}
