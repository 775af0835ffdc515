//! `haptic check`: checks a device file and scene files without a board, and shows the board's computation.

use super::answer::{Json, Pictures};
use super::port::counted;
use haptic_bridge::model::description::{Description, Homing};
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_host::words::{joint_units, with_unit};
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, DEFAULT_PERCENT, Plan, newtons, percent, plan};
use haptic_predict::plausible::scene::Contact;
use haptic_predict::plausible::{Warning, device, scene, warn};
use haptic_predict::summary::Summary;
use haptic_predict::template::MOTORS_AND_ENCODERS;
use haptic_predict::tip::{Tip, board_speeds, motor_torques};
use haptic_show::plot::Picture;
use haptic_show::plot::device::draw;
use haptic_show::plot::paper::Paper;
use haptic_stability::analysis::prediction::Subject;
use haptic_stability::analysis::range::COSTLY_RATIO;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Check a device file, and scene files for that device
///
/// Stops at the first file that is wrong and prints the line and the remedy. For a correct device file it also prints
/// the description (reach, force and inertia at the tip), probable mistakes (on standard error; the exit code stays 0),
/// and what is missing before a real board arms. For a correct scene it prints the stiffness up to which its walls are
/// predicted stable, and the board's computation: the one with the fewest instructions that is accurate enough, at the
/// poses in which its walls can be touched and at the speed of a hand. --svg draws the device at home: links, joints
/// with their zero angles and directions, reach.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Scene files (TOML) to check against the device
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    #[command(flatten)]
    pictures: Pictures,
    #[command(flatten)]
    json: Json,
}

#[derive(serde::Serialize)]
struct Report {
    path: String,
    name: String,
    mechanism: &'static str,
    joints: usize,
    task: usize,
    /// Names of the encoders without motors.
    sensed: Vec<String>,
    summary: Summary,
    lacks: Vec<String>,
    scenes: Vec<SceneReport>,
    warnings: Vec<Warning>,
}

#[derive(serde::Serialize)]
struct SceneReport {
    path: String,
    walls: usize,
    springs: usize,
    /// Damping of all fields together, N s/m.
    field_damping: f64,
    rate_hz: f64,
    entered_at_home: Vec<usize>,
    contacts: Vec<Contact>,
    /// Computation that the board will use; `None` if it cannot be planned.
    plan: Option<Value>,
    /// The plan in words, or the reason why there is no plan.
    #[serde(skip)]
    planned: String,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let document = Document::load(&args.device)?;
    let file = DeviceFile::read(&document)?;
    let spec = file.spec();
    let mut warnings: Vec<Warning> =
        device::file_warnings(&file).into_iter().map(|doubt| doubt.locate_in(&document)).collect();
    let mut scenes = Vec::new();
    for path in &args.scenes {
        let (scene, scene_warnings) = scene_report(path, &file)?;
        scenes.push(scene);
        warnings.extend(scene_warnings);
    }
    let summary = Summary::of(&file)?;
    if args.pictures.is_requested() {
        args.pictures.save(&picture(&file, &summary, args.pictures.paper())?)?;
    }
    warn(&warnings);
    let report = Report {
        path: args.device.display().to_string(),
        name: file.name.clone(),
        mechanism: spec.name,
        joints: spec.joints,
        task: spec.task,
        sensed: file.sensed_names.clone(),
        summary,
        lacks: file.missing_for_board(),
        scenes,
        warnings,
    };
    let tip_and_home = tip_in_words(&file.description) + homing_in_words(&file.description);
    args.json.answer(&report, &readable(&report, &tip_and_home))
}

fn scene_report(path: &Path, device: &DeviceFile) -> Result<(SceneReport, Vec<Warning>), Failure> {
    let document = Document::load(path)?;
    let file = SceneFile::read(&document, device.spec().task)?;
    file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
    let subject = Subject::new(&device.description).map_err(Failure::wrong)?;
    let (mut warnings, mut contacts) = scene::file_warnings(&subject, &file.scene);
    for contact in &mut contacts {
        warnings.extend(scene::simulate_ripple(&device.description, &file.scene, contact));
    }
    let speed = file.hand_speed.unwrap_or(HAND_SPEED);
    let planned = device
        .device()
        .map_err(Failure::wrong)
        .and_then(|device| plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed));
    let (plan, planned) = match planned {
        Ok(plan) => (Some(plan_as_json(&plan)), plan_in_words(&plan)),
        Err(failure) => (None, format!("  a board cannot compute it: {failure}\n")),
    };
    let report = SceneReport {
        path: path.display().to_string(),
        walls: file.scene.walls.len(),
        springs: file.scene.springs.len(),
        field_damping: file.scene.field_damping,
        rate_hz: file.scene.rate_hz,
        entered_at_home: device.description.home.map(|home| file.walls_entered(device, &home)).unwrap_or_default(),
        contacts,
        plan,
        planned,
    };
    Ok((report, warnings.into_iter().map(|warning| warning.locate_in(&document)).collect()))
}

fn plan_as_json(plan: &Plan) -> Value {
    json!({
        "terms": plan.terms.name(), "instructions": plan.instructions, "errors": plan.errors,
        "reasons": plan.reasons, "candidates": plan.candidates,
    })
}

/// Describes the chosen computation with its cost, its error and the reasons.
fn plan_in_words(plan: &Plan) -> String {
    let mut text = format!(
        "  a board will compute terms {}: {} instructions a control step at the slowest pose\n  \
         error left: {} at the tip nearly everywhere, at worst {} of the motors' torque ({:.1} steps of the duty)\n",
        plan.terms.name(),
        plan.instructions,
        newtons(plan.errors.force.most),
        percent(plan.errors.share.max),
        plan.errors.duty.max
    );
    for reason in &plan.reasons {
        text.push_str(&format!("  - {reason}\n"));
    }
    text
}

fn picture(file: &DeviceFile, summary: &Summary, paper: Paper) -> Result<Picture, Failure> {
    let no_pose = || Failure::wrong(format!("{} has no [home], so there is no pose to draw", file.path.display()));
    let home = file.description.home.ok_or_else(|| no_pose().remedy("add [home] q"))?;
    let drawn = draw(&file.description, &file.name, &home[..file.spec().joints], &summary.lines(), paper)?;
    drawn.ok_or_else(|| Failure::impossible("the linkage does not close at home"))
}

fn readable(report: &Report, tip_and_home: &str) -> String {
    let mut text = format!(
        "{}: sound: {}, {}{} of {} and {}\n",
        report.path,
        report.name,
        if report.mechanism == "paddles" { "" } else { "a " },
        report.mechanism,
        counted(report.joints, "joint"),
        counted(report.task, "task direction"),
    );
    for line in report.summary.lines() {
        text.push_str(&format!("  {line}\n"));
    }
    if !report.sensed.is_empty() {
        text.push_str(&format!("  encoders without motors: {}\n", report.sensed.join(", ")));
    }
    text.push_str(tip_and_home);
    text.push_str(&format!("  {MOTORS_AND_ENCODERS}\n"));
    for lack in &report.lacks {
        text.push_str(&format!("  before a real board arms: {lack}\n"));
    }
    for scene in &report.scenes {
        let field = match scene.field_damping {
            0.0 => String::new(),
            damping => format!(", fields of {}", with_unit(damping, "N s/m")),
        };
        text.push_str(&format!(
            "{}: sound: {}, {}{field} at {} Hz\n",
            scene.path,
            counted(scene.walls, "wall"),
            counted(scene.springs, "spring"),
            scene.rate_hz,
        ));
        for contact in &scene.contacts {
            let force =
                contact.force.map_or(String::new(), |force| format!("; the motors allow {}", with_unit(force, "N")));
            let felt = |felt: Option<f64>| {
                felt.map_or(String::new(), |felt| format!(" (felt at the tip: {})", with_unit(felt, "N/m")))
            };
            let off = match contact.off_to {
                Some(off) if contact.stable_to < COSTLY_RATIO * off => {
                    format!(" ({} without its feed-forward, which costs more than it brings)", with_unit(off, "N/m"))
                }
                _ => String::new(),
            };
            let ripple = contact
                .ripple_n
                .map_or(String::new(), |ripple| format!("; ripples by {} rms under a hand", with_unit(ripple, "N")));
            text.push_str(&format!(
                "  wall {}: {}{}, predicted stable up to {}{}{off} with its damping, up to {} damping{ripple}{force}\n",
                contact.wall,
                with_unit(contact.stiffness, "N/m"),
                felt(contact.felt),
                with_unit(contact.stable_to, "N/m"),
                felt(contact.felt_to),
                with_unit(contact.damping_to, "N s/m"),
            ));
            if let Some(held) = contact.in_hand {
                let buzz = match (contact.buzz, contact.hz) {
                    (Some(buzz), _) => format!("; it buzzes at about {:.0} Hz", buzz.hz),
                    (None, Some(hz)) => format!("; a stiffer one buzzes at about {hz:.0} Hz"),
                    _ => String::new(),
                };
                text.push_str(&format!("    in {held} up to {}{buzz}\n", with_unit(held.stable_to, "N/m")));
            }
            text.push_str(&format!("    the same with: haptic range {} {}\n", report.path, contact.options));
        }
        text.push_str(&scene.planned);
        for wall in &scene.entered_at_home {
            text.push_str(&format!("  the home pose is inside wall {wall}: a board will not arm there\n"));
        }
    }
    text
}

/// Describes how a board learns the joint angles.
fn homing_in_words(description: &Description) -> &'static str {
    match description.homing {
        _ if description.home.is_none() => "",
        Homing::Hand => "  homed by hand: `haptic home` declares the home pose\n",
        Homing::Index => "  homed by index marks: move each joint slowly over its mark while `haptic home` waits\n",
        Homing::Stop(_) => {
            "  homed by stops: `haptic home` roughly in the home pose, `haptic polarity`, then `haptic home --key`\n"
        }
    }
}

/// Describes the force and the energy that a person at the tip can meet.
fn tip_in_words(description: &Description) -> String {
    let motors = motor_torques(description);
    match Tip::at_home(description) {
        Some(Ok(tip)) if motors.iter().any(|torque| *torque > 0.0) => {
            let (speed, units) = (board_speeds(description), description.units());
            let mut speeds: Vec<String> =
                speed.iter().zip(&units).map(|(speed, of)| format!("{speed} {}", of.speed)).collect();
            speeds.dedup();
            let spec = description.kind.spec();
            let moment = if spec.joints > spec.task { ", with a moment in addition" } else { "" };
            let joints: Vec<String> =
                tip.limits_for(GENTLE_FORCE.into()).iter().map(|torque| format!("{torque:.3}")).collect();
            format!(
                "  at the home pose its motors make up to {:.1} N at the tip{moment}; a real board limits walls to \
                 {GENTLE_FORCE} N by default, and `haptic device` sets its torque limits for that force and the device's weight ({} {}); at {}, the default speed limit of a real board, its links carry {:.2} J\n",
                tip.force(&motors),
                joints.join(", "),
                joint_units(&units, |joint| joint.torque),
                speeds.join(" and "),
                tip.energy(&speed)
            )
        }
        _ => String::new(),
    }
}
