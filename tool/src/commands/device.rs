//! `haptic device`: loads a device file onto a board, or reads back the board's device.

use super::port::{OnBoard, warn_of_weaker_rules};
use super::read_back::{ReadOptions, required_file};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::safety::limits::{GENTLE_FORCE, Limit, VOLTS_MARGIN};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::read_back::{device_entries, differences as compare, to_toml};
use haptic_host::toml_file::Document;
use haptic_host::words::joint_units;
use haptic_predict::plausible::{device::file_warnings, warn};
use haptic_predict::tip::{Tip, torques_hidden_by_speed};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Load a device onto a board, or read it back
///
/// The board forgets homing and the polarity check, because they belong to the previous device. `haptic board save`
/// keeps the device over a power cycle.
///
/// A board keeps the coefficients of the equations of motion and not the links that they came from, so --read lists
/// coefficients, and no board loads its output. `haptic board backup` keeps a device.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    #[arg(required_unless_present = "read")]
    file: Option<PathBuf>,
    #[command(flatten)]
    read: ReadOptions,
    /// Largest force of walls, springs and fields at the tip, N [default: the board's, at most 5 with real motors].
    /// Also lowers the board's torque limits, so that the torques cannot exceed this force in the home pose
    #[arg(long, value_name = "N", value_parser = parse_newtons, conflicts_with = "read")]
    tip_force: Option<f32>,
    #[command(flatten)]
    on: OnBoard,
}

fn parse_newtons(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be finite and greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

pub fn run(args: Args) -> Result<(), Failure> {
    if args.read.is_requested()? {
        return read_back(&args);
    }
    let path = required_file(args.file.as_ref(), "device")?;
    let document = Document::load(&path)?;
    let file = DeviceFile::read(&document)?;
    let device = Device::new(&file.name, &file.description)
        .map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
    let warnings: Vec<_> = file_warnings(&file).into_iter().map(|warning| warning.locate_in(&document)).collect();
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
    let (sensed, inputs) = (device.sensed.len(), usize::from(details.encoders));
    if joints + sensed > inputs {
        let (left, path) = (inputs.saturating_sub(joints), path.display());
        let line = document.find("sensed", Some(left), "", "").map_or(1, |at| at.0);
        let reason = format!(
            "{path}:{line}: the board has {inputs} encoder inputs, of which {joints} joints leave {left} for {sensed} [[sensed]]"
        );
        return Err(Failure::wrong(reason).remedy("remove those that it cannot read"));
    }
    board.set_device(&device)?;
    let mut report = format!("{} is loaded on {}; it is not homed\n", file.name, board.port());
    if details.real || args.tip_force.is_some() {
        report.push_str(&limit_force(&mut board, &file, args.tip_force)?);
    }
    if details.real {
        for lack in file.missing_for_board() {
            report.push_str(&format!("  before the board arms: {lack}\n"));
        }
    }
    let temporary = args.on.warn_if_temporary();
    report.push_str(temporary);
    if temporary.is_empty() && board.scene()?.is_none() {
        report.push_str("next: `haptic scene FILE`, then `haptic home`\n");
    }
    let lacks = if details.real { file.missing_for_board() } else { Vec::new() };
    let document = json!({ "device": file.name, "port": board.port(), "lacks": lacks, "warnings": warnings });
    args.on.answer(document, &report)
}

/// Writes the board's data of its device, or reports their differences from a file.
fn read_back(args: &Args) -> Result<(), Failure> {
    let file = args.file.as_deref().map(DeviceFile::load).transpose()?;
    let device = args.on.open()?.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let about = [
        "Read back from a board, which keeps the coefficients of the equations of motion ([lumped]) and not the links",
        "that they came from. No device file: `haptic board backup` keeps the device.",
    ];
    let entries = device_entries(&device);
    let text = to_toml(&about.map(String::from), &entries);
    let compared = match &file {
        Some(file) => {
            let written = file.device::<f32>().map_err(Failure::wrong)?;
            let differences = compare(&device_entries(&written), &entries);
            if differences.is_empty() && written != device {
                let path = file.path.display();
                return Err(Failure::different(format!(
                    "the board's device is not the same as in {path}: it differs in numbers that no device file holds"
                ))
                .remedy("load a device file again, or keep the board's unchanged with `haptic board backup`"));
            }
            Some((&*file.path as &Path, differences))
        }
        None => None,
    };
    args.read.report(&args.on, "device", Ok(text), compared)
}

/// Returns the board's highest torque limit of a joint with these units, from its refusal of an infinite limit.
fn max_torque(board: &mut Board, units: &JointUnits) -> Option<f32> {
    let mut rules = board.rules().ok()?;
    rules.limits.torque[0] = f32::INFINITY;
    match board.set_rules(&rules) {
        Err(BoardError::Refused(Refusal::BadLimit(bad))) if bad.limit == Limit::Torque => Some(bad.most / units.lever),
        _ => None,
    }
}

/// Limits the force at the tip, lowers the torque limits to match in the home pose, and describes the result.
fn limit_force(board: &mut Board, file: &DeviceFile, newtons: Option<f32>) -> Result<String, Failure> {
    let before = board.rules()?;
    let newtons = newtons.unwrap_or(before.limits.tip_force.min(GENTLE_FORCE));
    let mut rules = before;
    rules.limits.tip_force = newtons;
    // Torques that make this force in addition to carrying the device.
    let needs: Vec<f32> = match Tip::at_home(&file.description) {
        Some(Ok(tip)) => tip.limits_for(newtons.into()).into_iter().map(|torque| torque as f32).collect(),
        _ => Vec::new(),
    };
    let units = file.description.units();
    for ((limit, needed), units) in rules.limits.torque.iter_mut().zip(&needs).zip(&units) {
        *limit = limit.min(*needed * units.lever);
    }
    if rules != before {
        board.set_rules(&rules)?;
        warn_of_weaker_rules(&before, &rules, &units);
    }
    let hidden = VOLTS_MARGIN * newtons;
    let faster = match Tip::at_home(&file.description) {
        Some(Ok(tip)) => {
            let speed = joint_units(&units, |joint| joint.speed);
            format!(" and {:.2} N more for each {speed}", tip.force(&torques_hidden_by_speed(&file.description)))
        }
        _ => String::new(),
    };
    let tip = format!(
        "  tip force: walls, springs and fields push with at most {newtons} N; a faulty current sensor may add at most \
         {hidden} N at rest{faster} unnoticed; `--tip-force` changes it\n"
    );
    let joints = file.spec().joints;
    let list = |torques: &[f32]| {
        let each: Vec<String> = torques.iter().take(joints).map(|torque| format!("{torque:.3}")).collect();
        each.join(", ")
    };
    let torques = rules.limits.in_units(&units).torque;
    let unit = joint_units(&units, |joint| joint.torque);
    let limits = format!("{} {unit}", list(&torques));
    // Keeps a limit that was lower before, because it may have been set on purpose.
    if torques.iter().zip(&needs).any(|(limit, needed)| *limit < 0.99 * needed) {
        let needs_in_words =
            format!("{newtons} N at the tip in the home pose, and the weight of the device, take {}", list(&needs));
        let beyond =
            needs.iter().zip(&units).find_map(|(needed, units)| max_torque(board, units).filter(|max| needed > max));
        return Ok(match beyond {
            Some(max) => format!(
                "{tip}  torque limits: {limits}; {needs_in_words}, and the board allows at most {max}: are lengths in \
                 the file in m and masses in kg? use a smaller `--tip-force`\n"
            ),
            None => format!(
                "{tip}  torque limits: {limits}, some were lower before; {needs_in_words}: \
                 `haptic rules --torque` raises them\n"
            ),
        });
    }
    if rules.limits.torque == before.limits.torque {
        return Ok(tip);
    }
    Ok(format!(
        "{tip}  torque limits: {limits}, for at most {newtons} N at the tip in the home pose in addition to the device's weight; \
         `haptic rules --torque` raises them\n"
    ))
}
