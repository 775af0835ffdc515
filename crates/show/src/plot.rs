//! Pictures for papers and notes, drawn as SVG; PNG is rendered from the SVG.
//!
//! - [`canvas`]: an SVG document and its shapes
//! - [`axes`]: a framed coordinate system with round ticks, curves, dots with error bars, and a legend
//! - [`cogging`]: a motor's cogging over the joint's angle
//! - [`colour`]: the palette, and a colour scale that also works in print
//! - [`coupling`]: the linkage moved along a normal, and its coupling over all directions (the paper's Fig. 1)
//! - [`device`]: a device at home, with its joints
//! - [`linkage`]: a device's links and joints
//! - [`map`]: inertia over the workspace (the paper's Fig. 1)
//! - [`paddle`]: the reach of a device with one joint, which has no map
//! - [`paper`]: page widths on a screen and on paper, and text wrapping
//! - [`range`]: the stable domain of a device (the paper's Fig. 3)
//! - [`signals`]: a recording over time, over penetration, as a spectrum, as a phase portrait
//! - [`speed`]: instructions of each variant of the control step, over its error
//! - [`why`]: the reduction of the stable range by each effect
//!
//! PNG is rendered by resvg with the DejaVu fonts compiled in, so a picture is the same on every machine.

pub mod axes;
pub mod canvas;
pub mod cogging;
pub mod colour;
pub mod coupling;
pub mod device;
pub mod linkage;
pub mod map;
pub mod paddle;
pub mod paper;
pub mod range;
pub mod signals;
pub mod speed;
pub mod why;

use std::path::Path;

use haptic_host::error::Failure;
use haptic_host::output::{self, Overwrite};
use thiserror::Error;

/// Pixels of a PNG per unit of its SVG.
#[cfg(feature = "png")]
const PNG_SCALE: f32 = 2.0;
/// Pixels of a PNG per unit of an SVG with a size on paper: 600 pixels per inch, 96 units per inch.
#[cfg(feature = "png")]
const PRINTED_SCALE: f32 = 600.0 / 96.0;

/// Reason why a picture could not be written.
#[derive(Debug, Error)]
pub enum PictureError {
    /// The file could not be written.
    #[error(transparent)]
    File(#[from] Failure),
    /// The drawing could not be converted to pixels.
    #[error("the picture cannot be drawn: {0}")]
    Drawing(String),
}

impl From<PictureError> for Failure {
    fn from(error: PictureError) -> Self {
        match error {
            PictureError::File(failure) => failure,
            PictureError::Drawing(_) => Self::impossible(error),
        }
    }
}

/// A finished drawing.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    svg: String,
    /// Text that belongs to a picture on paper, but not into it.
    caption: String,
    /// True if the picture has a size on paper, which determines its number of pixels.
    #[cfg_attr(not(feature = "png"), allow(dead_code, reason = "only PNG uses it"))]
    printed: bool,
}

impl Picture {
    /// Returns the SVG document.
    pub fn svg(&self) -> &str {
        &self.svg
    }

    /// Returns the text for the caption of a picture on paper; empty for a screen, whose pictures contain it.
    pub fn caption(&self) -> &str {
        &self.caption
    }

    /// Writes the picture as SVG. Replaces an existing file: callers check for one before the work ([`output::check`]).
    pub fn save_svg(&self, path: &Path) -> Result<(), PictureError> {
        Ok(output::write(path, self.svg.as_bytes(), Overwrite::Replace)?)
    }

    #[cfg(feature = "png")]
    /// Writes the picture as PNG, with two pixels per unit, or with 600 per inch if it has a size on paper. Replaces an
    /// existing file, like [`Picture::save_svg`].
    pub fn save_png(&self, path: &Path) -> Result<(), PictureError> {
        Ok(output::write(path, &self.png()?, Overwrite::Replace)?)
    }

    #[cfg(feature = "png")]
    /// Returns the bytes of the PNG.
    pub fn png(&self) -> Result<Vec<u8>, PictureError> {
        use resvg::{tiny_skia, usvg};
        let drawing = |reason: String| PictureError::Drawing(reason);
        let mut fonts = usvg::fontdb::Database::new();
        fonts.load_font_data(dejavu::sans::regular().to_vec());
        fonts.load_font_data(dejavu::sans::bold().to_vec());
        fonts.load_font_data(dejavu::sans::oblique().to_vec());
        let options = usvg::Options {
            fontdb: std::sync::Arc::new(fonts),
            font_family: canvas::FONT_FAMILY.into(),
            ..usvg::Options::default()
        };
        let tree = usvg::Tree::from_str(&self.svg, &options).map_err(|e| drawing(e.to_string()))?;
        let scale = if self.printed { PRINTED_SCALE } else { PNG_SCALE };
        let size = tree.size().to_int_size().scale_by(scale).ok_or_else(|| drawing("it has no size".into()))?;
        let mut pixels =
            tiny_skia::Pixmap::new(size.width(), size.height()).ok_or_else(|| drawing("it is too large".into()))?;
        resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut pixels.as_mut());
        pixels.encode_png().map_err(|e| drawing(e.to_string()))
    }
}
