//! `haptic cogging`: learns the torque of the motors' magnets by slow motions, so that the board compensates it.

use super::answer::Pictures;
use super::arm::{KeyedMotion, run_while_held};
use super::interrupt;
use super::port::OnBoard;
use haptic_bridge::control::Status;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::safety::fault::State;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::Board;
use haptic_predict::cogging::{CoggingError, Learnt, Sweep, fit};
use haptic_predict::measure::board_measurement::other_loaded_device;
use haptic_predict::measure::earlier_settings::EarlierSettings;
use haptic_show::plot::cogging::draw;
use serde_json::json;
use std::path::PathBuf;

/// Learn the cogging of the motors, which the board then compensates (moves the device)
///
/// Each joint in turn moves slowly through its arc, twice both ways, held by at most half of its motor's torque and of the
/// tip's force limit. The mean of both directions is free of friction. The weight is subtracted by the device file, and a
/// slowly varying load by a polynomial. A Fourier series of a potential in the angle of the motor's shaft is fitted to
/// the rest, with the orders that the arc resolves. Hands off.
///
/// On a real board the motors are on only while Space is held, as with `haptic arm --key`; a released motion continues.
/// `haptic board save` keeps the result. Another device drops it, and so does `haptic home` of a device that is homed by
/// hand, which does not repeat its home precisely enough.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML) of the device on the board
    device: PathBuf,
    #[command(flatten)]
    on: OnBoard,
    /// Joints to learn, separated by commas [default: all]
    #[arg(long, value_name = "I,..", value_delimiter = ',')]
    joint: Vec<usize>,
    /// Motors on only while Space is held, also on a simulated board
    #[arg(long)]
    key: bool,
    #[command(flatten)]
    pictures: Pictures,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let file = DeviceFile::load(&args.device)?;
    let device: Device<f32> = file.device().map_err(Failure::wrong)?;
    let mut joints = args.joint.clone();
    if joints.is_empty() {
        joints = (0..device.axes()).collect();
    }
    let mut board = args.on.open()?;
    if let Some(other) = other_loaded_device(&mut board, &device)? {
        let reason = format!("the board holds {other}, the file is {}", file.name);
        return Err(Failure::impossible(reason).remedy("load the file with `haptic device` first"));
    }
    let keyed = args.key || board.details()?.real;
    let before = EarlierSettings::of(&mut board)?;
    let learnt: Result<Vec<Learnt>, Failure> =
        joints.iter().map(|joint| learn(&mut board, &device, *joint, keyed, &args)).collect();
    let restored = before.restore(&mut board);
    let learnt = learnt?;
    restored?;
    let mut potentials = board.cogging()?;
    for (joint, learnt) in joints.iter().zip(&learnt) {
        potentials.0[*joint].clone_from(&learnt.potential);
    }
    board.set_cogging(&potentials)?;
    let units = device.mechanism.units();
    let all: Vec<(usize, &JointUnits, &Learnt)> =
        joints.iter().zip(&learnt).map(|(joint, learnt)| (*joint, units[*joint], learnt)).collect();
    if args.pictures.is_requested() {
        args.pictures.save(&draw(&format!("Cogging of {}", file.name), &all, args.pictures.paper()))?;
    }
    let words: String = all.iter().map(|(joint, units, learnt)| in_words(*joint, units, learnt)).collect();
    let next = "the board compensates it from now on; `haptic board save` keeps it\n";
    let documents: Vec<_> = all
        .iter()
        .map(|(joint, _, learnt)| {
            json!({
                "joint": joint, "ripple_before": learnt.before, "ripple_after": learnt.after,
                "held_out": learnt.held_out, "friction": learnt.friction, "harmonics": learnt.potential,
            })
        })
        .collect();
    let temporary = args.on.warn_if_temporary();
    args.on.answer(json!({ "joints": documents }), &format!("{words}{next}{temporary}"))
}

/// Moves a joint through its arc and fits its potential.
fn learn(board: &mut Board, device: &Device<f32>, joint: usize, keyed: bool, args: &Args) -> Result<Learnt, Failure> {
    let Status { q, .. } = board.status()?;
    let mut sweep = Sweep::new(device, &board.rules()?, &q, joint).map_err(failure)?;
    board.set_scene(&sweep.scene())?;
    let stop = interrupt::watch();
    let (mut shown, mut done) = (None, false);
    let mut advance = |board: &mut Board| {
        done = sweep.advance(board).map_err(failure)?;
        let percent = (100.0 * sweep.progress()) as u32;
        if shown.replace(percent) != Some(percent) {
            haptic_host::error::overwrite_line(format_args!("joint {joint}: {percent} %   "), false);
        }
        Ok(done)
    };
    if keyed {
        let intro = "hold Space: the joint moves slowly through its arc, keep your hands off; release Space: motors off; q ends\n";
        let mut motion = KeyedMotion::new(intro, Board::arm_held, State::Armed);
        motion.advance = Box::new(&mut advance);
        run_while_held(board, &mut motion, args.on.json, stop)?;
    } else {
        board.keep_alive();
        board.arm()?;
        let mut moved = Ok(false);
        while !stop.is_set() && matches!(moved, Ok(false)) {
            moved = advance(board);
        }
        board.disarm()?;
        haptic_host::error::overwrite_line(format_args!(""), true);
        moved?;
    }
    if !done {
        return Err(Failure::impossible("the motion did not reach its end, so nothing was learnt"));
    }
    fit(sweep.passes(), sweep.motion()).map_err(failure)
}

fn failure(error: CoggingError) -> Failure {
    match error {
        CoggingError::Board(error) => error.into(),
        CoggingError::Link(error) => error.into(),
        error => Failure::impossible(error),
    }
}

fn in_words(joint: usize, units: &JointUnits, learnt: &Learnt) -> String {
    let Learnt { potential, before, after, held_out, friction, .. } = learnt;
    let orders: Vec<String> = potential.iter().map(|harmonic| harmonic.order.to_string()).collect();
    let unit = units.torque;
    format!(
        "joint {joint}: ripple {before:.2e} {unit} rms, expected after compensation {after:.2e} ({:.0} % less), at angles \
         left out of the fit {held_out:.2e}\n  periods per turn of the shaft: {}; friction {friction:.2e} {unit}\n",
        100.0 * (1.0 - after / before),
        orders.join(", "),
    )
}
