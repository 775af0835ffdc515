//! The output of a command: text, or one document with `--json`; and pictures.

use super::force::ForceOption;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::output::{self, Overwrite};
use haptic_show::plot::paper::Paper;
use haptic_show::plot::{Picture, PictureError};
use serde::Serialize;
use std::path::PathBuf;

/// Environment variable with the path of a file that gets the document in addition to the printed text.
pub const DOCUMENT: &str = "HAPTIC_DOCUMENT";

/// `--json`, an option of every command that has results to print.
#[derive(Clone, Copy, clap::Args)]
pub struct Json {
    /// Print one JSON document
    #[arg(long = "json")]
    requested: bool,
}

impl Json {
    pub fn is_requested(self) -> bool {
        self.requested
    }

    /// Prints the document with `--json`, otherwise the text `words`. `haptic report` asks for both ([`DOCUMENT`]).
    pub fn answer(self, document: impl Serialize, words: &str) -> Result<(), Failure> {
        if let Some(path) = std::env::var_os(DOCUMENT) {
            let text = serde_json::to_string(&document).map_err(Failure::impossible)?;
            std::fs::write(path, text).map_err(Failure::impossible)?;
        }
        if self.requested { print_json(document) } else { print(words) }
    }
}

/// `--svg` and `--png`, with `--width` and `--force`: options of every command that draws its results.
#[derive(clap::Args)]
pub struct Pictures {
    /// Draw the picture into this SVG file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Draw the picture into this PNG file
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    /// Width of the picture on paper in mm, 60 to 400; its text then has at least 8 pt [default: a picture for a
    /// screen]
    #[arg(long, value_name = "MM", value_parser = parse_width)]
    width: Option<f64>,
    /// Write the text that belongs under a picture with --width into this file [default: standard error]
    #[arg(long, value_name = "FILE", requires = "width")]
    caption: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
}

/// Minimum and maximum width: narrower pictures have no room for the numbers along an axis, wider ones fit no page.
const WIDTHS_MM: (f64, f64) = (60.0, 400.0);

fn parse_width(text: &str) -> Result<f64, String> {
    let (min, max) = WIDTHS_MM;
    let width = text.parse().ok().filter(|mm| (min..=max).contains(mm));
    width.ok_or_else(|| format!("write a width of {min} to {max} mm; a column of a paper has 85 mm, a page 170 mm"))
}

impl Pictures {
    /// Returns an error, before the work, for files that could not be written after it.
    pub fn check(&self) -> Result<(), Failure> {
        self.force.check(&self.caption)?;
        self.force.check_pictures(self.svg.as_ref(), self.png.as_ref())
    }

    pub fn is_requested(&self) -> bool {
        self.svg.is_some() || self.png.is_some()
    }

    pub fn paper(&self) -> Paper {
        Paper(self.width)
    }

    pub fn save(&self, picture: &Picture) -> Result<(), PictureError> {
        self.svg.as_deref().map_or(Ok(()), |path| picture.save_svg(path))?;
        self.png.as_deref().map_or(Ok(()), |path| picture.save_png(path))?;
        match &self.caption {
            Some(path) => output::write(path, format!("{}\n", picture.caption()).as_bytes(), Overwrite::Replace)?,
            None if picture.caption().is_empty() => {}
            None => haptic_host::tell!("caption: {}", picture.caption()),
        }
        Ok(())
    }
}
