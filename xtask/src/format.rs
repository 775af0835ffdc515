//! Checks the format of every source, because `cargo fmt` misses files that a macro or a `#[path]` declares.

use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use crate::paths::root;
use crate::toolchain::run;

pub fn check() -> Result<()> {
    let listed = Command::new("git").current_dir(root()).args(["ls-files", "-z", "*.rs"]).output();
    let listed = String::from_utf8(listed.context("cannot run git")?.stdout).context("a file's name is not UTF-8")?;
    let files: Vec<&str> = listed.split('\0').filter(|file| root().join(file).is_file()).collect();
    ensure!(files.len() > 200, "git lists only {} sources", files.len());
    run(Command::new("rustfmt").current_dir(root()).args(["--check", "--edition", "2024"]).args(&files))?;
    println!("{} files are formatted", files.len());
    Ok(())
}
