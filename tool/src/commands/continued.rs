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
    /// Creates the `Sweep` that does the work of a command and ends cleanly at Ctrl-C. `question` holds all inputs that
    /// determine the results.
    pub fn sweep(&self, command: &str, question: &str) -> Result<Sweep, Failure> {
        let interrupt = interrupt::watch();
        Sweep::new(command, question, self.file.as_deref(), move || interrupt.is_set())
    }
}
