//! `haptic measure-range`: measures the stable range on a board by raising the stiffness until the loop oscillates.

mod meter;
mod report;

use super::answer::{Json, Pictures};
use super::interrupt;
use super::port::{Port, confirm};
use super::range::requested_posture;
use crate::commands::arguments::{self, Numbers, WallArgs};
use clap::ValueEnum;
use clap::builder::TypedValueParser;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, PortSpec};
use haptic_host::output::{self, Overwrite};
use haptic_host::vectors::padded;
use haptic_predict::measure::board_measurement::{self, BoardMeasurement};
use haptic_predict::measure::campaign::{BOTH_SIDES, Plan};
use haptic_predict::measure::progress::{Progress, ProgressError};
use haptic_predict::measure::simulated::{Friction, World};
use haptic_predict::measure::{LONGEST_PULL, Law, MeasureError, MeasurementSetup, PreparedBoard, max_tested_walls};
use haptic_stability::analysis::several::{Member, WallSet};
use meter::ProgressMeter;
use report::{Report, Theory};
use std::path::PathBuf;

/// Measure on a board which walls stay stable; moves the motors
///
/// With several --normal, the walls act together, and stiffness and damping are their totals, as in `haptic range`. For
/// every damping the stiffness is raised until the telemetry shows a motion that builds up, or that continues as a
/// vibration larger than encoder steps explain. The stiffness is then lowered at once, and the boundary bisected. The
/// lowest, the median and the highest repeat of each pull are reported, because with friction a wall may tolerate a short
/// pull and vibrate after a long one. The theory is not used, only printed for comparison, with its `haptic range`
/// command. Take your hand off the device. Ctrl-C turns the motors off at any time; the same command then continues where
/// it stopped. At the end the board's scene, rate and rules are restored; if the command is killed, the next run with
/// the same --progress restores them. --svg draws the measured dots over the predicted range.
///
/// On --port sim the device of the file is simulated in this process, as fast as the computer can.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML) of the device on the board
    device: PathBuf,
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    walls: WallArgs,
    /// Control rate in Hz
    #[arg(long, value_name = "HZ", default_value_t = 1_000.0)]
    rate: f64,
    /// Cutoff of the velocity filter in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0)]
    cutoff: f64,
    /// Measure at exactly these dampings, in N s/m [default: --points of them at equal intervals, up to the end of the
    /// range]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    kd: Option<Numbers>,
    /// Number of dampings to measure without --kd
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=200))]
    points: u16,
    /// Repeats of each pull at each damping
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=100))]
    repeats: u16,
    /// Feed-forward to measure with
    #[arg(long, value_name = "KIND", default_value = "both", value_parser = feed_forwards_parser())]
    feed_forward: &'static [FeedForward],
    /// Corner of the washout in Hz, for --feed-forward washout
    #[arg(long, value_name = "HZ", default_value_t = 2.0)]
    washout: f64,
    /// Largest joint torque of the measurement, in N m; a slide has its force at a lever of 0.08 m
    #[arg(long, value_name = "NM", default_value_t = 1.0)]
    torque_limit: f64,
    /// Longest pull that sets the tip swinging, to one side or (negative) the other, at most 5: in millimetres, the only
    /// option that is not in SI units [default: 0.5,-0.5, or longer if friction requires it]
    #[arg(long, value_name = "MM,..", allow_hyphen_values = true)]
    pull: Option<Numbers>,
    /// Stiffness (N m/rad) and damping (N m s/rad) that hold the posture of a redundant device, as [posture] of a scene
    /// does, such as 0.5,0.03
    #[arg(long, value_name = "K,D", allow_hyphen_values = true)]
    posture: Option<Numbers>,
    /// On --port sim: joint angles of the measurement in rad, travels in m [default: the device file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
    /// On --port sim: leave out all friction
    #[arg(long, conflicts_with = "friction")]
    frictionless: bool,
    /// On --port sim: friction of the device file that acts
    #[arg(long, value_name = "KIND")]
    friction: Option<FrictionKind>,
    /// On --port sim: commanded torques act at once, without bridges, windings and current loops
    #[arg(long)]
    ideal_drive: bool,
    /// On --port sim: counts per turn of every encoder [default: the device file's]
    #[arg(long, value_name = "N")]
    counts: Option<f64>,
    /// On --port sim: a relaxed grip holds the tip (0.12 kg behind 1200 N/m)
    #[arg(long)]
    grip: bool,
    /// Load the device file onto a simulated board with another device, and restore that device afterwards
    #[arg(long)]
    load: bool,
    /// Save the results in this file, and continue from it
    #[arg(long, value_name = "FILE", default_value = "measured-range.json")]
    progress: PathBuf,
    /// Measure from the beginning and replace the file of --progress
    #[arg(long)]
    anew: bool,
    /// Do not ask before a real motor moves
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FrictionKind {
    All,
    Viscous,
    Coulomb,
    None,
}

/// Returns the parser of --feed-forward, whose words name feed-forwards to measure one after the other.
fn feed_forwards_parser() -> impl TypedValueParser<Value = &'static [FeedForward]> {
    let one =
        |alone: &'static [FeedForward; 1]| (alone[0].name(), arguments::describe_feed_forward(alone[0]), &alone[..]);
    let all = &[FeedForward::Off, FeedForward::Full, FeedForward::Washout];
    arguments::words_parser([
        ("both", "Without, then with equation (4)", &all[..2]),
        ("all", "Without, with equation (4), and with it behind a washout", &all[..]),
        one(&[FeedForward::Off]),
        one(&[FeedForward::Full]),
        one(&[FeedForward::Washout]),
    ])
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let mut file = DeviceFile::load(&args.device)?;
    let spec = file.spec();
    let walls = requested_walls(&args, spec.task)?;
    let (plan, largest_pull) = requested_plan(&args, spec.joints)?;
    let held = requested_posture(args.posture.as_ref(), &file)?;
    let world = requested_world(&args, &file, &walls)?;
    let simulated = matches!(args.port.spec(), PortSpec::Sim(_));
    if simulated {
        world.apply(&mut file);
    } else if world != World::default() {
        return Err(Failure::wrong(
            "--q, --friction, --frictionless, --ideal-drive, --counts and --grip change a simulation",
        )
        .remedy("use them with --port sim; a board is measured in its present state"));
    }
    let setup = MeasurementSetup {
        walls,
        rate_hz: args.rate,
        cutoff_hz: args.cutoff,
        washout_hz: args.washout,
        law: Law {
            posture: held,
            may_lengthen_pull: args.pull.is_none() && file.description.joints.iter().any(|joint| joint.coulomb > 0.0),
            ..Law::default()
        },
        torque_limit: args.torque_limit,
        largest_pull,
    };
    let what = board_measurement::description(&file, &setup, &plan.pulls, &world);
    // Checks that the results can be written before anything moves.
    output::check(&args.progress, Overwrite::Replace)?;
    let mut progress = match args.anew {
        true => Progress::read(&args.progress)
            .map(|found| found.map_or(Progress::new(&what), |found| found.without_results(&what))),
        false => Progress::open(&args.progress, &what),
    }
    .map_err(progress_failure)?;

    let interrupt = interrupt::watch();
    let mut board = match args.port.spec() {
        PortSpec::Sim(other) => {
            if let Some(other) = other {
                check_same_device(&DeviceFile::load(other)?.name, &file)?;
            }
            let shared = world
                .board(&file, args.rate)
                .map_err(|error| Failure::wrong(format!("{}: {error}", args.device.display())))?;
            Board::over(shared.wire(), "sim")?
        }
        _ => args.port.open()?,
    };
    let before = board_measurement::settings_to_restore(&mut board, &progress)?;
    check_ready(&mut board, &file, &args, &setup)?;
    let earlier = progress.measured_repeats(&plan);
    if earlier > 0 {
        let (total, place) = (plan.total(), args.progress.display());
        let date = progress.date.as_ref().map_or(String::new(), |date| format!(", the last of {date}"));
        let none = if earlier == total { ": none is measured now (--anew measures them again)" } else { "" };
        haptic_host::tell!("{earlier} of {total} repeats are in {place} already{date}{none}");
    }
    let meter = ProgressMeter::new(plan.total(), plan.repeats_per_damping(), earlier);
    let stop = || {
        meter.tick();
        interrupt.is_set()
    };
    let mut theory = None;
    let path = args.progress.as_path();
    let mut measurement = BoardMeasurement {
        board: &mut board,
        file: &file,
        before,
        progress: &mut progress,
        path: Some(path),
        keeps_settings: !simulated,
    };
    let begun = |prepared: &mut PreparedBoard<'_>, q: &[f64]| {
        let (info, details) = (prepared.board().info().clone(), prepared.board().details()?);
        let around = board_measurement::control_loop(&setup, &info, &details);
        theory = Some(Theory::new(&args, &file, &setup, q, around, *prepared.excitation())?);
        Ok(())
    };
    let measured = measurement.measure(setup.clone(), &plan, &stop, begun, |done| meter.set_done(done));
    meter.finish();
    // Also restores the device that was replaced for this measurement.
    measurement.restore().map_err(progress_failure)?;
    let report =
        theory.map(|theory| Report { name: &file.name, args: &args, plan: &plan, progress: &progress, theory });
    match (measured, report) {
        (Ok(()), Some(report)) if report.has_boundary() => report.write(),
        (measured, report) => {
            // Reports the measured points, then the reason for which there are no more.
            if let Some(report) = report.filter(Report::has_points) {
                report.write()?;
            }
            Err(match (measured, progress.points.iter().find_map(|point| point.open.as_ref())) {
                (Err(error), _) => measurement_failure(error, &args, spec.joints > spec.task, &mut board),
                (Ok(()), open) => {
                    let reason = open.map_or_else(String::new, |open| open.reason.clone());
                    Failure::impossible(format!("no boundary was found: {reason}")).remedy(NO_BOUNDARY_REMEDY)
                }
            })
        }
    }
}

/// Remedy for encoders that are too coarse, or friction that is too large, to find a boundary.
const NO_BOUNDARY_REMEDY: &str = "use finer encoders (--counts on --port sim), a lower --rate and --cutoff, a larger \
                                  --pull or --torque-limit, another pose or normal";

/// Returns the plan of the measurement, and the length of its longest pull, m.
fn requested_plan(args: &Args, joints: usize) -> Result<(Plan, f64), Failure> {
    if !(args.torque_limit > 0.0 && args.torque_limit.is_finite()) {
        return Err(Failure::wrong(format!("--torque-limit is {} N m, and must be positive", args.torque_limit)));
    }
    let either = BOTH_SIDES.map(|side| 0.5 * side).to_vec();
    let pulls = args.pull.clone().map_or(either, |Numbers(pulls)| pulls);
    let longest = LONGEST_PULL * 1e3;
    if let Some(pull) = pulls.iter().find(|pull| **pull == 0.0 || pull.abs() > longest) {
        return Err(Failure::wrong(format!("--pull is {pull} mm, and must not be 0 or more than {longest}")));
    }
    let largest = pulls.iter().fold(0.0_f64, |largest, pull| largest.max(pull.abs()));
    // A single joint has no coupling, so the feed-forward has no effect.
    let modes = if joints == 1 && args.feed_forward.len() > 1 { &[FeedForward::Off][..] } else { args.feed_forward };
    if modes.len() < args.feed_forward.len() {
        haptic_host::tell!("with one joint the feed-forward has no effect, so it is not measured");
    }
    let kd = match args.kd.clone() {
        Some(Numbers(kd)) if kd.iter().any(|kd| *kd < 0.0) => {
            return Err(Failure::wrong("--kd must not contain negative dampings"));
        }
        kd => kd.map(|kd| kd.0),
    };
    let (points, repeats) = (args.points.into(), args.repeats.into());
    let pulls = pulls.iter().map(|pull| pull / largest).collect();
    Ok((Plan { modes: modes.to_vec(), kd, points, repeats, pulls }, largest * 1e-3))
}

fn requested_walls(args: &Args, task: usize) -> Result<Vec<Member>, Failure> {
    let (count, most) = (args.walls.count(), max_tested_walls(task));
    if count > most {
        let reason = format!("{count} walls are too many: more than {most} hold the tip in place");
        return Err(Failure::wrong(reason).remedy(format!("measure at most {most} walls on this device")));
    }
    args.walls.members(task)
}

fn requested_world(args: &Args, file: &DeviceFile, walls: &[Member]) -> Result<World, Failure> {
    if args.counts.is_some_and(|counts| !(counts >= 1.0 && counts.is_finite())) {
        return Err(Failure::wrong("--counts must be at least 1"));
    }
    let q = match &args.q {
        Some(q) => {
            let q = q.exactly(file.spec().joints, "--q", "joint angles")?;
            WallSet::at(&file.description, &q, walls, Admissible::default())?;
            Some(padded(&q))
        }
        None => None,
    };
    let friction = match args.friction {
        _ if args.frictionless => Friction::None,
        None | Some(FrictionKind::All) => Friction::All,
        Some(FrictionKind::Viscous) => Friction::Viscous,
        Some(FrictionKind::Coulomb) => Friction::Coulomb,
        Some(FrictionKind::None) => Friction::None,
    };
    Ok(World { q, friction, ideal_drive: args.ideal_drive, counts: args.counts, grip: args.grip })
}

fn check_same_device(found: &str, file: &DeviceFile) -> Result<(), Failure> {
    if found == file.name {
        return Ok(());
    }
    Err(Failure::impossible(format!("the board holds {found}, the file is {}", file.name))
        .remedy("name the file of the device that is on the board"))
}

/// Checks that the board has the device of the file, and asks if the motors may move.
fn check_ready(board: &mut Board, file: &DeviceFile, args: &Args, setup: &MeasurementSetup) -> Result<(), Failure> {
    let details = board.details()?;
    let device = Device::new(&file.name, &file.description).map_err(Failure::wrong)?;
    if let Some(found) = board_measurement::other_loaded_device(board, &device)? {
        if args.load && !details.real {
            board.set_device(&device)?;
        } else {
            let remedy = match details.real {
                true => "load it with `haptic device`, home it and check its polarity first",
                false => "name the other file, load this one with `haptic device`, or measure it with --load",
            };
            return Err(
                Failure::impossible(format!("the board holds {found}, the file is {}", file.name)).remedy(remedy)
            );
        }
    }
    if !details.real || args.yes {
        return Ok(());
    }
    haptic_host::tell!(
        "This moves the motors by themselves: the tip swings by up to {} mm with at most {} N m, and will oscillate briefly, \
         many times.\nHold a device that has weight in its pose until the motors carry it; then keep your hands \
         away from it. Ctrl-C turns the motors off.",
        12e3 * if setup.law.may_lengthen_pull { LONGEST_PULL } else { setup.largest_pull },
        args.torque_limit
    );
    confirm(false, "the device will move")
}

fn progress_failure(error: ProgressError) -> Failure {
    let failure = Failure::wrong(&error);
    match error {
        ProgressError::Another { .. } => {
            failure.remedy("keep it and name another file with --progress, or replace it with --anew")
        }
        ProgressError::File { .. } => failure.remedy("name another file with --progress"),
        ProgressError::Unwritten(failure) => failure,
    }
}

/// Describes the state of the motors as reported by the board.
fn describe_motors(board: &mut Board) -> &'static str {
    match board.status() {
        Ok(status) if !status.state.drives() => "motors are off",
        _ => "the board DOES NOT CONFIRM that its motors are off; use the emergency stop",
    }
}

/// Converts the error that ended a measurement to a failure with a remedy.
fn measurement_failure(error: MeasureError, args: &Args, redundant: bool, board: &mut Board) -> Failure {
    let again = match args.progress.exists() {
        true => format!("run the same command again to continue where it stopped ({})", args.progress.display()),
        false => "nothing was measured yet; run the same command again".into(),
    };
    match error {
        MeasureError::Board(error) => error.into(),
        MeasureError::Link(error) => error.into(),
        MeasureError::Pose(error) => error.into(),
        MeasureError::Progress(error) => progress_failure(error),
        MeasureError::Interrupted => Failure::impossible(format!("{error}: {}", describe_motors(board))).remedy(again),
        MeasureError::Disarmed => Failure::impossible(error).remedy(again),
        MeasureError::Fault(_) => {
            Failure::impossible(error).remedy(format!("see `haptic faults`, put the device back and {again}"))
        }
        MeasureError::Moved => {
            Failure::impossible(error).remedy("bring it back to that pose, or choose another file with --progress")
        }
        MeasureError::Restless => Failure::impossible(error)
            .remedy("measure away from stops and singularities, at a lower --rate and --cutoff, and check the inertia in the device file"),
        MeasureError::Away { .. } => {
            let again = format!("put it back in its pose, hold it there until the motors carry it, and {again}");
            Failure::impossible(error).remedy(match args.posture {
                None if redundant => format!("hold the pose of this redundant device, as with --posture 0.5,0.03, or {again}"),
                _ => format!("{again}; with friction a shorter pull (--pull 2,-2) leaves it there"),
            })
        }
        MeasureError::Stuck { .. } | MeasureError::Unbounded | MeasureError::Saturates { .. } | MeasureError::Open { .. } => {
            Failure::impossible(error).remedy(NO_BOUNDARY_REMEDY)
        }
        MeasureError::Scene(_) => Failure::wrong(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_sim::{BoardOptions, SharedBoard, ready_board};

    #[test]
    fn motors_count_as_off_only_if_the_board_reports_it() {
        let file = DeviceFile::parse(haptic_sim::SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
        let simulated = SharedBoard::new(ready_board(&file, BoardOptions::default()).unwrap());
        let mut board = Board::over(simulated.wire(), "sim").unwrap();
        board.set_scene(&haptic_predict::wall_ahead::wall_ahead(&file).unwrap()).unwrap();
        assert_eq!(describe_motors(&mut board), "motors are off");
        board.arm().unwrap();
        assert!(describe_motors(&mut board).contains("DOES NOT CONFIRM"));
    }
}
