//! `haptic scene`: loads a scene file onto a board in the cheapest accurate form, or reads the scene back.

use super::port::{OnBoard, scene_in_words};
use super::read_back::{ReadOptions, required_file};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::read_back::{differences as compare, scene as to_entries, to_toml};
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, DEFAULT_PERCENT, plan};
use haptic_predict::plausible::{scene::file_warnings, warn};
use haptic_stability::analysis::prediction::Subject;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Load a scene (walls, springs, fields) onto a board, or read it back
///
/// Chooses the cheapest sufficiently accurate computation, which `haptic check` shows: no mass matrix for a scene
/// without feed-forward, no velocity terms if they are negligible. While the motors are armed a scene is loaded as it is in the file, and only if it has the same
/// control rate and its walls are not touched.
///
/// The output of --read gives a board the same scene to the bit. A comparison with FILE ignores a feed-forward and
/// velocity terms that this command left out because they have no benefit.
#[derive(clap::Args)]
pub struct Args {
    /// Scene file (TOML)
    #[arg(required_unless_present = "read")]
    file: Option<PathBuf>,
    #[command(flatten)]
    read: ReadOptions,
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    if args.read.is_requested()? {
        return read_back(&args);
    }
    let path = required_file(args.file.as_ref(), "scene")?;
    // Reports errors that do not depend on the device before a board is opened.
    let document = Document::load(&path)?;
    let text = document.text();
    let mut board = args.on.open()?;
    let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let file = SceneFile::parse(text, &path, device.mechanism.kind().spec().task)?;
    let written = file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
    let name = path.display();
    let device = device.cast::<f64>();
    let (file_warnings, _) = file_warnings(&Subject::on_board(device.clone(), None), &file.scene);
    let warnings: Vec<_> = file_warnings.into_iter().map(|doubt| doubt.locate_in(&document)).collect();
    warn(&warnings);
    if board.status()?.state == State::Armed {
        board.set_scene(&written)?;
        return args.on.answer(
            json!({ "scene": written, "planned": false, "warnings": warnings }),
            &(loaded_message(&name.to_string(), &board, &written) + args.on.warn_if_temporary()),
        );
    }
    let speed = file.hand_speed.unwrap_or(HAND_SPEED);
    let plan = plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed)?;
    let scene = plan.load(&mut board)?;
    let document = json!({
        "scene": scene, "planned": true, "terms": plan.terms.name(),
        "instructions": plan.instructions, "warnings": warnings,
    });
    args.on.answer(document, &(loaded_message(&name.to_string(), &board, &scene) + args.on.warn_if_temporary()))
}

/// Writes the board's scene as a file, or reports its differences from a file.
fn read_back(args: &Args) -> Result<(), Failure> {
    let document = args.file.as_deref().map(Document::load).transpose()?;
    let mut board = args.on.open()?;
    let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
    let about = "Read back from a board, which does not store hand_speed.".to_string();
    let entries = to_entries(&scene);
    let text = to_toml(&[about], &entries);
    let same = SceneFile::parse(&text, "the scene that was read", scene.task.into())
        .is_ok_and(|file| file.scene::<f32>().is_ok_and(|read| read == scene));
    let text = same.then_some(text).ok_or_else(|| {
        Failure::impossible("a scene file cannot hold the board's scene exactly")
            .remedy("save it unchanged with `haptic board backup`")
    });
    let compared = match &document {
        Some(document) => {
            let file = SceneFile::read(document, scene.task.into())?;
            let written = file.scene::<f32>().map_err(Failure::wrong)?;
            let mut differences = compare(&to_entries(&written), &entries);
            let is_planned = |key: &str| key == "velocity_terms" || key.ends_with(" feed_forward");
            if differences.iter().any(|difference| is_planned(&difference.key)) {
                let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?.cast::<f64>();
                let speed = file.hand_speed.unwrap_or(HAND_SPEED);
                // Reports every difference if planning fails, because `haptic scene` then did not load this scene.
                if let Ok(plan) = plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed) {
                    let from_plan = compare(&to_entries(&plan.scene.cast()), &entries);
                    differences.retain(|difference| {
                        !is_planned(&difference.key) || from_plan.iter().any(|other| other.key == difference.key)
                    });
                }
            }
            Some((document.path() as &Path, differences))
        }
        None => None,
    };
    args.read.report(&args.on, "scene", text, compared)
}

fn loaded_message(file: &str, board: &Board, scene: &Scene<f32>) -> String {
    format!("{file} is loaded on {}: {}, {} Hz control\n", board.port(), scene_in_words(scene), scene.rate_hz)
}
