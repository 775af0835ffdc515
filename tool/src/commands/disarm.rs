//! `haptic disarm`: motors off.

use super::answer::Json;
use super::port::{OnBoard, fault_in_words};
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError, LinkError, PortSpec, Stopped, disarm_past};
use serde_json::json;

/// Switch the motors off; the device then moves freely (and falls, if it has weight)
///
/// Also of a board whose firmware is of another version than this tool. Gets through to a simulated or emulated board
/// that another tool holds. A board on USB belongs to the tool that has its port open: end that tool, pull the cable, or
/// use the emergency stop.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

/// Disarms, and says so when a fault stays latched.
pub fn run(args: Args) -> Result<(), Failure> {
    let port = args.on.spec();
    let mut board = match Board::stop(port) {
        Ok(Stopped::Open(board)) => board,
        Ok(Stopped::Unlike(version)) => {
            let said = format!("disarmed: the motors are off; the board speaks protocol version {version}\n");
            return args.on.answer(json!({ "state": "Disarmed" }), &said);
        }
        // A tool that was about to leave has left by now, and more can be told.
        Ok(Stopped::Past) => match haptic_sim::open(port) {
            Ok(board) => Box::new(board),
            Err(_) => return said_past(args.on.json),
        },
        Err(BoardError::Link(held @ (LinkError::HeldByAnother(_) | LinkError::PortBusy(_) | LinkError::Lost(_)))) => {
            return past(port, args.on.json, held);
        }
        Err(other) => return Err(other.into()),
    };
    let mut report = "disarmed: the motors are off\n".to_string();
    let status = board.status()?;
    if let Some(record) = status.fault {
        let rate = board.details()?.rate_hz;
        report.push_str(&format!("a fault is latched: {}\n", fault_in_words(&record, rate)));
    }
    let fault = status.fault.map(|record| record.fault.name());
    args.on.answer(json!({ "state": format!("{:?}", status.state), "fault": fault }), &report)
}

/// Disarms past the tool that holds the board.
fn past(port: &PortSpec, json: Json, held: LinkError) -> Result<(), Failure> {
    match disarm_past(port) {
        Ok(()) => said_past(json),
        Err(BoardError::Link(LinkError::PortBusy(_))) => Err(Failure::from(held).remedy(
            "to disarm at once end that tool (Ctrl-C), pull the USB cable of a board whose rules watch the host, or use the \
             emergency stop",
        )),
        Err(other) => Err(other.into()),
    }
}

fn said_past(json: Json) -> Result<(), Failure> {
    let said = "disarmed past the tool that holds the board: the motors are off\n";
    json.answer(json!({ "state": "Disarmed" }), said)
}
