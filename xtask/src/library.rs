//! The library as programs take it, without the command line: it compiles, and nothing comes along which only the tool
//! needs.

use std::collections::BTreeSet;

use anyhow::{Result, bail, ensure};

use crate::paths::root;
use crate::toolchain::{cargo, run};

/// What only the tool needs.
const TOOL_ONLY: [&str; 9] =
    ["clap", "clap_complete", "clap_mangen", "ctrlc", "dejavu", "indicatif", "ratatui", "resvg", "tungstenite"];

/// Who takes the library without it.
const WITHOUT: [&[&str]; 4] =
    [&["haptic", "--no-default-features"], &["haptic-capi"], &["haptic-chai3d"], &["haptic-python"]];

/// Checks both.
pub fn alone() -> Result<()> {
    let tool = dependencies(&["haptic"])?;
    for name in TOOL_ONLY {
        ensure!(tool.contains(name), "the tool does without {name} now: xtask/src/library.rs names it");
    }
    for package in WITHOUT {
        let found = dependencies(package)?;
        if let Some(name) = TOOL_ONLY.into_iter().find(|name| found.contains(*name)) {
            bail!("{} brings {name}, which only the tool needs", package.join(" "));
        }
    }
    let check = ["check", "--locked", "--package", "haptic", "--no-default-features", "--lib"];
    run(cargo().current_dir(root()).args(check))
}

/// Names of everything that is linked or built for a package.
fn dependencies(package: &[&str]) -> Result<BTreeSet<String>> {
    let mut command = cargo();
    command.current_dir(root()).args(["tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--package"]);
    let output = command.args(package).output()?;
    ensure!(output.status.success(), "cargo tree: {}", String::from_utf8_lossy(&output.stderr).trim());
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_string).collect())
}
