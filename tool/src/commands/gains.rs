//! `haptic gains`: shows or changes stiffness, damping, feed-forward and cutoff, also while a wall is touched.

use super::arguments;
use super::port::{OnBoard, counted, feed_forward_in_words, short};
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::{FeedForward, Scene, VelocityTerms};
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_predict::boards::torque_path;
use haptic_predict::plausible::scene::{self, contact_limits_at};
use haptic_predict::plausible::{FileWarning, Warning, warn};
use haptic_stability::analysis::prediction::Subject;
use serde_json::json;

/// Show or change the gains of a wall, also while it is touched
///
/// Gains without an option stay as they are. `haptic board save` keeps the gains over a power cycle.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Index of the wall, from 0, in the order of the scene file
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    wall: u8,
    /// Stiffness in N/m
    #[arg(long, value_name = "N/M", value_parser = parse_gain, allow_hyphen_values = true)]
    stiffness: Option<f32>,
    /// Damping in N s/m
    #[arg(long, value_name = "N S/M", value_parser = parse_gain, allow_hyphen_values = true)]
    damping: Option<f32>,
    /// Feed-forward of the wall's force
    #[arg(long, value_name = "KIND", value_parser = arguments::feed_forward_parser())]
    feed_forward: Option<FeedForward>,
    /// Corner of the washout in Hz
    #[arg(long, value_name = "HZ", value_parser = parse_gain, allow_hyphen_values = true)]
    washout: Option<f32>,
    /// Cutoff of the velocity filters of all walls in Hz
    #[arg(long, value_name = "HZ", value_parser = parse_gain, allow_hyphen_values = true)]
    cutoff: Option<f32>,
}

fn parse_gain(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        Ok(_) => Err("must be finite and not negative".into()),
        Err(_) => Err("not a number".into()),
    }
}

/// Returns warnings about gains that the loop or the motors cannot render at the present pose; before homing, at home.
fn warnings_at_present_pose(board: &mut Board, scene: &Scene<f32>, index: usize) -> Result<Vec<Warning>, Failure> {
    let (Some(device), status, details) = (board.device()?, board.status()?, board.details()?) else {
        return Ok(Vec::new());
    };
    let (device, scene) = (device.cast::<f64>(), scene.cast::<f64>());
    let q = match device.home {
        Some(home) if !status.homed => home,
        _ => status.q.map(f64::from),
    };
    let axes = device.axes();
    let (subject, path) = (Subject::on_board(device, None), torque_path(board.info(), &details));
    let Some(contact) = contact_limits_at(&subject, &scene, index, &q[..axes], &path) else {
        return Ok(Vec::new());
    };
    Ok(scene::gain_warnings(&scene.walls[index], &contact, false)
        .into_iter()
        .map(FileWarning::for_command_line)
        .collect())
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
    let Some(wall) = scene.walls.get(usize::from(args.wall)) else {
        let reason = format!("the scene has {}, so there is no wall {}", counted(scene.walls.len(), "wall"), args.wall);
        return Err(Failure::wrong(reason).remedy("count from 0 in the order of the scene file"));
    };
    let gains = Gains {
        wall: args.wall,
        stiffness: args.stiffness.unwrap_or(wall.stiffness),
        damping: args.damping.unwrap_or(wall.damping),
        feed_forward: args.feed_forward.unwrap_or(wall.feed_forward),
        washout_hz: args.washout.unwrap_or(wall.washout_hz),
    };
    let is_changed =
        args.stiffness.is_some() || args.damping.is_some() || args.feed_forward.is_some() || args.washout.is_some();
    if is_changed {
        board.set_wall_gains(gains)?;
    }
    if let Some(cutoff) = args.cutoff {
        board.set_estimator(scene.estimator, cutoff)?;
    }
    let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
    let Some(wall) = scene.walls.get(usize::from(args.wall)) else {
        return Err(BoardError::Refused(Refusal::NoScene).into());
    };
    let warnings = if is_changed || args.cutoff.is_some() {
        warnings_at_present_pose(&mut board, &scene, usize::from(args.wall))?
    } else {
        Vec::new()
    };
    warn(&warnings);
    let filter = match scene.estimator {
        Estimator::Butterworth => format!("Butterworth filter at {} Hz", short(scene.cutoff_hz)),
        Estimator::BackwardDifference => "no filter".into(),
        other => format!("{} filter at {} Hz", other.name(), short(scene.cutoff_hz)),
    };
    if wall.feed_forward != FeedForward::Off && scene.velocity_terms == VelocityTerms::Off {
        haptic_host::tell!(
            "the feed-forward has no velocity terms, because this scene was loaded without them; `haptic scene FILE` plans them again"
        );
    }
    let words = format!(
        "wall {}: stiffness {} N/m, damping {} N s/m, feed-forward {}; {filter}, control at {} Hz\n",
        args.wall,
        short(wall.stiffness),
        short(wall.damping),
        feed_forward_in_words(wall),
        short(scene.rate_hz)
    );
    let document = json!({
        "wall": args.wall, "stiffness": wall.stiffness, "damping": wall.damping, "feed_forward": wall.feed_forward,
        "washout_hz": wall.washout_hz, "estimator": scene.estimator, "cutoff_hz": scene.cutoff_hz,
        "rate_hz": scene.rate_hz, "warnings": warnings,
    });
    args.on.answer(document, &words)
}
