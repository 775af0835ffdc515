//! A command's answer: words, or with `--json` one document; and pictures of it.

use super::force::Force;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_show::plot::{Picture, PictureError};
use serde::Serialize;
use std::path::PathBuf;

/// `--json`, which every command takes that has more to say than that it is done.
#[derive(Clone, Copy, clap::Args)]
pub struct Json {
    /// Print one JSON document
    #[arg(long = "json")]
    asked: bool,
}

impl Json {
    /// Returns true if the document was asked for.
    pub fn asked(self) -> bool {
        self.asked
    }

    /// Prints the document where that was asked for, else these words.
    pub fn answer(self, document: impl Serialize, words: &str) -> Result<(), Failure> {
        if self.asked { print_json(document) } else { print(words) }
    }
}

/// `--svg` and `--png`, with `--force`: which every command takes that draws its results.
#[derive(clap::Args)]
pub struct Pictures {
    /// Draw the picture into this SVG file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Draw the same into this PNG file
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

impl Pictures {
    /// Refuses, before any work is done, files that could not be written after it.
    pub fn check(&self) -> Result<(), Failure> {
        self.force.pictures(self.svg.as_ref(), self.png.as_ref())
    }

    /// Returns true if a picture was asked for.
    pub fn asked(&self) -> bool {
        self.svg.is_some() || self.png.is_some()
    }

    /// Writes the files that were asked for.
    pub fn save(&self, picture: &Picture) -> Result<(), PictureError> {
        self.svg.as_deref().map_or(Ok(()), |path| picture.save_svg(path))?;
        self.png.as_deref().map_or(Ok(()), |path| picture.save_png(path))
    }
}
