//! `haptic scene`: loads a scene file onto a board, computed the cheapest way that is good enough, or reads the board's
//! back.

use super::port::{OnBoard, scene_in_words};
use super::read_back::{Read, needed};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use haptic_host::read_back::{self, differences, to_toml};
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_predict::bench::probe::HAND_SPEED;
use haptic_predict::plan::{Budget, DEFAULT_PERCENT, plan};
use haptic_predict::plausible::{scene::doubts, warn};
use haptic_stability::analysis::prediction::Subject;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Load a scene (walls, springs, fields) onto a board, or read it back
///
/// Chooses the cheapest way to compute it that is good enough, which `haptic check` shows: no mass matrix for a scene
/// without feed-forward, no velocity terms where they do not count, a prepared mass matrix where that is cheaper and
/// good enough. While the motors are armed a scene is taken as the file has it, and only if it has the same control
/// rate and its walls are not touched.
///
/// What --read writes gives a board the same scene to the bit. A feed-forward and velocity terms that this command left
/// out of FILE as of no use are no difference to it.
#[derive(clap::Args)]
pub struct Args {
    /// Scene file (TOML)
    #[arg(required_unless_present = "read")]
    file: Option<PathBuf>,
    #[command(flatten)]
    read: Read,
    #[command(flatten)]
    on: OnBoard,
}

/// Checks the file against the board's device, plans, loads.
pub fn run(args: Args) -> Result<(), Failure> {
    if args.read.asked()? {
        return read(&args);
    }
    let path = needed(args.file.as_ref(), "scene")?;
    // Errors that do not depend on the device's dimension are reported without a board.
    let document = Document::load(&path)?;
    let text = document.text();
    let mut board = args.on.open()?;
    let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let file = SceneFile::parse(text, &path, device.mechanism.kind().spec().task)?;
    let written = file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
    let name = path.display();
    let device = device.cast::<f64>();
    let (doubts, _) = doubts(&Subject::on_board(device.clone(), None), &file.scene);
    let warnings: Vec<_> = doubts.into_iter().map(|doubt| doubt.about(&document)).collect();
    warn(&warnings);
    if board.status()?.state == State::Armed {
        board.set_scene(&written)?;
        return args.on.answer(
            json!({ "scene": written, "planned": false, "warnings": warnings }),
            &(loaded(&name.to_string(), &board, &written) + args.on.what_is_left()),
        );
    }
    let speed = file.hand_speed.unwrap_or(HAND_SPEED);
    let plan = plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed)?;
    let scene = plan.load(&mut board)?;
    let document = json!({
        "scene": scene, "planned": true, "model": plan.mass.name(), "terms": plan.terms.name(),
        "instructions": plan.instructions, "warnings": warnings,
    });
    args.on.answer(document, &(loaded(&name.to_string(), &board, &scene) + args.on.what_is_left()))
}

/// The board's scene as a file, or what differs there from a file.
fn read(args: &Args) -> Result<(), Failure> {
    let document = args.file.as_deref().map(Document::load).transpose()?;
    let mut board = args.on.open()?;
    let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
    let about = "Read back from a board. It does not keep hand_speed.".to_string();
    let entries = read_back::scene(&scene);
    let text = to_toml(&[about], &entries);
    let same = SceneFile::parse(&text, "what was read", scene.task.into())
        .is_ok_and(|file| file.scene::<f32>().is_ok_and(|read| read == scene));
    let text = same.then_some(text).ok_or_else(|| {
        Failure::impossible("no scene file gives a board exactly this scene")
            .remedy("`haptic board backup` keeps it as it is")
    });
    let compared = match &document {
        Some(document) => {
            let file = SceneFile::read(document, scene.task.into())?;
            let written = file.scene::<f32>().map_err(Failure::wrong)?;
            let mut found = differences(&read_back::scene(&written), &entries);
            let planned = |key: &str| key == "velocity_terms" || key.ends_with(" feed_forward");
            if found.iter().any(|difference| planned(&difference.key)) {
                let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?.cast::<f64>();
                let speed = file.hand_speed.unwrap_or(HAND_SPEED);
                // A scene that cannot be planned was not loaded by this command.
                if let Ok(plan) = plan(&device, &file.scene, Budget::Percent(DEFAULT_PERCENT), speed) {
                    let from_plan = differences(&read_back::scene(&plan.scene.cast()), &entries);
                    found.retain(|difference| {
                        !planned(&difference.key) || from_plan.iter().any(|other| other.key == difference.key)
                    });
                }
            }
            Some((document.path() as &Path, found))
        }
        None => None,
    };
    args.read.answer(&args.on, "scene", text, compared)
}

fn loaded(file: &str, board: &Board, scene: &Scene<f32>) -> String {
    format!("{file} is loaded on {}: {}, {} Hz control\n", board.port(), scene_in_words(scene), scene.rate_hz)
}
