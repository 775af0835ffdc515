//! The images that this program was built with: `cargo xtask images` puts them into crates/flash/images, and the build
//! script takes in what is there.

use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use crate::image::Image;
use crate::update_file::parse;

include!(concat!(env!("OUT_DIR"), "/images.rs"));

/// What a program says that has none.
pub const WITHOUT_IMAGES: &str = "this tool was built without images: in a checkout of its source, run `cargo xtask \
                                  images` and build it again, or name an update file";

/// An image in this program.
#[derive(Clone, Copy, Debug)]
pub struct Embedded {
    /// The kind of board that it is for.
    pub board: &'static str,
    /// The update file.
    pub file: &'static [u8],
    /// What stands beside it, as TOML.
    about: &'static str,
}

/// What stands beside an image.
#[derive(Deserialize)]
struct About {
    version: String,
    protocol: u16,
    sha256: String,
}

/// The images in this program; none where it was built without.
pub fn embedded() -> &'static [Embedded] {
    IMAGES
}

impl Embedded {
    /// The image, once it matches its sum. `Err` says what is wrong with it, which only a broken build brings about.
    pub fn image(&self) -> Result<Image, String> {
        let about: About = toml::from_str(self.about).map_err(|error| error.to_string())?;
        if sha256(self.file) != about.sha256 {
            return Err("it does not match its SHA-256".into());
        }
        let image = parse(self.file).map_err(|error| error.to_string())?;
        if image.board != self.board {
            return Err(format!("it is for {}", image.board));
        }
        Ok(Image { version: Some(about.version), protocol: Some(about.protocol), ..image })
    }

    /// Its SHA-256, in hexadecimal.
    pub fn sha256(&self) -> String {
        sha256(self.file)
    }
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
