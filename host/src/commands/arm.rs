//! `haptic arm`: motors on, and somebody there while they are.

use super::port::{Port, fault_in_words};
use haptic::error::{Failure, print};
use haptic::interrupt;
use haptic::link::Board;
use haptic_bridge::safety::fault::State;
use haptic_bridge::servo::{ARM_SECONDS, HostAction};
use std::time::Duration;

/// Switch the motors on and render the scene, until Ctrl-C
///
/// Torque ramps up over half a second. The board refuses, with the reason, while anything that it needs is missing.
/// Where its rules watch the host, as a real board's do unless told otherwise, this command stays, tells the board that
/// somebody is there, and switches the motors off at Ctrl-C; should it be killed or unplugged, the board does that.
/// `haptic stream --arm` does the same and shows telemetry. Where they do not (`haptic rules --host ignore`), it
/// returns at once, and the motors stay on until somebody switches them off.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Arms, and stays for as long as the board wants somebody there.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    let watched = board.rules()?.host_action;
    let stop = interrupt::watch();
    board.arm()?;
    let ramp = format!("armed: torque ramps up over {ARM_SECONDS} s");
    if watched == HostAction::Ignore {
        return print(&format!(
            "{ramp}; nobody is watched (`haptic rules --host disarm` changes that): `haptic disarm` or the supply's \
             switch turns the motors off\n"
        ));
    }
    print(&format!("{ramp}; Ctrl-C turns the motors off\n"))?;
    board.keep_alive();
    let rate = board.details()?.rate_hz;
    while !stop.is_set() {
        board.rows(Duration::from_millis(200))?;
        let status = board.status()?;
        match status.fault {
            Some(record) if status.state == State::Fault => {
                let what = fault_in_words(&record, rate);
                return Err(Failure::impossible(format!("the motors are off: {what}")).remedy(record.fault.remedy()));
            }
            _ if status.state != State::Armed => return print("disarmed from elsewhere: the motors are off\n"),
            _ => {}
        }
    }
    disarm(&mut board)
}

/// Switches the motors off and says so.
pub fn disarm(board: &mut Board) -> Result<(), Failure> {
    board.disarm()?;
    print("disarmed: the motors are off\n")
}
