//! `haptic board`: commands about the board itself: its flash, its name, its link to this computer.

use super::{backup, bug_report, dfu, latency, list, name, restart, restore, save};
use haptic_host::error::Failure;

/// Find boards, examine one, measure its latency; save, back up, restore, name, restart or reflash it
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    List(list::Args),
    Latency(latency::Args),
    Report(bug_report::Args),
    Save(save::Args),
    Backup(backup::Args),
    Restore(restore::Args),
    Name(name::Args),
    Restart(restart::Args),
    Dfu(dfu::Args),
}

pub fn run(args: Args) -> Result<(), Failure> {
    match args.command {
        Command::List(args) => list::run(args),
        Command::Latency(args) => latency::run(args),
        Command::Report(args) => bug_report::run(args),
        Command::Save(args) => save::run(args),
        Command::Backup(args) => backup::run(args),
        Command::Restore(args) => restore::run(args),
        Command::Name(args) => name::run(args),
        Command::Restart(args) => restart::run(args),
        Command::Dfu(args) => dfu::run(args),
    }
}
