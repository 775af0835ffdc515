//! `haptic board dfu`: restarts a board into its boot loader, to be flashed over USB.

use super::port::{MOTORS_GO_OFF, OnBoard, confirm};
use haptic_host::error::Failure;
use serde_json::json;

/// Restart a board into its boot loader, to be flashed over USB
///
/// The motors go off. The board is missing from `haptic board list` until it is flashed (`haptic flash`, which enters
/// the boot loader by itself) or switched off and on.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Do not ask before motors that are on go off
    #[arg(long)]
    yes: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    if board.status()?.state.drives() {
        confirm(args.yes, MOTORS_GO_OFF)?;
    }
    board.enter_dfu()?;
    let words = "the board restarts into its boot loader: flash it with `haptic flash`, or switch it off and on\n";
    args.on.answer(json!({ "restarts": "boot-loader" }), words)
}
