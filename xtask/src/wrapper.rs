//! Makes images the same on every computer, by a wrapper of the compiler for the chip.
//!
//! Cargo gives every crate a number (`-C metadata`), which determines its symbols and the order of functions in an
//! image. The library is outside the firmware's workspace, so that its number, and therefore the firmware's number,
//! would depend on its absolute path. Cargo calls this program instead of the compiler, and this program derives the
//! numbers of this repository's crates from their names.

use std::env;
use std::ffi::OsString;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};

/// Environment variable that is set if cargo calls this program instead of the compiler.
const WRAPS_COMPILER: &str = "HAPTIC_XTASK_AS_RUSTC";

/// Makes a cargo call compile through this program, if the system reports the path of this program.
pub fn wrap_compiler(command: &mut Command) {
    if let Ok(this) = env::current_exe() {
        command.env("RUSTC_WRAPPER", this).env(WRAPS_COMPILER, "1");
    }
}

/// Runs the compiler and returns its exit code, if cargo has called this program instead of the compiler.
pub fn compile_if_wrapped() -> Option<Result<ExitCode>> {
    env::var_os(WRAPS_COMPILER)?;
    let mut arguments = env::args_os().skip(1);
    let compiler = arguments.next()?;
    Some(compile(compiler, arguments.collect()))
}

fn compile(compiler: OsString, arguments: Vec<OsString>) -> Result<ExitCode> {
    let status = Command::new(&compiler).args(renumber_crate(arguments)).status();
    let status = status.with_context(|| format!("cannot run {}", compiler.display()))?;
    Ok(ExitCode::from(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1)))
}

/// Replaces the number of a crate of this repository by a number that depends only on the crate's name.
fn renumber_crate(mut arguments: Vec<OsString>) -> Vec<OsString> {
    let name = arguments.iter().position(|argument| argument == "--crate-name").and_then(|at| arguments.get(at + 1));
    let Some(name) = name.and_then(|name| name.to_str()).filter(|name| name.starts_with("haptic_")) else {
        return arguments;
    };
    let number = OsString::from(format!("metadata={name}"));
    for argument in &mut arguments {
        if argument.to_str().is_some_and(|argument| argument.starts_with("metadata=")) {
            argument.clone_from(&number);
        }
    }
    arguments
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_repositorys_crates_are_numbered_by_name() {
        let words = |text: &str| text.split(' ').map(OsString::from).collect::<Vec<_>>();
        let ours = words("--crate-name haptic_bridge src/lib.rs -C metadata=12ab -C extra-filename=-34cd");
        let same = words("--crate-name haptic_bridge src/lib.rs -C metadata=haptic_bridge -C extra-filename=-34cd");
        assert_eq!(renumber_crate(ours), same);
        for other in
            ["--crate-name embassy_usb -C metadata=12ab", "--crate-name build_script_build -C metadata=12ab", "-vV"]
        {
            assert_eq!(renumber_crate(words(other)), words(other));
        }
    }
}
