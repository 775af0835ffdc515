//! `haptic clear`: clears a latched fault.

use super::port::{Port, state_in_words};
use haptic::error::{Failure, print};

/// Clear a latched fault, after its cause has been removed
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Clears; the motors stay off.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    board.clear()?;
    let status = board.status()?;
    print(&format!("cleared; the board is {}\n", state_in_words(status.state)))
}
