//! `haptic board restart`: restarts a board.

use super::port::{MOTORS_GO_OFF, OnBoard, confirm};
use haptic_host::backup::unsaved_settings;
use haptic_host::error::Failure;
use serde_json::json;

/// Restart a board: the motors go off, and it begins with the saved settings
///
/// The board forgets homing and any device, scene and rules that were not saved. Asks first if motors are on or unsaved
/// settings would be lost.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Do not ask
    #[arg(long)]
    yes: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let mut loses = Vec::new();
    if board.status()?.state.drives() {
        loses.push(MOTORS_GO_OFF.to_string());
    }
    let unsaved = unsaved_settings(&mut board)?;
    if !unsaved.is_empty() {
        loses.push(format!("unsaved settings will be lost: {} (`haptic board save` keeps them)", unsaved.join(", ")));
    }
    if !loses.is_empty() {
        confirm(args.yes, &loses.join("; "))?;
    }
    board.restart()?;
    let words = "the board restarts: it has the saved settings, and is not homed\n";
    args.on.answer(json!({ "restarts": true, "forgotten": unsaved }), words)
}
