//! `--force`, which every command that writes files takes.

use haptic_host::error::Failure;
use haptic_host::output::{Overwrite, check};
use std::path::{Path, PathBuf};

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

    /// [`Force::check`] of the pictures that are asked for, and that a file's ending is not the other kind's.
    pub fn pictures(&self, svg: Option<&PathBuf>, png: Option<&PathBuf>) -> Result<(), Failure> {
        for (path, option, other) in [(svg, "--svg", "png"), (png, "--png", "svg")] {
            let ending = path.and_then(|path| Path::new(path).extension());
            if let (Some(path), true) = (path, ending.is_some_and(|ending| ending.eq_ignore_ascii_case(other))) {
                let reason = format!("{option} {} would hold what its ending does not say", path.display());
                return Err(Failure::wrong(reason).remedy(format!("write --{other}, or name another file")));
            }
        }
        self.check(svg.into_iter().chain(png))
    }

    /// Refuses before the work is done what would be refused after it.
    pub fn check<'a>(&self, paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Failure> {
        let mut files = paths.into_iter().filter(|path| path.as_os_str() != "-");
        files.try_for_each(|path| check(path, self.overwrite()))
    }
}
