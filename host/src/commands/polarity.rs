//! `haptic polarity`: lets the board move each joint a little, to see that motors and encoders agree.

use super::port::{Port, answer, confirm};
use haptic::error::Failure;
use serde_json::json;

/// Check that every motor turns its joint the way its encoder counts (moves the device)
///
/// Each joint in turn gets a small, slowly growing torque until it has moved 0.02 rad (1.1 degrees). One with
/// little friction is on its way by then and goes on by some degrees. A real board arms only
/// after this check has passed with its device.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Do not ask before the device moves
    #[arg(long)]
    yes: bool,
}

/// Asks, starts the check and waits for its end.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    if board.details()?.real {
        confirm(args.yes, "each joint is moved by a small torque: the device must be free to move, and hands off it")?;
    }
    board.keep_alive();
    board.check_polarity()?;
    board.wait_for_polarity()?.passed()?;
    answer(args.json, json!({ "polarity_checked": true }), "every motor turns its joint the right way\n")
}
