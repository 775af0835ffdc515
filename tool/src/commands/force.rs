//! `--force`, an option of every command that writes files.

use haptic_host::error::Failure;
use haptic_host::output::{Overwrite, check};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct ForceOption {
    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

impl ForceOption {
    pub fn overwrite(&self) -> Overwrite {
        if self.force { Overwrite::Replace } else { Overwrite::Never }
    }

    /// Checks the files as [`ForceOption::check`] does, and refuses a picture with the extension of the other format.
    pub fn check_pictures(&self, svg: Option<&PathBuf>, png: Option<&PathBuf>) -> Result<(), Failure> {
        for (path, option, other) in [(svg, "--svg", "png"), (png, "--png", "svg")] {
            let ending = path.and_then(|path| Path::new(path).extension());
            if let (Some(path), true) = (path, ending.is_some_and(|ending| ending.eq_ignore_ascii_case(other))) {
                let reason = format!("{option} {} has the extension of another format", path.display());
                return Err(Failure::wrong(reason).remedy(format!("use --{other}, or another file name")));
            }
        }
        self.check(svg.into_iter().chain(png))
    }

    /// Returns an error for an existing file without `--force`, before the work is done.
    pub fn check<'a>(&self, paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Failure> {
        let mut files = paths.into_iter().filter(|path| path.as_os_str() != "-");
        files.try_for_each(|path| check(path, self.overwrite()))
    }
}
