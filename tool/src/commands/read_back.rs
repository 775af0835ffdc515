//! `--read` of `haptic device` and `haptic scene`: what a board has, as a file or held against one.

use super::force::Force;
use super::port::{OnBoard, counted};
use haptic_host::error::Failure;
use haptic_host::output;
use haptic_host::read_back::Difference;
use serde_json::json;
use std::path::{Path, PathBuf};

/// What is read, and where it goes.
#[derive(clap::Args)]
pub struct Read {
    /// Write what the board has as a file, to standard output; or with FILE list what differs there from the file, and
    /// end with exit code 3 if anything does. Changes nothing
    #[arg(long)]
    read: bool,
    /// Write it to this file
    #[arg(short, long, value_name = "FILE", requires = "read")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

impl Read {
    /// Returns true if the board is to be read; refuses first what could not be written later.
    pub fn asked(&self) -> Result<bool, Failure> {
        self.force.check(&self.output)?;
        Ok(self.read)
    }

    /// Writes `text`, the board's `what` as a file, where it was asked for; `compared` is a file, with what differs in
    /// the board.
    pub fn answer(
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
            return on.answer(document, &format!("the board's {what} is that of {}\n", file.display()));
        }
        let lines: String = differences.iter().map(|difference| format!("{difference}\n")).collect();
        on.answer(document, &format!("{} -> the board\n{lines}", file.display()))?;
        let count = counted(differences.len(), "difference");
        Err(Failure::different(format!("the board's {what} is not that of {}: {count}", file.display())))
    }
}

/// The file to load, where nothing is to be read.
pub fn needed(file: Option<&PathBuf>, what: &str) -> Result<PathBuf, Failure> {
    file.cloned().ok_or_else(|| {
        Failure::wrong(format!("no {what} file is named")).remedy("name one, or read the board's with --read")
    })
}
