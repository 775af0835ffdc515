//! Installs the archive and the wheel as a user does, and runs the demo of each without access to other programs.

use std::env;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use super::{ReleaseFiles, create_empty, make, output};
use crate::firmware::BOARDS;
use crate::paths::target_directory;
use crate::toolchain::run;
use crate::{publish, python};

/// Makes and checks the archive, the wheel and the packages for the registry.
pub fn check() -> Result<()> {
    let made = make()?;
    let scratch = target_directory().join("dist-check");
    create_empty(&scratch)?;
    check_archive(&made, &scratch.join("archive"))?;
    check_wheel(&made, &scratch.join("wheel"))?;
    fs::remove_dir_all(&scratch).with_context(|| format!("cannot remove {}", scratch.display()))?;
    publish::dry_run()
}

fn check_archive(made: &ReleaseFiles, place: &Path) -> Result<()> {
    create_empty(place)?;
    run(Command::new("tar").arg("-xzf").arg(&made.archive).arg("-C").arg(place))?;
    let entries = fs::read_dir(place)?.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let [folder] = &entries[..] else { anyhow::bail!("the archive unpacks to {entries:?}, not to one folder") };
    for path in [
        "README.txt",
        "LICENSE-MIT",
        "LICENSE-APACHE",
        "LICENSES-OTHERS.txt",
        "70-haptic-bridge.rules",
        "completions/haptic.bash",
        "completions/_haptic",
        "man/man1/haptic.1",
        "man/man1/haptic-demo.1",
        "docs/bring-up.md",
        "haptic-page.html",
    ] {
        let bytes = fs::metadata(folder.join(path)).with_context(|| format!("the archive has no {path}"))?.len();
        ensure!(bytes > 500, "{path} in the archive has only {bytes} bytes");
    }
    check_tool(folder, place)?;
    let known = output(isolated_tool(folder, place).args(["check"]).arg(folder.join("devices/haply-2diy.toml")))?;
    ensure!(known.contains("five-bar"), "{known}");
    // For an unknown board the tool lists the boards of its images.
    let output =
        isolated_tool(folder, place).args(["flash", "no-such-board"]).output().context("cannot run haptic flash")?;
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    ensure!(BOARDS.iter().all(|board| message.contains(board)), "the tool lacks the image of a board: {message}");
    Ok(())
}

fn check_wheel(made: &ReleaseFiles, place: &Path) -> Result<()> {
    create_empty(place)?;
    let environment = place.join("environment");
    let python = python::environment(&environment, &[made.wheel.to_string_lossy().into_owned()])?;
    let programs = python.parent().context("the interpreter's path has no folder")?;
    check_tool(programs, place)?;
    let program =
        "import haptic_bridge as hb\nwith hb.Board('sim') as board: print(len(board.look().tip), hb.__version__)";
    let printed = output(Command::new(&python).current_dir(place).args(["-c", program]))?;
    ensure!(printed == format!("3 {}\n", super::version()?), "the package printed {printed}");
    Ok(())
}

fn check_tool(folder: &Path, place: &Path) -> Result<()> {
    let version = output(isolated_tool(folder, place).arg("--version"))?;
    ensure!(version == format!("haptic {}\n", super::version()?), "the tool's version is {version}");
    let table = output(isolated_tool(folder, place).arg("demo"))?;
    ensure!(table.contains("picture: "), "the demo printed {table}");
    let picture = fs::read_to_string(place.join("haptic-demo.svg")).context("the demo drew no picture")?;
    ensure!(picture.contains("</svg>"), "the demo's picture has no end");
    println!("{}: the demo ran", folder.display());
    Ok(())
}

/// Returns a call of the tool in a folder, without access to other programs, settings or a home directory.
fn isolated_tool(folder: &Path, place: &Path) -> Command {
    let mut command = Command::new(folder.join(format!("haptic{}", env::consts::EXE_SUFFIX)));
    command.current_dir(place).env_clear().env("PATH", folder);
    if let Some(windows) = env::var_os("SYSTEMROOT") {
        command.env("SYSTEMROOT", windows);
    }
    command
}
