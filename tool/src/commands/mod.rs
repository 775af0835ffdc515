//! The subcommands. Each has one file here, with its `Args` and `run(Args) -> Result<(), Failure>`, and one line below.

mod answer;
pub mod arguments;
mod arm;
mod backup;
mod bench;
mod board;
mod bug_report;
mod check;
mod cogging;
mod completions;
mod continued;
mod demo;
mod design;
mod device;
mod dfu;
mod disarm;
mod estimators;
mod faults;
mod flash;
mod force;
mod gains;
mod held_key;
pub mod help;
mod home;
mod info;
mod interrupt;
mod latency;
mod list;
mod map;
mod measure_range;
mod model;
mod name;
mod new;
mod plot;
mod polarity;
mod port;
mod range;
mod read_back;
mod record;
mod replay;
mod report;
mod restart;
mod restore;
mod rules;
mod save;
mod scene;
mod serve;
mod sim;
mod stream;
mod tune;
mod udev;
mod view;

use haptic_host::error::Failure;
pub use stream::list_of_fields;

/// Heading of commands that the help page omits, for developers or named on another command's page.
pub const UNLISTED_HEADING: &str = "";

/// Declares the subcommands: under each heading of `haptic --help`, `(Variant, module)` in the order of that page.
macro_rules! commands {
    ($($heading:tt { $(($Variant:ident, $module:ident))* })*) => {
        /// The command to run.
        #[derive(clap::Subcommand)]
        pub enum Command {
            $($($Variant($module::Args),)*)*
        }

        /// The headings of the help page, each with the subcommands under it.
        pub const HEADINGS: &[(&str, &[&str])] = &[$(($heading, &[$(stringify!($module)),*])),*];

        /// Runs one command.
        pub fn run(command: Command) -> Result<(), Failure> {
            match command {
                $($(Command::$Variant(args) => $module::run(args),)*)*
            }
        }
    };
}

commands! {
    "Without a board" {
        (Demo, demo)
        (Sim, sim)
        (New, new)
        (Check, check)
        (Model, model)
        (Map, map)
        (Range, range)
        (Tune, tune)
        (Design, design)
        (Report, report)
        (Plot, plot)
        (Replay, replay)
    }
    "With a board" {
        (Info, info)
        (Device, device)
        (Scene, scene)
        (Gains, gains)
        (Rules, rules)
        (Home, home)
        (Polarity, polarity)
        (Cogging, cogging)
        (Arm, arm)
        (Disarm, disarm)
        (Stream, stream)
        (Record, record)
        (Serve, serve)
        (View, view)
        (MeasureRange, measure_range)
        (Faults, faults)
        (Board, board)
        (Flash, flash)
    }
    "Shell" {
        (Completions, completions)
    }
    UNLISTED_HEADING {
        (Bench, bench)
        (Udev, udev)
    }
}

#[cfg(test)]
mod tests {
    /// The file of a toy command.
    mod greet {
        use haptic_host::error::Failure;

        /// Greet someone
        #[derive(clap::Args)]
        pub struct Args {
            /// Their name
            name: String,
        }

        pub fn run(args: Args) -> Result<(), Failure> {
            Err(Failure::wrong(format!("hello {}", args.name)))
        }
    }

    mod list {
        use super::greet;
        use haptic_host::error::Failure;

        commands! {
            "For people" {
                (Greet, greet)
            }
        }
    }

    #[derive(clap::Parser)]
    struct Toy {
        #[command(subcommand)]
        command: list::Command,
    }

    #[test]
    fn a_toy_command_is_a_file_and_a_line() {
        use clap::{CommandFactory, Parser};
        assert_eq!(list::HEADINGS, [("For people", &["greet"][..])]);
        let help = Toy::command().render_help().to_string();
        assert!(help.contains("greet") && help.contains("Greet someone"), "{help}");
        let toy = Toy::parse_from(["haptic", "greet", "Colgate"]);
        assert_eq!(list::run(toy.command).unwrap_err().to_string(), "hello Colgate");
    }
}
