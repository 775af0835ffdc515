//! `haptic arm`: motors on, and somebody there while they are.

use super::answer::Json;
use super::held_key::{HeldKey, in_raw_terminal};
use super::interrupt::{self, Interrupt};
use super::port::{OnBoard, motors_off};
use haptic_bridge::control::{ARM_SECONDS, HostAction};
use haptic_bridge::safety::fault::State;
use haptic_host::error::{Failure, print};
use haptic_host::link::Board;
use haptic_show::view::message::FromPage;
use serde_json::json;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Switch the motors on and render the scene, until Ctrl-C where the board watches its host
///
/// Torque ramps up over half a second. The board refuses, with the reason, while anything that it needs is missing. If
/// the board's rules watch the host, as a real board's do unless told otherwise, this command stays, keeps telling the
/// board that it is there, and switches the motors off at Ctrl-C; if it is killed or unplugged, the board does that.
/// `haptic stream --arm` does the same and shows telemetry. If they do not (`haptic rules --host ignore`), it returns
/// at once, and the motors stay on until somebody switches them off.
///
/// With --key the motors are on only while Space is held in this terminal, and the board turns them off by itself half a
/// second after the last Space that reached it, whatever its rules say and however slow the way to it is.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Motors on only while Space is held, until q
    #[arg(long)]
    key: bool,
}

/// Arms, and stays for as long as the board wants somebody there.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open_to_stay()?;
    let watched = board.rules()?.host_action;
    let stop = interrupt::watch();
    if args.key {
        return hold(&mut board, args.on.json, stop);
    }
    board.arm()?;
    let document = json!({ "state": "Armed", "ramp_seconds": ARM_SECONDS, "host_action": watched });
    let ramp = format!("armed: torque ramps up over {ARM_SECONDS} s");
    if watched == HostAction::Ignore {
        let said = format!(
            "{ramp}; nobody is watched (`haptic rules --host disarm` changes that): `haptic disarm` or the supply's \
             switch turns the motors off\n"
        );
        return args.on.answer(document, &said);
    }
    args.on.answer(document, &format!("{ramp}; Ctrl-C turns the motors off\n"))?;
    board.keep_alive();
    let rate = board.details()?.rate_hz;
    while !stop.is_set() {
        board.rows(Duration::from_millis(200))?;
        let status = board.status()?;
        match status.fault {
            Some(record) if status.state == State::Fault => return Err(motors_off(&record, rate)),
            _ if status.state != State::Armed => {
                return told(args.on.json, "disarmed from elsewhere: the motors are off\n");
            }
            _ => {}
        }
    }
    board.disarm()?;
    told(args.on.json, "disarmed: the motors are off\n")
}

/// Between two looks at the keys.
const LOOK: Duration = Duration::from_millis(20);
/// Between two looks at the board.
const STATUS: Duration = Duration::from_millis(200);

/// Motors on while Space is held, until `q`.
fn hold(board: &mut Board, json: Json, stop: Interrupt) -> Result<(), Failure> {
    if json.asked() {
        return Err(Failure::wrong("--key and --json: nobody holds a key for a program"));
    }
    if !std::io::stdin().is_terminal() {
        return Err(Failure::wrong("--key needs a terminal, in which somebody holds Space"));
    }
    print("hold Space: motors on; let go: motors off; q ends\n")?;
    board.keep_alive();
    let ended = in_raw_terminal(|| while_held(board, stop)).map_err(Failure::impossible);
    haptic_host::error::say_over(format_args!(""), true);
    let off = board.disarm();
    ended??;
    off?;
    print("disarmed: the motors are off\n")
}

fn while_held(board: &mut Board, stop: Interrupt) -> Result<(), Failure> {
    let rate = board.details()?.rate_hz;
    let (mut key, mut on, mut looked) = (HeldKey::default(), false, Instant::now());
    let shown = |words: &str| haptic_host::error::say_over(format_args!("{words:40}"), false);
    while !stop.is_set() {
        board.rows(LOOK)?;
        let Some(said) = key.listen(board.step()).map_err(Failure::impossible)? else { return Ok(()) };
        match said {
            Some(FromPage::Arm { seen }) => {
                board.arm_held(seen)?;
                on = true;
                shown("motors on");
            }
            Some(FromPage::Hold { seen }) if on => board.hold_key(seen)?,
            Some(FromPage::Release {}) => {
                board.disarm()?;
                on = false;
                shown("motors off");
            }
            _ => {}
        }
        if on && looked.elapsed() > STATUS {
            looked = Instant::now();
            let status = board.status()?;
            match status.fault {
                Some(record) if status.state == State::Fault => return Err(motors_off(&record, rate)),
                _ if status.state != State::Armed => {
                    key.forget();
                    on = false;
                    shown("disarmed from elsewhere");
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// Says how it ended, where that is not a second JSON document.
fn told(json: Json, sentence: &str) -> Result<(), Failure> {
    if json.asked() { Ok(()) } else { print(sentence) }
}
