//! `haptic restart`: restarts a board.

use super::answer::Json;
use super::port::{GOES_OFF, Port, confirm};
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
    port: Port,
    /// Do not ask
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    json: Json,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let mut loses = Vec::new();
    if board.status()?.state.drives() {
        loses.push(GOES_OFF.to_string());
    }
    let unsaved = unsaved(&mut board)?;
    if !unsaved.is_empty() {
        loses.push(format!("what is not saved will be forgotten: {} (`haptic save` keeps it)", unsaved.join(", ")));
    }
    if !loses.is_empty() {
        confirm(args.yes, &loses.join("; "))?;
    }
    board.restart()?;
    let said = "the board restarts: it has what was saved, and is not homed\n";
    args.json.answer(json!({ "restarts": true, "forgotten": unsaved }), said)
}
