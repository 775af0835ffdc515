//! `haptic board restart`: restarts a board.

use super::port::{GOES_OFF, OnBoard, confirm};
use haptic_host::backup::unsaved;
use haptic_host::error::Failure;
use serde_json::json;

/// Restart a board: the motors go off, and it begins with what was saved
///
/// Device, scene and rules that were not saved are forgotten, and so is homing. Asks before motors that are on go off,
/// and before anything unsaved is forgotten.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Do not ask
    #[arg(long)]
    yes: bool,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let mut loses = Vec::new();
    if board.status()?.state.drives() {
        loses.push(GOES_OFF.to_string());
    }
    let unsaved = unsaved(&mut board)?;
    if !unsaved.is_empty() {
        loses.push(format!(
            "what is not saved will be forgotten: {} (`haptic board save` keeps it)",
            unsaved.join(", ")
        ));
    }
    if !loses.is_empty() {
        confirm(args.yes, &loses.join("; "))?;
    }
    board.restart()?;
    let said = "the board restarts: it has what was saved, and is not homed\n";
    args.on.answer(json!({ "restarts": true, "forgotten": unsaved }), said)
}
