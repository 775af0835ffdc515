//! Chooses the toolchain that compiles code for the chip and for browsers.
//!
//! 1. The rustup target `thumbv7em-none-eabihf` or `wasm32-unknown-unknown`, if the running toolchain has it.
//! 2. Otherwise Debian's packages: a compiler in /usr/bin with the source of the core library, which is built too
//!    (`-Zbuild-std`), and the linker to which /usr/bin/rust-lld points. For browsers the complete standard library is
//!    built, and cargo fetches its dependencies from crates.io.
//!
//! The module `tools` checks that they are installed.

use std::env;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::paths::{root, target_directory};
use crate::wrapper;

/// The target triple of the chip.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The target triple of browsers.
pub const BROWSERS: &str = "wasm32-unknown-unknown";

/// Debian's compiler.
pub const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
/// Debian's cargo.
pub const DEBIAN_CARGO: &str = "/usr/bin/cargo";
/// Debian's source of the core library.
pub const DEBIAN_CORE: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";
/// Debian's linker.
pub const DEBIAN_LINKER: &str = "/usr/bin/rust-lld";
/// Debian's clippy.
pub const DEBIAN_CLIPPY: &str = "/usr/bin/cargo-clippy";

/// Purpose of a stage.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Use {
    /// Builds for the chip.
    Build,
    /// Lints for the chip.
    Clippy,
    /// Builds libFuzzer, which needs C++.
    Fuzz,
    /// Tests the page of `haptic view` in a browser.
    Page,
    /// Builds the page as a file, for browsers.
    Playground,
    /// Tests the Python package.
    Python,
}

/// Toolchain on this computer that compiles for the chip or for browsers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Toolchain {
    /// The toolchain that runs this program, which has the target.
    Rustup,
    /// Debian's compiler, which also builds the target's libraries.
    Debian,
}

impl Toolchain {
    /// Returns a cargo call for the chip: `cargo SUBCOMMAND …` with the target and, if needed, a build of the core
    /// library.
    pub fn cargo(self, purpose: Use) -> Command {
        let subcommand = if purpose == Use::Clippy { "clippy" } else { "rustc" };
        let mut command = self.cargo_with(subcommand, "-Zbuild-std=core,alloc", TARGET);
        if purpose != Use::Clippy {
            wrapper::wrap_compiler(&mut command);
        }
        command
    }

    /// Returns a cargo call for browsers.
    pub fn cargo_for_browsers(self, subcommand: &str) -> Command {
        self.cargo_with(subcommand, "-Zbuild-std=std,panic_abort", BROWSERS)
    }

    fn cargo_with(self, subcommand: &str, libraries: &str, target: &str) -> Command {
        let mut command = match self {
            Self::Rustup => {
                let mut command = cargo();
                command.arg(subcommand);
                command
            }
            Self::Debian => {
                let mut command = Command::new(if subcommand == "clippy" { DEBIAN_CLIPPY } else { DEBIAN_CARGO });
                command.arg(subcommand).arg(libraries);
                command.env("CARGO", DEBIAN_CARGO).env("RUSTC", DEBIAN_RUSTC).env("RUSTC_BOOTSTRAP", "1");
                command.env("PATH", format!("/usr/bin:{}", env::var("PATH").unwrap_or_default()));
                for name in ["RUSTUP_TOOLCHAIN", "RUSTC_WRAPPER", "RUSTC_WORKSPACE_WRAPPER", "RUSTDOC"] {
                    command.env_remove(name);
                }
                command
            }
        };
        command.args(["--target", target]);
        command.env("CARGO_ENCODED_RUSTFLAGS", rust_flags().join("\x1f"));
        command
    }
}

/// Returns the caller's flags, and flags that remove the computer-dependent part of source paths: an image or a tool
/// contains the paths of files with panics, and must be the same on every computer.
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
    flags.push("--remap-path-prefix=/usr/lib/rustlib/src/rust/library/=".into());
    // The library relative to firmware/, as cargo names the firmware's own files.
    flags.push(format!("--remap-path-prefix={}=..", root().display()));
    // The emulator's tests find functions and statics by these names; the default differs between compilers.
    flags.push("-Csymbol-mangling-version=v0".into());
    // Build scripts write code below the target directory.
    flags.push(format!("--remap-path-prefix={}=target", target_directory().display()));
    flags
}

/// Returns a call of the cargo that runs this program.
pub fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Returns a cargo call of a program of the virtual board. The emulator declares a newer compiler than it needs.
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

/// Returns the target triple of this computer.
pub fn host() -> Result<String> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("-vV").output().context("cannot run rustc")?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(line.context("rustc -vV prints no host")?.to_string())
}
