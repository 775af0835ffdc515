//! `haptic arm`: motors on, and somebody there while they are.

use super::answer::Json;
use super::port::{Port, motors_off};
use haptic::error::{Failure, print};
use haptic::interrupt;
use haptic_bridge::safety::fault::State;
use haptic_bridge::servo::{ARM_SECONDS, HostAction};
use serde_json::json;
use std::time::Duration;

/// Switch the motors on and render the scene, until Ctrl-C where the board watches its host
///
/// Torque ramps up over half a second. The board refuses, with the reason, while anything that it needs is missing. If
/// the board's rules watch the host, as a real board's do unless told otherwise, this command stays, keeps telling the
/// board that it is there, and switches the motors off at Ctrl-C; if it is killed or unplugged, the board does that.
/// `haptic stream --arm` does the same and shows telemetry. If they do not (`haptic rules --host ignore`), it returns
/// at once, and the motors stay on until somebody switches them off.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    json: Json,
}

/// Arms, and stays for as long as the board wants somebody there.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    let watched = board.rules()?.host_action;
    let stop = interrupt::watch();
    board.arm()?;
    let document = json!({ "state": "Armed", "ramp_seconds": ARM_SECONDS, "host_action": watched });
    let ramp = format!("armed: torque ramps up over {ARM_SECONDS} s");
    if watched == HostAction::Ignore {
        let said = format!(
            "{ramp}; nobody is watched (`haptic rules --host disarm` changes that): `haptic disarm` or the supply's \
             switch turns the motors off\n"
        );
        return args.json.answer(document, &said);
    }
    args.json.answer(document, &format!("{ramp}; Ctrl-C turns the motors off\n"))?;
    board.keep_alive();
    let rate = board.details()?.rate_hz;
    while !stop.is_set() {
        board.rows(Duration::from_millis(200))?;
        let status = board.status()?;
        match status.fault {
            Some(record) if status.state == State::Fault => return Err(motors_off(&record, rate)),
            _ if status.state != State::Armed => {
                return told(args.json, "disarmed from elsewhere: the motors are off\n");
            }
            _ => {}
        }
    }
    board.disarm()?;
    told(args.json, "disarmed: the motors are off\n")
}

/// Says how it ended, where that is not a second JSON document.
fn told(json: Json, sentence: &str) -> Result<(), Failure> {
    if json.asked() { Ok(()) } else { print(sentence) }
}
