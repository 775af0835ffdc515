//! The `haptic` command: parses the command line, runs one command, and turns what went wrong into one line on
//! standard error and an exit code (0 done, 1 it could not be done, 2 the command or a file is wrong).
#![forbid(unsafe_code)]
#![deny(clippy::print_stderr, clippy::print_stdout)]

mod cli;
mod commands;

use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::run(cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            haptic::tell!("error: {failure}");
            failure.exit_code()
        }
    }
}
