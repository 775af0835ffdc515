//! `--read` of `haptic device` and `haptic scene`: writes a board's device or scene as text, or compares it with a file.

use super::force::ForceOption;
use super::port::{OnBoard, counted};
use haptic_host::error::Failure;
use haptic_host::output;
use haptic_host::read_back::Difference;
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct ReadOptions {
    /// Write the board's contents to standard output; or with FILE list the differences between that file and the
    /// board, and end with exit code 3 if there are any. Changes nothing
    #[arg(long)]
    read: bool,
    /// Write to this file instead
    #[arg(short, long, value_name = "FILE", requires = "read")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
}

impl ReadOptions {
    /// Returns true if `--read` was given. Refuses an output file that could not be written later.
    pub fn is_requested(&self) -> Result<bool, Failure> {
        self.force.check(&self.output)?;
        Ok(self.read)
    }

    /// Writes `text`, the text form of the board's `what`, or reports its differences from the file in `compared`.
    pub fn report(
        &self,
        on: &OnBoard,
        what: &str,
        text: Result<String, Failure>,
        compared: Option<(&Path, Vec<Difference>)>,
    ) -> Result<(), Failure> {
        if let Some(path) = &self.output {
            output::write(path, text.clone()?.as_bytes(), self.force.overwrite())?;
        }
        let Some((file, differences)) = compared else {
            let written = self.output.as_ref().map(|path| format!("{}: the board's {what}\n", path.display()));
            let text = text?;
            return on.answer(json!({ "toml": text }), &written.unwrap_or_else(|| text.clone()));
        };
        let document = json!({ "file": file.display().to_string(), "differences": differences });
        if differences.is_empty() {
            return on.answer(document, &format!("the board's {what} is the same as in {}\n", file.display()));
        }
        let lines: String = differences.iter().map(|difference| format!("{difference}\n")).collect();
        on.answer(document, &format!("{} -> the board\n{lines}", file.display()))?;
        let count = counted(differences.len(), "difference");
        Err(Failure::different(format!("the board's {what} is not the same as in {}: {count}", file.display())))
    }
}

/// Returns the file to load; without `--read` the file is required.
pub fn required_file(file: Option<&PathBuf>, what: &str) -> Result<PathBuf, Failure> {
    file.cloned().ok_or_else(|| {
        Failure::wrong(format!("no {what} file is given")).remedy("give one, or read the board's with --read")
    })
}
