//! Checks the crates that programs build on: they compile without the tool, and bring along nothing that only the tool
//! needs.

use std::collections::BTreeSet;

use anyhow::{Result, bail, ensure};

use crate::paths::root;
use crate::toolchain::{cargo, run};

/// The crates below the tool, from the ground up.
pub const CRATES: [&str; 6] =
    ["haptic-host", "haptic-flash", "haptic-sim", "haptic-stability", "haptic-predict", "haptic-show"];

/// Crates that only the tool needs.
const TOOL: &[&str] =
    &["clap", "clap_complete", "clap_mangen", "ctrlc", "dejavu", "indicatif", "ratatui", "resvg", "tungstenite"];
/// Crates that recordings, drawings and the page need.
const SHOWING: &[&str] = &["haptic-show", "mcap", "prost-reflect"];
/// Crates that compute which walls are stable, and that measure, tune and design with it.
const THEORY: &[&str] = &["haptic-stability"];
const PREDICTING: &[&str] = &["haptic-predict"];
/// Crates that take the place of a board.
const SIMULATING: &[&str] = &["haptic-sim"];
/// Crates that flash boards.
const FLASHING: &[&str] = &["haptic-flash", "nusb"];

/// Who does without what.
const WITHOUT: [(&str, &[&[&str]]); 9] = [
    ("haptic-host", &[TOOL, SHOWING, PREDICTING, THEORY, SIMULATING, FLASHING]),
    ("haptic-flash", &[TOOL, SHOWING, PREDICTING, THEORY, SIMULATING]),
    ("haptic-sim", &[TOOL, SHOWING, PREDICTING, THEORY, FLASHING]),
    ("haptic-stability", &[TOOL, SHOWING, PREDICTING, SIMULATING, FLASHING]),
    ("haptic-predict", &[TOOL, SHOWING, FLASHING]),
    ("haptic-show", &[FLASHING]),
    ("haptic-c", &[TOOL, SHOWING, PREDICTING, THEORY, FLASHING]),
    ("haptic-chai3d", &[TOOL, SHOWING, PREDICTING, FLASHING]),
    ("haptic-python", &[TOOL, FLASHING]),
];

/// Checks both.
pub fn alone() -> Result<()> {
    let tool = dependencies("haptic")?;
    for name in [TOOL, SHOWING, PREDICTING, THEORY, SIMULATING, FLASHING].concat() {
        ensure!(tool.contains(name), "the tool does without {name} now: xtask/src/library.rs names it");
    }
    for (package, without) in WITHOUT {
        let found = dependencies(package)?;
        if let Some(name) = without.iter().copied().flatten().find(|name| found.contains(**name)) {
            bail!("{package} brings {name}, which it does not need");
        }
    }
    for name in CRATES {
        run(cargo().current_dir(root()).args(["check", "--locked", "--lib", "--package", name]))?;
    }
    Ok(())
}

/// Names of everything that is linked or built for a package.
fn dependencies(package: &str) -> Result<BTreeSet<String>> {
    let mut command = cargo();
    command.current_dir(root()).args(["tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--package"]);
    let output = command.arg(package).output()?;
    ensure!(output.status.success(), "cargo tree: {}", String::from_utf8_lossy(&output.stderr).trim());
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_string).collect())
}
