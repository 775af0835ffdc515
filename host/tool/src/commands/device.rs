//! `haptic device`: loads a device file onto a board, or reads the board's back.

use super::port::{OnBoard, warn_of_weaker};
use super::read_back::{Read, needed};
use haptic_bridge::model::device::Device;
use haptic_bridge::safety::limits::{GENTLE_FORCE, Limit, VOLTS_MARGIN};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::read_back::{differences, running};
use haptic_host::toml_file::Document;
use haptic_predict::equivalent::device_file;
use haptic_predict::plausible::{device::doubts, warn};
use haptic_predict::tip::{Tip, torques_hidden_by_speed};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Load a device onto a board, or read it back
///
/// The board forgets homing and the polarity check, because they belong to the device before. `haptic board save` keeps
/// the device over a power cycle.
///
/// What --read writes gives a board the same device to the bit. A board keeps the coefficients of the equations of
/// motion and not the links they came from, so the links in it are one choice of many, near those of FILE where one is
/// given.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    #[arg(required_unless_present = "read")]
    file: Option<PathBuf>,
    #[command(flatten)]
    read: Read,
    /// Largest force that walls, springs and fields render at the tip, N [default: what the board has, at most 5
    /// with real motors].
    /// Lowers the board's torque limits as well, so that no torque makes more in the home pose
    #[arg(long, value_name = "N", value_parser = newtons, conflicts_with = "read")]
    tip_force: Option<f32>,
    #[command(flatten)]
    on: OnBoard,
}

fn newtons(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be finite and greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

/// Checks the file, then the board, then loads.
pub fn run(args: Args) -> Result<(), Failure> {
    if args.read.asked()? {
        return read(&args);
    }
    let path = needed(args.file.as_ref(), "device")?;
    let document = Document::load(&path)?;
    let file = DeviceFile::read(&document)?;
    let device = Device::new(&file.name, &file.description)
        .map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
    let warnings: Vec<_> = doubts(&file).into_iter().map(|doubt| doubt.about(&document)).collect();
    warn(&warnings);
    let mut board = args.on.open()?;
    let details = board.details()?;
    let joints = file.spec().joints;
    if joints > usize::from(details.axes) {
        let line = document.find("joint", Some(usize::from(details.axes)), "", "").map_or(1, |at| at.0);
        let reason =
            format!("{}:{line}: the device has {joints} joints and the board {} axes", path.display(), details.axes);
        return Err(Failure::wrong(reason).remedy("use a board with more axes"));
    }
    board.set_device(&device)?;
    let mut report = format!("{} is loaded on {}; it is not homed\n", file.name, board.port());
    if details.real || args.tip_force.is_some() {
        report.push_str(&soften(&mut board, &file, args.tip_force)?);
    }
    if details.real {
        for lack in file.lacks_for_a_board() {
            report.push_str(&format!("  before the board arms: {lack}\n"));
        }
    }
    let ends = args.on.what_is_left();
    report.push_str(ends);
    if ends.is_empty() && board.scene()?.is_none() {
        report.push_str("next: `haptic scene FILE`, then `haptic home`\n");
    }
    let lacks = if details.real { file.lacks_for_a_board() } else { Vec::new() };
    let document = json!({ "device": file.name, "port": board.port(), "lacks": lacks, "warnings": warnings });
    args.on.answer(document, &report)
}

/// The board's device as a file, or what differs there from a file.
fn read(args: &Args) -> Result<(), Failure> {
    let file = args.file.as_deref().map(DeviceFile::load).transpose()?;
    let device = args.on.open()?.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let text = device_file(&device, file.as_ref().map(|file| &file.description)).ok_or_else(|| {
        Failure::impossible("no device file was found that gives a board exactly this device")
            .remedy("`haptic board backup` keeps it as it is")
    });
    let compared = match &file {
        Some(file) => {
            let written = file.device::<f32>().map_err(Failure::wrong)?;
            let found = differences(&running(&written), &running(&device));
            if found.is_empty() && written != device {
                let path = file.path.display();
                return Err(Failure::different(format!(
                    "the board's device is not that of {path}: it differs in numbers that no device file holds"
                ))
                .remedy("load a device file again, or keep the board's as it is with `haptic board backup`"));
            }
            Some((&*file.path as &Path, found))
        }
        None => None,
    };
    args.read.answer(&args.on, "device", text, compared)
}

/// The highest torque limit (N m) that the board allows, found by asking for a limit that every board refuses.
fn most_torque(board: &mut Board) -> Option<f32> {
    let mut rules = board.rules().ok()?;
    rules.limits.torque[0] = f32::INFINITY;
    match board.set_rules(&rules) {
        Err(BoardError::Refused(Refusal::BadLimit(bad))) if bad.limit == Limit::Torque => Some(bad.most),
        _ => None,
    }
}

/// Limits the force at the tip, lowers the torque limits to what it takes in the home pose, and says so.
fn soften(board: &mut Board, file: &DeviceFile, newtons: Option<f32>) -> Result<String, Failure> {
    let before = board.rules()?;
    let newtons = newtons.unwrap_or(before.limits.tip_force.min(GENTLE_FORCE));
    let mut rules = before;
    rules.limits.tip_force = newtons;
    // Torques that make so many newtons and carry the device as well.
    let needs: Vec<f32> = match Tip::at_home(&file.description) {
        Some(Ok(tip)) => tip.limits_for(newtons.into()).into_iter().map(|torque| torque as f32).collect(),
        _ => Vec::new(),
    };
    for (limit, needed) in rules.limits.torque.iter_mut().zip(&needs) {
        *limit = limit.min(*needed);
    }
    if rules != before {
        board.set_rules(&rules)?;
        warn_of_weaker(&before, &rules);
    }
    let lying = VOLTS_MARGIN * newtons;
    let faster = match Tip::at_home(&file.description) {
        Some(Ok(tip)) => {
            format!(" and {:.1} N more for each rad/s", tip.force(&torques_hidden_by_speed(&file.description)))
        }
        _ => String::new(),
    };
    let tip = format!(
        "  tip force: walls, springs and fields push with at most {newtons} N, a current sensor that lies hides at most \
         {lying} N at rest{faster}; `--tip-force` says how much\n"
    );
    let joints = file.spec().joints;
    let three = |torques: &[f32]| {
        let each: Vec<String> = torques.iter().take(joints).map(|torque| format!("{torque:.3}")).collect();
        each.join(", ")
    };
    let limits = three(&rules.limits.torque);
    // A limit that was lower before stays: it may have been set on purpose.
    if rules.limits.torque.iter().zip(&needs).any(|(limit, needed)| *limit < 0.99 * needed) {
        let needs_in_words =
            format!("{newtons} N at the tip in the home pose, and what carries the device, take {}", three(&needs));
        return Ok(match most_torque(board) {
            Some(most) if needs.iter().any(|needed| *needed > most) => format!(
                "{tip}  torque limits: {limits} N m; {needs_in_words}, and the board allows no more than {most}: are lengths in \
                 the file in m and masses in kg? `--tip-force` asks for less\n"
            ),
            _ => format!(
                "{tip}  torque limits: {limits} N m, of which some were lower before; {needs_in_words}: \
                 `haptic rules --torque` raises them\n"
            ),
        });
    }
    if rules.limits.torque == before.limits.torque {
        return Ok(tip);
    }
    Ok(format!(
        "{tip}  torque limits: {limits} N m, for at most {newtons} N at the tip in the home pose beside what carries the device; \
         `haptic rules --torque` raises them\n"
    ))
}
