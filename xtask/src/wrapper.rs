//! The compiler as cargo calls it for the chip, with one argument made the same everywhere.
//!
//! Cargo gives every crate a number (`-C metadata`) that becomes part of its symbols, and with them decides the order of
//! functions in an image. For a crate inside the workspace or from a registry the number is the same on every computer.
//! The library lies beside firmware/, outside of its workspace: its number is made of its whole path, and the firmware's
//! of that. So this program stands between cargo and the compiler and numbers the crates here by their names.

use std::env;
use std::ffi::OsString;
use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};

/// Set where cargo calls this program in the compiler's place.
const ASKED: &str = "HAPTIC_XTASK_AS_RUSTC";

/// Has a cargo call compile by way of this program. A system that does not tell where this program is builds without.
pub fn stand_between(command: &mut Command) {
    if let Ok(this) = env::current_exe() {
        command.env("RUSTC_WRAPPER", this).env(ASKED, "1");
    }
}

/// The compiler's exit code where cargo calls this program in its place.
pub fn asked() -> Option<Result<ExitCode>> {
    env::var_os(ASKED)?;
    let mut arguments = env::args_os().skip(1);
    let compiler = arguments.next()?;
    Some(compile(compiler, arguments.collect()))
}

fn compile(compiler: OsString, arguments: Vec<OsString>) -> Result<ExitCode> {
    let status = Command::new(&compiler).args(renumbered(arguments)).status();
    let status = status.with_context(|| format!("cannot run {}", compiler.display()))?;
    Ok(ExitCode::from(status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(1)))
}

/// The arguments, with the number of a crate of this repository made of its name alone.
fn renumbered(mut arguments: Vec<OsString>) -> Vec<OsString> {
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
    fn the_crates_here_are_numbered_by_their_names_and_no_other() {
        let words = |text: &str| text.split(' ').map(OsString::from).collect::<Vec<_>>();
        let ours = words("--crate-name haptic_bridge src/lib.rs -C metadata=12ab -C extra-filename=-34cd");
        let same = words("--crate-name haptic_bridge src/lib.rs -C metadata=haptic_bridge -C extra-filename=-34cd");
        assert_eq!(renumbered(ours), same);
        for other in
            ["--crate-name embassy_usb -C metadata=12ab", "--crate-name build_script_build -C metadata=12ab", "-vV"]
        {
            assert_eq!(renumbered(words(other)), words(other));
        }
    }
}
