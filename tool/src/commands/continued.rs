//! `--continue`, an option of every long-running command.

use super::interrupt;
use haptic_host::error::Failure;
use haptic_stability::sweep::Sweep;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Continue {
    /// Keep unfinished work in this file: after Ctrl-C the same command continues from there
    #[arg(long = "continue", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl Continue {
    /// Creates the `Sweep` of a command, which Ctrl-C ends cleanly. `question` holds all inputs of the results.
    pub fn sweep(&self, command: &str, question: &str) -> Result<Sweep, Failure> {
        let interrupt = interrupt::watch();
        Sweep::new(command, question, self.file.as_deref(), move || interrupt.is_set())
    }
}
