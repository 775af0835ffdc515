//! The `haptic` command: parses the command line, runs one command, and reports a failure as one line on standard error
//! and an exit code (0 done, 1 it could not be done, 2 the command or a file is wrong, 3 what was compared differs).
#![forbid(unsafe_code)]
#![deny(clippy::print_stderr, clippy::print_stdout)]

mod cli;
mod commands;

use haptic_host::error::Choice;
use std::process::ExitCode;

/// Returns the option with which a user makes the choice that a failure asks for.
fn option_for(choice: Choice) -> &'static str {
    match choice {
        Choice::Pose => "--q",
        Choice::Clearance => "--clear",
        Choice::Patch => "--patch",
        Choice::Ripple => "--ripple",
        Choice::Wall => "--wall",
        Choice::Overwriting => "--force",
        Choice::Board => "--port or HAPTIC_PORT",
        Choice::ResultsFile => "--continue",
        Choice::DrawnSignals => "--show",
        Choice::Fields => "--fields",
        Choice::Image => "--file",
        Choice::Conversion => "haptic new --from FILE -o OUT.toml",
        Choice::Tip => "--tip",
        Choice::Joints => "--joints",
    }
}

fn main() -> ExitCode {
    match commands::run(cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            match failure.choice().map(option_for) {
                Some(option) => haptic_host::tell!("error: {failure} ({option})"),
                None => haptic_host::tell!("error: {failure}"),
            }
            failure.exit_code()
        }
    }
}
