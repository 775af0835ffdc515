//! Checks that the programs that a task needs run on this computer, and prints how to install missing programs.

use std::env;
use std::fs;
use std::process::Command;

use anyhow::{Result, bail};

use crate::toolchain::{BROWSERS, TARGET};

/// A program or library that a stage needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Tool {
    /// Compiles for the chip.
    Chip,
    /// Compiles the page as a file, for browsers.
    Browsers,
    /// Compiles libFuzzer.
    Cpp,
    /// Tests the page of `haptic view`.
    Chromium,
    /// Tests the Python package.
    Python,
}

impl Tool {
    /// All tools, which `cargo xtask test --deep` needs.
    pub const ALL: [Self; 5] = [Self::Chip, Self::Browsers, Self::Cpp, Self::Chromium, Self::Python];

    /// Returns the name of the tool and the command that installs it.
    fn remedy(self) -> [&'static str; 2] {
        match self {
            Self::Chip => [
                "Rust's library for the chip",
                "rustup target add thumbv7em-none-eabihf   (rustup itself: https://rustup.rs)",
            ],
            Self::Browsers => [
                "Rust's library for browsers",
                "rustup target add wasm32-unknown-unknown   (rustup itself: https://rustup.rs)",
            ],
            Self::Cpp => ["a C++ compiler (c++, or the value of CXX) for libFuzzer", "on Debian: apt-get install g++"],
            Self::Chromium => ["a browser without a screen (chromium)", "on Debian: apt-get install chromium"],
            Self::Python => {
                ["Python 3.11 or newer with venv and pip (python3)", "on Debian: apt-get install python3-venv"]
            }
        }
    }

    fn runs(self) -> bool {
        let version = |program: &str| succeeds(program, &["--version"]);
        match self {
            Self::Chip => has_target(TARGET),
            Self::Browsers => has_target(BROWSERS),
            Self::Cpp => version(&env::var("CXX").unwrap_or_else(|_| "c++".into())),
            // The same names as in tool/tests/browser.
            Self::Chromium => ["chromium", "chromium-browser", "google-chrome"].into_iter().any(version),
            Self::Python => {
                succeeds("python3", &["-c", "import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))"])
            }
        }
    }
}

/// Checks that these tools run, after adding missing targets with rustup. Returns an error with the missing tools and
/// their remedies.
pub fn check(tools: &[Tool]) -> Result<()> {
    for (tool, target) in [(Tool::Chip, TARGET), (Tool::Browsers, BROWSERS)] {
        if tools.contains(&tool) && !tool.runs() {
            eprintln!("rustup target add {target}");
            succeeds("rustup", &["target", "add", target]);
        }
    }
    let missing: Vec<Tool> = tools.iter().copied().filter(|tool| !tool.runs()).collect();
    if missing.is_empty() { Ok(()) } else { bail!(missing_message(&missing)) }
}

/// Returns a message with the missing tools and the commands that install them.
fn missing_message(missing: &[Tool]) -> String {
    let lines = missing.iter().map(|tool| format!("\n    {}\n        {}", tool.remedy()[0], tool.remedy()[1]));
    format!("missing on this computer:{}", lines.collect::<String>())
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|output| output.status.success())
}

/// Returns true if the toolchain that runs this program has the core library of a target.
fn has_target(target: &str) -> bool {
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let output = Command::new(rustc).args(["--print", "target-libdir", "--target", target]).output();
    let folder = output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_string());
    folder
        .and_then(fs::read_dir)
        .is_ok_and(|entries| entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with("libcore-")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_each_missing_tool_with_its_remedy() {
        let text = missing_message(&Tool::ALL);
        for tool in Tool::ALL {
            assert!(tool.remedy().iter().all(|part| text.contains(part)), "{tool:?} in\n{text}");
        }
        assert!([TARGET, BROWSERS].iter().all(|target| text.contains(&format!("rustup target add {target}"))));
    }

    #[test]
    fn a_target_that_does_not_exist_is_missing() {
        assert!(!has_target("no-such-target"));
    }
}
