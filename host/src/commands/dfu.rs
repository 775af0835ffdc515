//! `haptic dfu`: restarts a board into its boot loader, to be flashed over USB.

use super::port::{Port, answer, confirm};
use haptic::error::Failure;
use serde_json::json;

/// Restart a board into its boot loader, to be flashed over USB
///
/// The motors go off. The board is gone from `haptic list` until it is flashed (docs/flashing.md) or switched off and
/// on.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Do not ask before motors that are on go off
    #[arg(long)]
    yes: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    if board.status()?.state.drives() {
        confirm(args.yes, "the motors are on and will go off: what has weight falls")?;
    }
    board.enter_dfu()?;
    let said = "the board restarts into its boot loader: flash it with dfu-util, or switch it off and on\n";
    answer(args.json, json!({ "restarts": "boot-loader" }), said)
}
