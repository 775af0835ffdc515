//! `haptic save`: keeps device, scene, gains and rules over a power cycle.

use super::port::Port;
use haptic::error::{Failure, print};

/// Keep device, scene, gains and rules in the board's flash
///
/// The motors must be off: the processor stands still for up to a second while flash is erased.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Saves.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    eprintln!("writing flash: the board pauses for up to a second");
    board.save()?;
    print("saved: the board starts with this device and scene from now on\n")
}
