//! `haptic polarity`: lets the board move each joint a little, to see that motors and encoders agree.

use super::port::{Port, answer, confirm};
use haptic::error::Failure;
use haptic_bridge::safety::fault::State;
use serde_json::json;
use std::time::Duration;

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
    loop {
        // Waiting for telemetry is waiting: there is none, and a simulated board's time passes meanwhile.
        board.rows(Duration::from_millis(100))?;
        let status = board.status()?;
        match (status.state, status.fault) {
            (State::CheckingPolarity, _) => {}
            (_, Some(record)) => {
                let axis = record.axis.map_or(String::new(), |axis| format!(" (joint {axis})"));
                return Err(Failure::impossible(format!("{}{axis}", record.fault)).remedy(record.fault.remedy()));
            }
            _ if status.polarity => {
                let said = "every motor turns its joint the right way\n";
                return answer(args.json, json!({ "polarity_checked": true }), said);
            }
            _ => return Err(Failure::impossible("the check was ended from outside").remedy("start it again")),
        }
    }
}
