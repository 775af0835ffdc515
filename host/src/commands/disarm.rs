//! `haptic disarm`: motors off.

use super::answer::Json;
use super::port::{Port, fault_in_words};
use haptic::error::Failure;
use haptic::link::{Board, BoardError, LinkError, PortSpec, disarm_past};
use serde_json::json;

/// Switch the motors off; the device then moves freely (and falls, if it has weight)
///
/// Gets through to a simulated or emulated board that another tool holds. A board on USB belongs to the tool that has
/// its port open: end that tool, pull the cable, or use the emergency stop.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    json: Json,
}

/// Disarms, and says so when a fault stays latched.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = match Board::open(args.port.spec()) {
        Ok(board) => board,
        Err(held @ (LinkError::HeldByAnother(_) | LinkError::PortBusy(_))) => {
            return past(args.port.spec(), args.json, held);
        }
        Err(other) => return Err(other.into()),
    };
    board.disarm()?;
    let mut report = "disarmed: the motors are off\n".to_string();
    let status = board.status()?;
    if let Some(record) = status.fault {
        let rate = board.details()?.rate_hz;
        report.push_str(&format!("a fault is latched: {}\n", fault_in_words(&record, rate)));
    }
    let fault = status.fault.map(|record| record.fault.name());
    args.json.answer(json!({ "state": format!("{:?}", status.state), "fault": fault }), &report)
}

/// Disarms past the tool that holds the board.
fn past(port: &PortSpec, json: Json, held: LinkError) -> Result<(), Failure> {
    match disarm_past(port) {
        Ok(()) => {
            let said = "disarmed past the tool that holds the board: the motors are off\n";
            json.answer(json!({ "state": "Disarmed" }), said)
        }
        Err(BoardError::Link(LinkError::PortBusy(_))) => Err(Failure::from(held).remedy(
            "to disarm at once end that tool (Ctrl-C), pull the USB cable of a board whose rules watch the host, or use the \
             emergency stop",
        )),
        Err(other) => Err(other.into()),
    }
}
