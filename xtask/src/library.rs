//! Checks that the crates for other programs compile without the tool and do not depend on crates that only the tool
//! needs.

use std::collections::BTreeSet;

use anyhow::{Result, bail, ensure};

use crate::paths::root;
use crate::toolchain::{cargo, run};

/// The crates that the tool uses. Each crate depends only on earlier crates of this list.
pub const CRATES: [&str; 7] =
    ["haptic-host", "haptic-flash", "haptic-import", "haptic-sim", "haptic-stability", "haptic-predict", "haptic-show"];

/// Dependencies that only the tool needs.
const TOOL_CRATES: &[&str] =
    &["clap", "clap_complete", "clap_mangen", "crossterm", "ctrlc", "dejavu", "indicatif", "resvg", "tungstenite"];
/// Dependencies of recordings, drawings and the page.
const SHOW_CRATES: &[&str] = &["haptic-show", "mcap", "prost-reflect"];
const STABILITY_CRATES: &[&str] = &["haptic-stability"];
const PREDICT_CRATES: &[&str] = &["haptic-predict"];
const SIM_CRATES: &[&str] = &["haptic-sim"];
const FLASH_CRATES: &[&str] = &["haptic-flash", "nusb"];

/// Packages, and the dependencies that each must not have.
const FORBIDDEN: [(&str, &[&[&str]]); 9] = [
    ("haptic-host", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, STABILITY_CRATES, SIM_CRATES, FLASH_CRATES]),
    ("haptic-flash", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, STABILITY_CRATES, SIM_CRATES]),
    ("haptic-sim", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, STABILITY_CRATES, FLASH_CRATES]),
    ("haptic-stability", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, SIM_CRATES, FLASH_CRATES]),
    ("haptic-predict", &[TOOL_CRATES, SHOW_CRATES, FLASH_CRATES]),
    ("haptic-show", &[FLASH_CRATES]),
    ("haptic-c", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, STABILITY_CRATES, FLASH_CRATES]),
    ("haptic-chai3d", &[TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, FLASH_CRATES]),
    ("haptic-python", &[TOOL_CRATES, FLASH_CRATES]),
];

/// Checks that the crates compile alone and do not have the forbidden dependencies.
pub fn check() -> Result<()> {
    let tool = dependencies("haptic")?;
    for name in [TOOL_CRATES, SHOW_CRATES, PREDICT_CRATES, STABILITY_CRATES, SIM_CRATES, FLASH_CRATES].concat() {
        ensure!(tool.contains(name), "the tool no longer needs {name}: remove it from xtask/src/library.rs");
    }
    for (package, without) in FORBIDDEN {
        let found = dependencies(package)?;
        if let Some(name) = without.iter().copied().flatten().find(|name| found.contains(**name)) {
            bail!("{package} depends on {name}, which it does not need");
        }
    }
    for name in CRATES {
        run(cargo().current_dir(root()).args(["check", "--locked", "--lib", "--package", name]))?;
    }
    Ok(())
}

/// Returns the names of all dependencies that are linked or built for a package.
fn dependencies(package: &str) -> Result<BTreeSet<String>> {
    let mut command = cargo();
    command.current_dir(root()).args(["tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--package"]);
    let output = command.arg(package).output()?;
    ensure!(output.status.success(), "cargo tree: {}", String::from_utf8_lossy(&output.stderr).trim());
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_string).collect())
}
