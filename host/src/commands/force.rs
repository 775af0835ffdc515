//! `--force`, which every command that writes files takes.

use haptic::error::Failure;
use haptic::output::{Overwrite, check};
use std::path::PathBuf;

/// Whether files may be replaced.
#[derive(clap::Args)]
pub struct Force {
    /// Replace a file that is there already
    #[arg(long)]
    force: bool,
}

impl Force {
    /// As the library says it.
    pub fn overwrite(&self) -> Overwrite {
        if self.force { Overwrite::Replace } else { Overwrite::Never }
    }

    /// Refuses before the work is done what would be refused after it.
    pub fn check<'a>(&self, paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Failure> {
        let mut files = paths.into_iter().filter(|path| path.as_os_str() != "-");
        files.try_for_each(|path| check(path, self.overwrite()))
    }
}
