//! `haptic polarity`: lets the board move each joint a little, to check that motors and encoders agree.

use super::port::{OnBoard, confirm};
use haptic_host::error::Failure;
use serde_json::json;

/// Check that every motor turns its joint the way its encoder counts (moves the device)
///
/// Each joint in turn gets a small, slowly growing torque until it moves, and is then swung by some degrees or
/// millimetres about its starting position. A real board arms only after this check has passed with its device at its
/// home.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Do not ask before the device moves
    #[arg(long)]
    yes: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    if board.details()?.real {
        confirm(
            args.yes,
            "each joint is moved by a small torque: the device must be free to move; keep your hands off it",
        )?;
    }
    board.check_polarity()?;
    board.wait_for_polarity()?.require_pass()?;
    args.on.answer(json!({ "polarity_checked": true }), "every motor turns its joint the right way\n")
}
