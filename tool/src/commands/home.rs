//! `haptic home`: tells the board the device's joint angles, as the device file says in [home].

use super::arm::{KeyedMotion, run_while_held};
use super::interrupt;
use super::port::{OnBoard, numbers_in_words};
use haptic_bridge::model::description::Homing;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::words::joint_units;
use serde_json::json;
use std::time::Duration;

/// Home the device: by its home pose, its index marks or its stops, as its file says
///
/// Incremental encoders have no position at power-on. By default, hold the device still in the pose in [home] of its
/// file, then run this command; it waits up to a second for the device to be at rest. The motors must be off.
///
/// With `by = "index"` move every joint slowly over its index mark while this command waits, up to two minutes; the
/// motors stay off. With `by = "stop"` the pose is a rough beginning: then run `haptic polarity`, and `haptic home
/// --key`, which pushes each joint to its stop with at most 0.5 N at the tip while you hold Space.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Push the joints to their stops while Space is held (moves the device)
    #[arg(long)]
    key: bool,
}

/// Longest wait for the index marks.
const INDEX_PATIENCE: Duration = Duration::from_secs(120);

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let device = board.device()?;
    let (axes, homing) = device.map_or((0, Homing::Hand), |device| (device.axes(), device.homing));
    if args.key {
        let intro =
            "hold Space: each joint is pushed to its stop, keep your hands off; release Space: motors off; q ends\n";
        let mut motion = KeyedMotion::new(intro, Board::find_stops, State::Homing);
        motion.is_done = |status| status.homed;
        run_while_held(&mut board, &mut motion, args.on.json, interrupt::watch())?;
        if !board.status()?.homed {
            return Err(Failure::impossible("the device is not homed").remedy("hold Space until the command ends"));
        }
    } else if homing == Homing::Index {
        home_by_index(&mut board)?;
    } else {
        board.home_at_rest()?;
    }
    // Reads the status, whose pose the next control step computes.
    let units = board.device()?.map(|device| device.mechanism.units()).unwrap_or_default();
    let status = board.status()?;
    let (q, tip) = (&status.q[..axes], &status.tip[..axes]);
    let joints = numbers_in_words(q, &joint_units(&units, |unit| unit.travel));
    let pose = format!("joints {joints}, tip {}", numbers_in_words(tip, "m"));
    let words = match homing {
        Homing::Stop(_) if !status.homed => {
            format!("roughly at home: {pose}\nnext: `haptic polarity`, then `haptic home --key`\n")
        }
        Homing::Stop(_) if !status.polarity => format!("homed: {pose}\nnext: `haptic polarity` again at this home\n"),
        _ => format!("homed: {pose}\n"),
    };
    let forgotten = homing == Homing::Hand && board.details()?.real && !board.cogging()?.is_empty();
    let forgotten = if forgotten { "next: `haptic cogging` again at this home\n" } else { "" };
    args.on.answer(json!({ "homed": status.homed, "q": q, "tip": tip }), &(words + forgotten))
}

/// Waits until every joint has passed its index mark. Says what is missing.
fn home_by_index(board: &mut Board) -> Result<(), Failure> {
    let (stop, until, mut told) = (interrupt::watch(), board.now() + INDEX_PATIENCE, None);
    loop {
        let refusal = match board.home() {
            Err(BoardError::Refused(refusal @ (Refusal::IndexUnseen(_) | Refusal::IndexAmbiguous(_)))) => refusal,
            outcome => return Ok(outcome?),
        };
        if stop.is_set() || board.now() >= until {
            return Err(BoardError::Refused(refusal).into());
        }
        if told.replace(refusal) != Some(refusal) {
            haptic_host::tell!("{refusal}");
        }
        board.rows(Duration::from_millis(100))?;
    }
}
