//! `--continue`, which every command that works for long takes.

use super::interrupt;
use haptic_host::error::Failure;
use haptic_stability::sweep::Sweep;
use std::path::PathBuf;

/// Where unfinished work is kept.
#[derive(clap::Args)]
pub struct Continue {
    /// Keep unfinished work in this file: after Ctrl-C the same command goes on from there
    #[arg(long = "continue", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl Continue {
    /// The work of a command that Ctrl-C ends in order; `question` is everything that decides its results.
    pub fn sweep(&self, command: &str, question: &str) -> Result<Sweep, Failure> {
        let interrupt = interrupt::watch();
        Sweep::new(command, question, self.file.as_deref(), move || interrupt.is_set())
    }
}
