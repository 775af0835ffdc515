//! `haptic disarm`: switches the motors off.

use super::answer::Json;
use super::port::{OnBoard, fault_in_words};
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError, LinkError, PortSpec, StopOutcome, disarm_held_board};
use serde_json::json;

/// Switch the motors off; the device then moves freely (and falls, if it has weight)
///
/// Also disarms a board with firmware of another version than this tool, and a simulated or emulated board that another
/// tool holds. A board on USB belongs to the tool that has its port open: end that tool, pull the cable, or use the
/// emergency stop.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let port = args.on.spec();
    let mut board = match Board::stop(port) {
        Ok(StopOutcome::Open(board)) => board,
        Ok(StopOutcome::OtherProtocol(version)) => {
            let words = format!("disarmed: the motors are off; the board uses protocol version {version}\n");
            return args.on.answer(json!({ "state": "Disarmed" }), &words);
        }
        // Tries to open the board for a complete report, because the other tool may have closed the port meanwhile.
        Ok(StopOutcome::Held) => match haptic_sim::open(port) {
            Ok(board) => Box::new(board),
            Err(_) => return report_disarmed(args.on.json),
        },
        Err(BoardError::Link(held @ (LinkError::HeldByAnother(_) | LinkError::PortBusy(_) | LinkError::Lost(_)))) => {
            return disarm_held(port, args.on.json, held);
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

/// Disarms the board although another tool holds it.
fn disarm_held(port: &PortSpec, json: Json, held: LinkError) -> Result<(), Failure> {
    match disarm_held_board(port) {
        Ok(()) => report_disarmed(json),
        Err(BoardError::Link(LinkError::PortBusy(_))) => Err(Failure::from(held).remedy(
            "to disarm at once end that tool (Ctrl-C), pull the USB cable of a board whose rules watch the host, or use the \
             emergency stop",
        )),
        Err(other) => Err(other.into()),
    }
}

fn report_disarmed(json: Json) -> Result<(), Failure> {
    let words = "disarmed, although another tool holds the board: the motors are off\n";
    json.answer(json!({ "state": "Disarmed" }), words)
}
