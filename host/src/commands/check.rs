//! `haptic check`: says whether a device file and scene files for it are sound, without a board.

use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use haptic::scene_file::SceneFile;
use std::path::PathBuf;

/// Check a device file, and scene files for that device
///
/// Stops at the first file that is wrong and names the line and the remedy. Says also what a sound file still lacks
/// before a real board arms.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Scene files (TOML) to check against the device
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
}

/// Checks every file.
pub fn run(args: Args) -> Result<(), Failure> {
    let device = DeviceFile::load(&args.device)?;
    let spec = device.spec();
    let mut report = format!(
        "{}: sound: {}, a {} of {} and {}\n",
        args.device.display(),
        device.name,
        spec.name,
        counted(spec.joints, "joint"),
        counted(spec.task, "task direction"),
    );
    for lack in device.lacks_for_a_board() {
        report.push_str(&format!("  before a real board arms: {lack}\n"));
    }
    for path in args.scenes {
        let file = SceneFile::load(&path, spec.task)?;
        file.scene::<f32>().map_err(|error| Failure::wrong(format!("{}: {error}", path.display())))?;
        let scene = &file.scene;
        report.push_str(&format!(
            "{}: sound: {}, {} at {} Hz\n",
            path.display(),
            counted(scene.walls.len(), "wall"),
            counted(scene.springs.len(), "spring"),
            scene.rate_hz,
        ));
        let entered = device.description.home.map(|home| file.walls_entered(&device, &home)).unwrap_or_default();
        for wall in entered {
            report.push_str(&format!("  the home pose is inside [[wall]] {wall}: a board will not arm there\n"));
        }
    }
    print(&report)
}

fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
