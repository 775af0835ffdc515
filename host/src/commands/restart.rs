//! `haptic restart`: a board begins anew.

use super::port::{Port, answer, confirm};
use haptic::backup::unsaved;
use haptic::error::Failure;
use serde_json::json;

/// Restart a board: the motors go off, and it begins with what was saved
///
/// Device, scene and rules that were not saved are forgotten, and so is homing. Asks before motors that are on go off, and
/// before anything unsaved is forgotten.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Do not ask
    #[arg(long)]
    yes: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Asks for the restart.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let mut loses = Vec::new();
    if board.status()?.state.drives() {
        loses.push("the motors are on and will go off: what has weight falls".to_string());
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
    answer(args.json, json!({ "restarts": true, "forgotten": unsaved }), said)
}
