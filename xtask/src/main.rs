//! Development tasks that need more than one cargo call. `cargo xtask help` lists them.

mod bench;
#[path = "../../src/checksum.rs"]
mod checksum;
mod dfu;
mod dist;
mod document_tables;
mod dynamics;
mod firmware;
mod format;
mod fuzz;
mod image;
mod images;
mod library;
mod no_panic;
mod paths;
mod playground;
mod publish;
mod python;
mod report;
mod soak;
mod tests;
mod thumb;
mod toolchain;
mod tools;
mod undefined;
mod wrapper;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Parser, Subcommand};

use crate::firmware::{BOARDS, TOY_BOARD};

/// Development tasks that need more than one cargo call.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", max_term_width = 120)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build the firmware of one board, or of all; also `cargo fw`
    Fw {
        #[arg(value_parser = any_image())]
        board: Option<String>,
    },
    /// Build all images and print their flash and RAM; fail if one exceeds a limit
    Size,
    /// Run Clippy on the code for the chip; warnings are errors
    ClippyFw,
    /// Build and flash with probe-rs; also `cargo flash-BOARD`
    Flash {
        #[arg(value_parser = PossibleValuesParser::new(BOARDS))]
        board: String,
    },
    /// Build and write a .dfu update file that does not change the settings
    Dfu {
        #[arg(value_parser = PossibleValuesParser::new(BOARDS))]
        board: String,
    },
    /// Build all images into crates/flash/images, from which the build of the tool includes them
    Images {
        /// Only build this commit in two clean checkouts at different paths, and compare every byte (half an hour)
        #[arg(long)]
        twice: bool,
    },
    /// Make the release files for this computer in target/dist: an archive, a wheel and their checksums
    Dist,
    /// Prove that the control step cannot panic, and bound its stack
    NoPanic,
    /// Count the instructions of every variant of the control step and rewrite the report
    Bench {
        /// Only fail if a variant has over 1 % more instructions than the stored count
        #[arg(long)]
        check: bool,
    },
    /// Time the equations of motion and equation (4) on this computer, compared with Pinocchio
    Dynamics {
        /// Folder of Pinocchio with its include and lib folders
        pinocchio: PathBuf,
    },
    /// Test the library and the tool, and each image on the emulated board (ten minutes from a clean checkout)
    Test {
        /// Run the longer tests instead, all parts or one part
        #[arg(long, value_name = "PART", num_args = 0..=1, value_parser = deep_part())]
        deep: Option<Option<String>>,
        /// Further arguments for the test program of that part
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
    /// Count the control interrupt's instructions into the tables of docs/results/timing.md (half an hour)
    Timing {
        /// Names of tables, for example timing-rates [default: all]
        tables: Vec<String>,
    },
    /// Fuzz everything that reads input, guided by coverage
    Fuzz(fuzz::Options),
    /// Run the library's tests with the address sanitizer
    Sanitize {
        /// Further arguments of `cargo test`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
    /// Run some of the library's tests under Miri, which needs a nightly toolchain
    Miri,
    /// Build the page of `haptic view` as a file that works without the tool
    Playground,
    /// Check the formatting of every source in the repository
    Fmt,
    /// Simulate hours of contact with telemetry on the simulated board: no losses, no drift, no growth
    Soak(soak::Options),
    /// Measure ranges of stable walls on simulated boards and draw them, into docs/results (some minutes)
    Figures {
        /// Cases to run and print [default: all, and write the files]
        cases: Vec<String>,
    },
    /// Measure the range of stable walls on the emulated board, into docs/results/range-chip.csv (ten minutes)
    Range,
    /// Cause every fault on the emulated board, into docs/results/faults.csv and broken.csv (an hour)
    Faults {
        /// Cause only these faults, by code or name, and print the results; `list` prints how each fault is caused;
        /// `lying` writes only broken.csv
        faults: Vec<String>,
    },
    /// Run the real firmware on an emulated board with a simulated device, for a host to connect to
    Board {
        /// `[BOARD] [--device FILE] [--tcp PORT] [--fast]`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
}

fn deep_part() -> PossibleValuesParser {
    PossibleValuesParser::new(tests::PARTS.iter().map(|part| PossibleValue::new(part.name).help(part.description)))
}

/// Returns the shipped boards, and the toy board of a test, which the help hides.
fn any_image() -> PossibleValuesParser {
    let shipped = BOARDS.into_iter().map(PossibleValue::new);
    PossibleValuesParser::new(shipped.chain([PossibleValue::new(TOY_BOARD).hide(true)]))
}

fn main() -> ExitCode {
    let outcome =
        wrapper::compile_if_wrapped().unwrap_or_else(|| run(Arguments::parse().command).map(|()| ExitCode::SUCCESS));
    match outcome {
        Ok(code) => code,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Fw { board: None } => firmware::build_all().map(drop),
        Command::Fw { board: Some(board) } => firmware::build(&board).map(drop),
        Command::Size => firmware::size(),
        Command::ClippyFw => firmware::clippy(),
        Command::Flash { board } => firmware::flash(&board),
        Command::Dfu { board } => firmware::dfu(&board),
        Command::Images { twice: false } => images::build_all(),
        Command::Images { twice: true } => images::compare_checkouts(),
        Command::Dist => dist::make().map(drop),
        Command::NoPanic => no_panic::prove(),
        Command::Bench { check: false } => bench::refresh(),
        Command::Bench { check: true } => bench::check(),
        Command::Dynamics { pinocchio } => dynamics::compare(&pinocchio),
        Command::Test { deep: None, rest } => tests::gate(&rest),
        Command::Test { deep: Some(part), rest } => tests::deep(part.as_deref(), &rest),
        Command::Timing { tables } => tests::measure("timing", &tables),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Sanitize { rest } => undefined::sanitize(&rest),
        Command::Miri => undefined::miri(),
        Command::Playground => playground::build().map(drop),
        Command::Fmt => format::check(),
        Command::Soak(options) => soak::run(&options),
        Command::Figures { cases } => report::figures(&cases),
        Command::Range => tests::measure("range", &[]),
        Command::Faults { faults } => tests::measure("faults", &faults),
        Command::Board { rest } => tests::run_board(&rest),
    }
}

#[cfg(test)]
mod arguments {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_valid() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn further_arguments_go_to_cargo() {
        let parsed = Arguments::parse_from(["xtask", "test", "--deep", "emulated", "walls", "--nocapture"]);
        let Command::Test { deep: Some(Some(part)), rest } = parsed.command else { panic!("a part") };
        assert_eq!((part.as_str(), &rest[..]), ("emulated", &["walls".into(), "--nocapture".into()][..]));
        let all = Arguments::parse_from(["xtask", "test", "--deep"]).command;
        assert!(matches!(all, Command::Test { deep: Some(None), rest } if rest.is_empty()));
        let parsed = Arguments::parse_from(["xtask", "board", "odrive-v3", "--fast"]);
        assert!(matches!(parsed.command, Command::Board { rest } if rest == ["odrive-v3", "--fast"]));
        assert!(Arguments::try_parse_from(["xtask", "fw", "no-such-board"]).is_err());
    }
}
