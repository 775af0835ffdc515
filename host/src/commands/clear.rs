//! `haptic clear`: clears a latched fault.

use super::port::{Port, answer, state_in_words};
use haptic::error::Failure;
use serde_json::json;

/// Clear a latched fault, after its cause has been removed
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Clears; the motors stay off.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let before = board.status()?.fault;
    board.clear()?;
    let status = board.status()?;
    let cleared = before.map(|record| record.fault.name());
    let done = cleared.map_or("no fault was latched".into(), |name| format!("cleared {name}"));
    let said = format!("{done}; the board is {}\n", state_in_words(status.state));
    answer(args.json, json!({ "cleared": cleared, "state": format!("{:?}", status.state) }), &said)
}
