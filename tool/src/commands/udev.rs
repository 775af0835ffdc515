//! `haptic udev`: the udev rule that lets a user open boards and boot loaders on Linux.

use super::force::ForceOption;
use haptic_flash::udev::{RULE_PATH, rule};
use haptic_host::error::{Failure, print};
use haptic_host::output;
use std::path::{Path, PathBuf};

/// Write the rule that lets you open boards and boot loaders on Linux
///
/// Without a file the rule is printed: haptic udev | sudo tee /etc/udev/rules.d/70-haptic-bridge.rules, then sudo
/// udevadm control --reload and plug the board in again.
#[derive(clap::Args)]
pub struct Args {
    /// File to write
    file: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let Some(file) = args.file else { return print(&rule()) };
    output::write(&file, rule().as_bytes(), args.force.overwrite())?;
    let next = "`sudo udevadm control --reload`, then plug the board in again";
    match file == Path::new(RULE_PATH) {
        true => print(&format!("{}: written; {next}\n", file.display())),
        false => print(&format!("{}: written; copy it to {RULE_PATH}, {next}\n", file.display())),
    }
}
