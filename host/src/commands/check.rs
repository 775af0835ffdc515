//! `haptic check`: reads device files and says whether they are sound, without a board.

use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use std::path::PathBuf;

/// Check device files, without a board
#[derive(clap::Args)]
pub struct Args {
    /// Device files (TOML)
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
}

/// Checks every file; stops at the first that is wrong.
pub fn run(args: Args) -> Result<(), Failure> {
    for path in args.files {
        let device = DeviceFile::load(&path)?;
        let spec = device.spec();
        print(&format!("{}: {} ({}, {} joints), sound\n", path.display(), device.name, spec.name, spec.joints))?;
    }
    Ok(())
}
