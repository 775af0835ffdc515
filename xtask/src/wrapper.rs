//! A wrapper of the compiler for the chip that makes one argument the same on every computer.
//!
//! Cargo gives every crate a number (`-C metadata`) that becomes part of its symbols and so decides the order of
//! functions in an image. For a crate in the workspace or from a registry the number is the same on every computer. The
//! library is outside the firmware's workspace: its number depends on its absolute path, and the firmware's number
//! depends on the library's. So cargo calls this program in place of the compiler, and this program derives the numbers
//! of this repository's crates from their names.

use std::env;
use std::ffi::OsString;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};

/// Environment variable that is set if cargo calls this program in place of the compiler.
const WRAPS_COMPILER: &str = "HAPTIC_XTASK_AS_RUSTC";

/// Makes a cargo call compile through this program. If the system does not report this program's path, nothing changes.
pub fn wrap_compiler(command: &mut Command) {
    if let Ok(this) = env::current_exe() {
        command.env("RUSTC_WRAPPER", this).env(WRAPS_COMPILER, "1");
    }
}

/// Runs the compiler and returns its exit code if cargo called this program in place of the compiler.
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

/// Returns the arguments, with the number of a crate of this repository derived from its name alone.
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
