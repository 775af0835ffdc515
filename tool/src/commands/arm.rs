//! `haptic arm`: switches the motors on, and reports to the board while they are on.

use super::answer::Json;
use super::held_key::{HeldKey, in_raw_terminal};
use super::interrupt::{self, Interrupt};
use super::port::{OnBoard, motors_off_failure};
use haptic_bridge::control::{ARM_SECONDS, HostAction, Status};
use haptic_bridge::safety::fault::State;
use haptic_host::error::{Failure, print};
use haptic_host::link::{Board, BoardError};
use haptic_show::view::message::FromPage;
use serde_json::json;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Switch the motors on and render the scene, until Ctrl-C if the board watches its host
///
/// Torque ramps up over half a second. The board refuses, with the reason, if a requirement is missing. If the board's
/// rules watch the host, which is the default of a real board, this command stays, reports to the board regularly, and
/// switches the motors off at Ctrl-C; if the command is killed or the board unplugged, the board switches them off.
/// `haptic stream --arm` does the same and shows telemetry. If the rules do not watch the host (`haptic rules --host
/// ignore`), the command returns at once, and the motors stay on until they are switched off.
///
/// With --key the motors are on only while Space is held in this terminal. The board turns them off by itself half a
/// second after the last Space that reached it, with any rules and any delay of the link.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Motors on only while Space is held, until q
    #[arg(long)]
    key: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open_to_stay()?;
    let host_action = board.rules()?.host_action;
    let stop = interrupt::watch();
    if args.key {
        let intro = "hold Space: motors on; release Space: motors off; q ends\n";
        let mut armed = KeyedMotion::new(intro, Board::arm_held, State::Armed);
        run_while_held(&mut board, &mut armed, args.on.json, stop)?;
        return print("disarmed: the motors are off\n");
    }
    board.arm()?;
    let document = json!({ "state": "Armed", "ramp_seconds": ARM_SECONDS, "host_action": host_action });
    let ramp = format!("armed: torque ramps up over {ARM_SECONDS} s");
    if host_action == HostAction::Ignore {
        let words = format!(
            "{ramp}; the board does not watch its host (`haptic rules --host disarm` changes that): `haptic disarm` or the supply's \
             switch turns the motors off\n"
        );
        return args.on.answer(document, &words);
    }
    args.on.answer(document, &format!("{ramp}; Ctrl-C turns the motors off\n"))?;
    board.keep_alive();
    let rate = board.details()?.rate_hz;
    while !stop.is_set() {
        board.rows(Duration::from_millis(200))?;
        let status = board.status()?;
        match status.fault {
            Some(record) if status.state == State::Fault => return Err(motors_off_failure(&record, rate)),
            _ if status.state != State::Armed => {
                return print_end(args.on.json, "disarmed by another tool: the motors are off\n");
            }
            _ => {}
        }
    }
    board.disarm()?;
    print_end(args.on.json, "disarmed: the motors are off\n")
}

/// Interval between polls of the keys.
const KEY_INTERVAL: Duration = Duration::from_millis(20);
/// Interval between polls of the board's status.
const STATUS_INTERVAL: Duration = Duration::from_millis(200);

/// Continues a motion for at most [`KEY_INTERVAL`], and returns true at its end.
pub type Advance<'a> = Box<dyn FnMut(&mut Board) -> Result<bool, Failure> + 'a>;

/// A motion of the motors that lasts while a key is held.
pub struct KeyedMotion<'a> {
    /// Instructions for the user.
    pub intro: &'static str,
    /// Starts the motion, see [`Board::arm_held`].
    pub begin: fn(&mut Board, u32) -> Result<(), BoardError>,
    /// State of the board meanwhile.
    pub state: State,
    /// Returns true if the motion has ended well.
    pub is_done: fn(&Status) -> bool,
    /// Continues the motion for at most [`KEY_INTERVAL`], and returns true at its end.
    pub advance: Advance<'a>,
}

impl KeyedMotion<'_> {
    /// Returns a motion without an end, to which the host contributes nothing.
    pub fn new(intro: &'static str, begin: fn(&mut Board, u32) -> Result<(), BoardError>, state: State) -> Self {
        let advance = Box::new(|board: &mut Board| Ok(board.rows(KEY_INTERVAL).map(|_| false)?));
        Self { intro, begin, state, is_done: |_| false, advance }
    }
}

/// Keeps the motors on while Space is held, until `q` or the end of the motion. Then turns the motors off.
pub fn run_while_held(
    board: &mut Board,
    motion: &mut KeyedMotion<'_>,
    json: Json,
    stop: Interrupt,
) -> Result<(), Failure> {
    if json.is_requested() {
        return Err(Failure::wrong("--key does not apply with --json: it needs a person at the terminal"));
    }
    if !std::io::stdin().is_terminal() {
        return Err(Failure::wrong("--key needs a terminal, for the Space key").remedy("run it in a terminal"));
    }
    print(motion.intro)?;
    board.keep_alive();
    let ended = in_raw_terminal(|| follow_key(board, motion, stop)).map_err(Failure::impossible);
    haptic_host::error::overwrite_line(format_args!(""), true);
    let off = board.disarm();
    ended??;
    Ok(off?)
}

fn follow_key(board: &mut Board, motion: &mut KeyedMotion<'_>, stop: Interrupt) -> Result<(), Failure> {
    let rate = board.details()?.rate_hz;
    let (mut key, mut on, mut polled) = (HeldKey::default(), false, Instant::now());
    let show = |words: &str| haptic_host::error::overwrite_line(format_args!("{words:40}"), false);
    while !stop.is_set() {
        if !on {
            board.rows(KEY_INTERVAL)?;
        } else if (motion.advance)(board)? {
            return Ok(());
        }
        let Some(message) = key.read_keys(board.step()).map_err(Failure::impossible)? else { return Ok(()) };
        match message {
            Some(FromPage::Arm { seen }) => {
                (motion.begin)(board, seen)?;
                on = true;
                show("motors on");
            }
            Some(FromPage::Hold { seen }) if on => board.hold_key(seen)?,
            Some(FromPage::Release {}) => {
                board.disarm()?;
                on = false;
                show("motors off");
            }
            _ => {}
        }
        if on && polled.elapsed() > STATUS_INTERVAL {
            polled = Instant::now();
            let status = board.status()?;
            match status.fault {
                Some(record) if status.state == State::Fault => return Err(motors_off_failure(&record, rate)),
                _ if (motion.is_done)(&status) => return Ok(()),
                _ if status.state != motion.state => {
                    key.forget();
                    on = false;
                    show("disarmed by another tool");
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// Prints how the command ended, except after a JSON document.
fn print_end(json: Json, sentence: &str) -> Result<(), Failure> {
    if json.is_requested() { Ok(()) } else { print(sentence) }
}
