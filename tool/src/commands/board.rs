//! `haptic board`: the board itself, its flash, its name, its way to this computer.

use super::{backup, bug_report, dfu, latency, list, name, restart, restore, save};
use haptic_host::error::Failure;

/// Find boards, examine one, time the way to it; save, back up, restore, name, restart or reflash it
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
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

/// Runs what was asked for.
pub fn run(args: Args) -> Result<(), Failure> {
    match args.what {
        What::List(args) => list::run(args),
        What::Latency(args) => latency::run(args),
        What::Report(args) => bug_report::run(args),
        What::Save(args) => save::run(args),
        What::Backup(args) => backup::run(args),
        What::Restore(args) => restore::run(args),
        What::Name(args) => name::run(args),
        What::Restart(args) => restart::run(args),
        What::Dfu(args) => dfu::run(args),
    }
}
