//! `haptic plan`: the cheapest model of a device that a scene needs.

use super::answer::Json;
use clap::builder::NonEmptyStringValueParser;
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_predict::analysis::prediction::Subject;
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, DEFAULT_PERCENT, Plan, newtons, percent, plan};
use haptic_predict::plausible::{scene::doubts, warn};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Choose the cheapest model of a device that a scene needs
///
/// Looks at which walls can be touched where, how hard the motors push there and how fast a hand moves, and picks the
/// way of computing the control step that takes the fewest instructions within the error budget. `haptic scene` does
/// the same before it sends a scene.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Scene file (TOML)
    scene: PathBuf,
    /// Allowed error: percent of what the motors give, or `one-duty-step` [default: 1]
    #[arg(long, value_name = "PERCENT|one-duty-step", value_parser = NonEmptyStringValueParser::new())]
    error: Option<String>,
    /// Fastest motion of the hand, m/s [default: the scene's hand_speed, or 0.5]
    #[arg(long, value_name = "M/S")]
    speed: Option<f64>,
    #[command(flatten)]
    json: Json,
}

/// Reads a budget: a percentage or `one-duty-step`.
pub fn budget(text: Option<&str>) -> Result<Budget, Failure> {
    match text {
        None => Ok(Budget::Percent(DEFAULT_PERCENT)),
        Some("one-duty-step") => Ok(Budget::OneDutyStep),
        Some(text) => match text.trim_end_matches('%').trim().parse::<f64>() {
            Ok(percent) if percent > 0.0 && percent.is_finite() => Ok(Budget::Percent(percent)),
            _ => Err(Failure::wrong(format!("--error {text} is neither a percentage above zero nor one-duty-step"))
                .remedy("write a number such as 0.5, or one-duty-step")),
        },
    }
}

/// How fast the hand is taken to move, m/s: as asked for, else as the scene says.
pub fn speed(asked: Option<f64>, scene: &SceneFile) -> Result<f64, Failure> {
    let speed = asked.or(scene.hand_speed).unwrap_or(HAND_SPEED);
    if !(speed >= 0.0 && speed.is_finite()) {
        return Err(Failure::wrong(format!("--speed {speed} is not a speed")).remedy("write m/s, 0 or more"));
    }
    Ok(speed)
}

/// Plans and prints.
pub fn run(args: Args) -> Result<(), Failure> {
    let file = DeviceFile::load(&args.device)?;
    let device = file.device().map_err(Failure::wrong)?;
    let document = Document::load(&args.scene)?;
    let scene = SceneFile::read(&document, file.spec().task)?;
    // A scene names no device: that it was made for another shows in walls that this one does not reach.
    let (doubts, _) = doubts(&Subject::new(&file.description).map_err(Failure::wrong)?, &scene.scene);
    let warnings: Vec<_> = doubts.into_iter().map(|doubt| doubt.about(&document)).collect();
    warn(&warnings);
    let plan = plan(&device, &scene.scene, budget(args.error.as_deref())?, speed(args.speed, &scene)?)?;
    if args.json.asked() {
        return print_json(json!({
            "device": device.name,
            "model": plan.mass.name(),
            "terms": plan.terms.name(),
            "instructions": plan.instructions,
            "table_bytes": plan.mass.bytes(),
            "errors": plan.errors,
            "reasons": plan.reasons,
            "candidates": plan.candidates,
            "warnings": warnings,
        }));
    }
    print(&readable(&device, &plan))
}

/// The choice with its cost, its error and the reasons for it.
pub fn readable(device: &Device<f64>, plan: &Plan) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "{}: {}, mass matrix {}", device.name, plan.terms.name(), plan.mass.name());
    let _ = writeln!(text, "  {} instructions a control step on the Cortex-M4F (slowest pose)", plan.instructions);
    if plan.mass.bytes() > 0 {
        let _ = writeln!(text, "  {} bytes of table", plan.mass.bytes());
    }
    let _ = writeln!(
        text,
        "  error left: {} at the tip nearly everywhere, at worst {} of what the motors give ({:.1} steps of the duty)",
        newtons(plan.errors.force.most),
        percent(plan.errors.share.max),
        plan.errors.duty.max
    );
    for reason in &plan.reasons {
        let _ = writeln!(text, "  - {reason}");
    }
    if !plan.candidates.is_empty() {
        let _ = writeln!(
            text,
            "\n  {:<12}{:<18}{:>14}{:>18}{:>18}{:>18}",
            "matrix", "terms", "instructions", "99 % below", "at worst", "beside the fade"
        );
        for way in &plan.candidates {
            let chosen = way.model == plan.mass.name() && way.terms == plan.terms.name();
            let _ = writeln!(
                text,
                "{} {:<12}{:<18}{:>14}{:>18}{:>18}{:>18}",
                if chosen { ">" } else { " " },
                way.model,
                way.terms,
                way.instructions,
                newtons(way.errors.force.most),
                percent(way.errors.share.max),
                percent(way.given.share.max)
            );
        }
    }
    text
}
