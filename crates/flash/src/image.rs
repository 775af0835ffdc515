//! A firmware image: whose it is, and which bytes go where.

use std::ops::Range;

/// Where flash begins, and with it every image: the chip looks for its vectors there.
pub const FLASH_START: u32 = 0x0800_0000;
/// Where the settings are, which no image touches (memory.x): sectors 1 and 2.
pub const SETTINGS: Range<u32> = 0x0800_4000..0x0800_C000;

/// Bytes that belong together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// The address of the first.
    pub address: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

impl Segment {
    /// The addresses that it fills.
    pub fn range(&self) -> Range<u32> {
        self.address..self.address.saturating_add(self.bytes.len() as u32)
    }
}

/// An image and what is known of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// The kind of board that it is for.
    pub board: String,
    /// The firmware's version, where it is known.
    pub version: Option<String>,
    /// Its version of the protocol, where it is known.
    pub protocol: Option<u16>,
    /// Its pieces, ascending.
    pub segments: Vec<Segment>,
}

/// Why an image cannot be flashed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadImage {
    /// Nothing is in it.
    #[error("the image is empty")]
    Empty,
    /// It would not start.
    #[error("the image has no vectors at {FLASH_START:#010x}, where the chip begins")]
    NoVectors,
    /// It reaches into the settings.
    #[error("the image would overwrite the board's settings at {:#010x}", SETTINGS.start)]
    OverSettings,
    /// Two pieces want the same place.
    #[error("two pieces of the image overlap at {0:#010x}")]
    Overlap(u32),
    /// A piece that flash cannot take.
    #[error("a piece of the image at {0:#010x} does not fit into a chip's addresses")]
    TooLong(u32),
}

impl Image {
    /// Whether it can be flashed at all; sorts its pieces.
    pub fn checked(mut self) -> Result<Self, BadImage> {
        self.segments.retain(|segment| !segment.bytes.is_empty());
        self.segments.sort_by_key(|segment| segment.address);
        let first = self.segments.first().ok_or(BadImage::Empty)?;
        // The stack's first address and where to begin are two words.
        if first.address != FLASH_START || first.bytes.len() < 8 {
            return Err(BadImage::NoVectors);
        }
        for segment in &self.segments {
            // The bytes are padded to words.
            if u64::from(segment.address) + segment.bytes.len() as u64 + 4 > u64::from(u32::MAX) {
                return Err(BadImage::TooLong(segment.address));
            }
            let range = segment.range();
            if range.start < SETTINGS.end && SETTINGS.start < range.end {
                return Err(BadImage::OverSettings);
            }
        }
        for pair in self.segments.windows(2) {
            if pair[0].range().end > pair[1].address {
                return Err(BadImage::Overlap(pair[1].address));
            }
        }
        Ok(self)
    }

    /// Bytes that it fills.
    pub fn size(&self) -> usize {
        self.segments.iter().map(|segment| segment.bytes.len()).sum()
    }
}
