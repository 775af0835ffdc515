//! The images that are embedded in this program. `cargo xtask images` writes them to crates/flash/images, and the build
//! script embeds them.

use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use crate::image::Image;
use crate::update_file::parse;

include!(concat!(env!("OUT_DIR"), "/images.rs"));

/// Error message of a program without images.
pub const WITHOUT_IMAGES: &str = "this tool was built without images: in a checkout of its source, run `cargo xtask \
                                  images` and build it again, or name an update file";

/// An embedded image.
#[derive(Clone, Copy, Debug)]
pub struct EmbeddedImage {
    /// Kind of board.
    pub board: &'static str,
    /// The update file.
    pub file: &'static [u8],
    /// Description of the image, TOML.
    about: &'static str,
}

/// The description of an image.
#[derive(Deserialize)]
struct ImageDescription {
    version: String,
    protocol: u16,
    sha256: String,
}

/// Returns the embedded images; empty if the program was built without images.
pub fn embedded_images() -> &'static [EmbeddedImage] {
    IMAGES
}

impl EmbeddedImage {
    /// Checks the checksum and returns the image. Returns an error only in a broken build.
    pub fn image(&self) -> Result<Image, String> {
        let about: ImageDescription = toml::from_str(self.about).map_err(|error| error.to_string())?;
        if sha256(self.file) != about.sha256 {
            return Err("the embedded image does not match its SHA-256".into());
        }
        let image = parse(self.file).map_err(|error| error.to_string())?;
        if image.board != self.board {
            return Err(format!("the embedded image is for the board {}", image.board));
        }
        Ok(Image { version: Some(about.version), protocol: Some(about.protocol), ..image })
    }

    /// Returns the SHA-256 of the update file, in hexadecimal.
    pub fn sha256(&self) -> String {
        sha256(self.file)
    }
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
