//! `haptic save`: keeps device, scene, gains and rules over a power cycle.

use super::port::{Port, answer};
use haptic::error::Failure;
use haptic::link::BoardError;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use serde_json::json;

/// Keep device, scene, gains and rules in the board's flash
///
/// The motors must be off: the processor stands still for up to a second while flash is erased.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Saves.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    if matches!(board.status()?.state, State::Armed | State::CheckingPolarity) {
        return Err(BoardError::Refused(Refusal::Armed).into());
    }
    eprintln!("writing flash: the board pauses for up to a second");
    board.save()?;
    let said = "saved: the board starts with this device and scene from now on\n";
    answer(args.json, json!({ "saved": true, "board": board.info().board, "serial": board.info().serial }), said)
}
