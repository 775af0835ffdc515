//! Calls of cargo and of the compiler for the chip and for browsers, with the toolchain that runs this program.

use std::env;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::paths::{root, target_directory};
use crate::wrapper;

pub const TARGET: &str = "thumbv7em-none-eabihf";
pub const BROWSERS: &str = "wasm32-unknown-unknown";

/// Returns a cargo call that compiles for the chip.
pub fn chip_cargo() -> Command {
    let mut command = cargo_for("rustc", TARGET);
    wrapper::wrap_compiler(&mut command);
    command
}

pub fn cargo_for(subcommand: &str, target: &str) -> Command {
    let mut command = cargo();
    command.args([subcommand, "--target", target]);
    command.env("CARGO_ENCODED_RUSTFLAGS", rust_flags().join("\x1f"));
    command
}

/// Returns the caller's flags, and flags that remove the computer-dependent part of source paths. Images and tool
/// contain the paths of files with panics, but must be the same on every computer.
pub fn rust_flags() -> Vec<String> {
    let mut flags: Vec<String> = match env::var("CARGO_ENCODED_RUSTFLAGS") {
        Ok(flags) => flags.split('\x1f').map(String::from).collect(),
        Err(_) => env::var("RUSTFLAGS").unwrap_or_default().split_whitespace().map(String::from).collect(),
    };
    flags.retain(|flag| !flag.is_empty());
    let home = env::var_os("CARGO_HOME")
        .map(PathBuf::from)
        .or_else(|| env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
    let indices = home.map(|home| home.join("registry/src")).and_then(|sources| fs::read_dir(sources).ok());
    for index in indices.into_iter().flatten().flatten() {
        flags.push(format!("--remap-path-prefix={}=", index.path().join("").display()));
    }
    // Names the library's files relative to firmware/, as cargo names the firmware's own files.
    flags.push(format!("--remap-path-prefix={}=..", root().display()));
    // The emulator's tests find functions and statics by names in this mangling.
    flags.push("-Csymbol-mangling-version=v0".into());
    // Build scripts write code into the target directory.
    flags.push(format!("--remap-path-prefix={}=target", target_directory().display()));
    flags
}

/// Returns a call of the cargo that runs this program.
pub fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Returns a cargo call of a program of the virtual board. Ignores the compiler version that the emulator declares,
/// because the emulator works with an older compiler.
pub fn haptic_emulator(name: &str) -> Command {
    let mut command = cargo();
    command.current_dir(root()).args(["run", "--quiet", "--locked", "--ignore-rust-version"]);
    command.args(["--package", "haptic-emulator-programs", "--bin", name, "--"]);
    command
}

/// Runs a command to its end. The error names the command.
pub fn run(command: &mut Command) -> Result<()> {
    let name = format!("{} {}", command.get_program().display(), join(command));
    let status = command.status().with_context(|| format!("cannot run {name}"))?;
    if !status.success() {
        bail!("{name} failed ({status})");
    }
    Ok(())
}

fn join(command: &Command) -> String {
    command.get_args().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}

pub fn host() -> Result<String> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("-vV").output().context("cannot run rustc")?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(line.context("rustc -vV prints no host")?.to_string())
}
