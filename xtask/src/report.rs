//! Writes reports with their date and commit into docs/results.

use std::fs;
use std::process::Command;

use anyhow::{Context as _, Result};

use crate::document_tables;
use crate::paths::root;
use crate::toolchain::{cargo, run};

pub fn write(name: &str, text: &str) -> Result<()> {
    let path = root().join("docs/results").join(name);
    fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    println!("docs/results/{name} is written");
    Ok(())
}

pub fn figures(cases: &[String]) -> Result<()> {
    let program = ["run", "--quiet", "--locked", "--release", "--package", "figures", "--"];
    run(cargo().current_dir(root()).args(program).args(cases))?;
    if cases.is_empty() { record("ranges", "cargo xtask figures") } else { Ok(()) }
}

/// Records in docs/results/made.csv the date, commit and compiler with which `command` has just made the figures
/// `name`. Also updates the documents' tables.
pub fn record(name: &str, command: &str) -> Result<()> {
    let path = root().join("docs/results/made.csv");
    let compiler =
        Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version").output()?;
    let line =
        format!("{name},{command},\"{}\",{}", date_and_commit(), String::from_utf8_lossy(&compiler.stdout).trim());
    let head = "figures,command,made,compiler";
    let present = fs::read_to_string(&path).unwrap_or_default();
    let others = present.lines().skip(1).filter(|other| other.split(',').next() != Some(name));
    let mut lines: Vec<&str> = others.chain([line.as_str()]).collect();
    lines.sort_unstable();
    lines.insert(0, head);
    write("made.csv", &(lines.join("\n") + "\n"))?;
    document_tables::refresh()
}

/// Returns the date and the commit, as in "2026-01-31, commit 0123abc".
pub fn date_and_commit() -> String {
    let line = |command: &mut Command| {
        let output = command.current_dir(root()).output().ok().filter(|output| output.status.success());
        output.map_or_else(|| "unknown".into(), |output| String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    let date = line(Command::new("date").args(["-u", "+%Y-%m-%d"]));
    let commit = line(Command::new("git").args(["describe", "--always", "--dirty=, changed"]));
    format!("{date}, commit {commit}")
}
