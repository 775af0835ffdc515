//! `haptic scene`: loads a scene file onto a board.

use super::port::Port;
use haptic::error::{Failure, print};
use haptic::link::BoardError;
use haptic::scene_file::SceneFile;
use haptic_bridge::guard::Refusal;
use std::path::PathBuf;

/// Load a scene (walls, springs, fields) onto a board
///
/// While the motors are armed a scene is taken only if it has the same control rate and its walls are not touched.
#[derive(clap::Args)]
pub struct Args {
    /// Scene file (TOML)
    file: PathBuf,
    #[command(flatten)]
    port: Port,
}

/// Checks the file against the board's device, then loads it.
pub fn run(args: Args) -> Result<(), Failure> {
    // What is wrong in any dimension is said without a board.
    let text = std::fs::read_to_string(&args.file)
        .map_err(|error| Failure::wrong(format!("{}: {error}", args.file.display())))?;
    let mut board = args.port.open()?;
    let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
    let task = device.mechanism.kind().spec().task;
    let file = SceneFile::parse(&text, &args.file, task)?;
    let scene =
        file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", args.file.display())))?;
    board.set_scene(&scene)?;
    print(&format!(
        "{} is loaded on {}: {} walls, {} springs, {} Hz control\n",
        args.file.display(),
        board.port(),
        scene.walls.len(),
        scene.springs.len(),
        scene.rate_hz
    ))
}
