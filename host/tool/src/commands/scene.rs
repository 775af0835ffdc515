//! `haptic scene`: loads a scene file onto a board, computed the cheapest way that is good enough.

use super::port::{OnBoard, scene_in_words};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, DEFAULT_PERCENT, plan};
use haptic_predict::plausible::{scene::doubts, warn};
use haptic_stability::analysis::prediction::Subject;
use serde_json::json;
use std::path::PathBuf;

/// Load a scene (walls, springs, fields) onto a board
///
/// Chooses the cheapest way to compute it that is good enough, which `haptic check` shows: no mass matrix for a scene
/// without feed-forward, no velocity terms where they do not count, a prepared mass matrix where that is cheaper and
/// good enough. While the motors are armed a scene is taken as the file has it, and only if it has the same control
/// rate and its walls are not touched.
#[derive(clap::Args)]
pub struct Args {
    /// Scene file (TOML)
    file: PathBuf,
    #[command(flatten)]
    on: OnBoard,
}

/// Checks the file against the board's device, plans, loads.
pub fn run(args: Args) -> Result<(), Failure> {
    // Errors that do not depend on the device's dimension are reported without a board.
    let document = Document::load(&args.file)?;
    let text = document.text();
    let mut board = args.on.open()?;
    let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let file = SceneFile::parse(text, &args.file, device.mechanism.kind().spec().task)?;
    let written = file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", args.file.display())))?;
    let name = args.file.display();
    let device = device.cast::<f64>();
    let (doubts, _) = doubts(&Subject::on_board(device.clone(), None), &file.scene);
    let warnings: Vec<_> = doubts.into_iter().map(|doubt| doubt.about(&document)).collect();
    warn(&warnings);
    if board.status()?.state == State::Armed {
        board.set_scene(&written)?;
        return args.on.answer(
            json!({ "scene": written, "planned": false, "warnings": warnings }),
            &loaded(&name.to_string(), &board, &written),
        );
    }
    let speed = file.hand_speed.unwrap_or(HAND_SPEED);
    let plan = plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed)?;
    let scene = plan.load(&mut board)?;
    let document = json!({
        "scene": scene, "planned": true, "model": plan.mass.name(), "terms": plan.terms.name(),
        "instructions": plan.instructions, "warnings": warnings,
    });
    args.on.answer(document, &loaded(&name.to_string(), &board, &scene))
}

fn loaded(file: &str, board: &Board, scene: &Scene<f32>) -> String {
    format!("{file} is loaded on {}: {}, {} Hz control\n", board.port(), scene_in_words(scene), scene.rate_hz)
}
