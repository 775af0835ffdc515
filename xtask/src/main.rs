//! Entry points that need more than one cargo call. `cargo xtask help` lists them.

mod bench;
mod build_times;
#[path = "../../src/checksum.rs"]
mod checksum;
mod dfu;
mod dist;
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
mod shown;
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

use crate::firmware::{BOARDS, TOY};

/// What takes more than one cargo call.
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
    /// Build all boards, print flash and RAM, fail above the limits
    Size,
    /// Clippy for the chip, warnings are errors
    ClippyFw,
    /// Build and flash with probe-rs; also `cargo flash-BOARD`
    Flash {
        #[arg(value_parser = PossibleValuesParser::new(BOARDS))]
        board: String,
    },
    /// Build and write a .dfu update file that leaves the settings alone
    Dfu {
        #[arg(value_parser = PossibleValuesParser::new(BOARDS))]
        board: String,
    },
    /// Build every image and put it where the tool takes it in: crates/flash/images, with version and SHA-256 beside it
    Images {
        /// Instead build this commit from two clean checkouts at two paths, and compare to the byte (half an hour)
        #[arg(long)]
        twice: bool,
    },
    /// Make what others install, for this computer: an archive, a wheel and their sums, into target/dist
    Dist,
    /// Prove that the control step cannot panic, and bound its stack
    NoPanic,
    /// Count instructions of every variant of the control step, remake the report
    Bench {
        /// Only fail where a variant's instructions grew by more than 1 % over the kept figures
        #[arg(long)]
        check: bool,
    },
    /// Time the equations of motion and equation (4) on this computer, beside Pinocchio
    Dynamics {
        /// Where Pinocchio is: the folder with its include and lib
        pinocchio: PathBuf,
    },
    /// The library, the tool, all images, each on the emulated board once; ten minutes from nothing
    Test {
        /// Instead what takes longer: everything, or one part
        #[arg(long, value_name = "PART", num_args = 0..=1, value_parser = deep_part())]
        deep: Option<Option<String>>,
        /// With one part: further arguments of its program
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
    /// Count the control interrupt's instructions, stage by stage, into the tables of docs/results/timing.md
    Timing,
    /// Wild input for everything that reads any, guided by coverage
    Fuzz(fuzz::Options),
    /// The library's tests under the address sanitizer
    Sanitize {
        /// Further arguments of `cargo test`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
    /// Some of them under Miri, which needs a nightly toolchain
    Miri,
    /// Build the page of `haptic view` as a file that needs no tool
    Playground,
    /// Check the formatting of every source here, whatever declares it
    Fmt,
    /// Build the tool anew and say what each format, view and interface adds to the time (some minutes)
    BuildTimes,
    /// Simulated hours of contact with telemetry: nothing lost, no drift, no growth
    Soak(soak::Options),
    /// Measure ranges of stable walls on simulated boards and draw them, into docs/results (some minutes)
    Figures {
        /// The cases to run; all, and the files, when none is named
        cases: Vec<String>,
    },
    /// Measure the range of stable walls on the emulated board, into docs/results/range-chip.csv (half an hour)
    Range {
        /// Instead what it is with cables at the joints, into docs/results/complete-chip.csv (half an hour)
        #[arg(value_parser = PossibleValuesParser::new(["cables"]))]
        part: Option<String>,
        /// With cables: only this device, printed alone
        device: Option<String>,
        /// With cables: only at this control rate, Hz
        rate: Option<String>,
        /// With cables: the motors without back-EMF
        #[arg(value_parser = PossibleValuesParser::new(["no-emf"]))]
        motors: Option<String>,
    },
    /// Bring every fault about on the emulated board, into docs/results/faults.csv and broken.csv (an hour)
    Faults {
        /// Only these, by code or name, and only print what came of them; `list`: how each is brought about, or why it
        /// cannot be; `lying`: broken.csv alone
        faults: Vec<String>,
    },
    /// The real firmware on an emulated board with a simulated device, to talk to
    Board {
        /// `[BOARD] [--device FILE] [--tcp PORT] [--fast]`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        rest: Vec<String>,
    },
}

/// The parts of the deep tests, with what each one does.
fn deep_part() -> PossibleValuesParser {
    PossibleValuesParser::new(tests::PARTS.iter().map(|part| PossibleValue::new(part.name).help(part.what)))
}

/// The boards that ship, and the toy board of a test, which help does not show.
fn any_image() -> PossibleValuesParser {
    let shipped = BOARDS.into_iter().map(PossibleValue::new);
    PossibleValuesParser::new(shipped.chain([PossibleValue::new(TOY).hide(true)]))
}

fn main() -> ExitCode {
    let outcome = wrapper::asked().unwrap_or_else(|| run(Arguments::parse().command).map(|()| ExitCode::SUCCESS));
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
        Command::Images { twice: false } => images::take_in(),
        Command::Images { twice: true } => images::twice(),
        Command::Dist => dist::make().map(drop),
        Command::NoPanic => no_panic::prove(),
        Command::Bench { check: false } => bench::refresh(),
        Command::Bench { check: true } => bench::check(),
        Command::Dynamics { pinocchio } => dynamics::compare(&pinocchio),
        Command::Test { deep: None, rest } => tests::gate(&rest),
        Command::Test { deep: Some(part), rest } => tests::deep(part.as_deref(), &rest),
        Command::Timing => tests::measure("timing", &[]),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Sanitize { rest } => undefined::sanitize(&rest),
        Command::Miri => undefined::miri(),
        Command::Playground => playground::build().map(drop),
        Command::BuildTimes => build_times::print(),
        Command::Fmt => format::check(),
        Command::Soak(options) => soak::run(&options),
        Command::Figures { cases } => report::figures(&cases),
        Command::Range { part, device, rate, motors } => {
            let asked: Vec<String> = [part, device, rate, motors].into_iter().flatten().collect();
            tests::measure("range", &asked)
        }
        Command::Faults { faults } => tests::measure("faults", &faults),
        Command::Board { rest } => tests::play(&rest),
    }
}

#[cfg(test)]
mod arguments {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_sound() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn what_follows_goes_on_to_cargo() {
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
