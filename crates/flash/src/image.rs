//! A firmware image: its board, and its bytes with their addresses.

use std::ops::Range;

/// First address of flash and of every image, where the chip reads its vectors.
pub const FLASH_START: u32 = 0x0800_0000;
/// Addresses of the settings in sectors 1 and 2, which no image may overwrite (memory.x).
pub const SETTINGS: Range<u32> = 0x0800_4000..0x0800_C000;

/// Consecutive bytes of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// Address of the first byte.
    pub address: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

impl Segment {
    /// Returns the addresses of the bytes.
    pub fn range(&self) -> Range<u32> {
        self.address..self.address.saturating_add(self.bytes.len() as u32)
    }
}

/// An image with its known properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Kind of board.
    pub board: String,
    /// Version of the firmware, if known.
    pub version: Option<String>,
    /// Version of the firmware's protocol, if known.
    pub protocol: Option<u16>,
    /// Segments in ascending order.
    pub segments: Vec<Segment>,
}

/// An image that cannot be flashed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum BadImage {
    #[error("the image is empty")]
    Empty,
    #[error("the image has no vectors at {FLASH_START:#010x}, where the chip starts")]
    NoVectors,
    #[error("the image would overwrite the board's settings at {:#010x}", SETTINGS.start)]
    OverSettings,
    #[error("two segments of the image overlap at {0:#010x}")]
    Overlap(u32),
    #[error("a segment of the image at {0:#010x} does not fit into a chip's addresses")]
    TooLong(u32),
}

impl Image {
    /// Sorts the segments and checks that the image can be flashed.
    pub fn check(mut self) -> Result<Self, BadImage> {
        self.segments.retain(|segment| !segment.bytes.is_empty());
        self.segments.sort_by_key(|segment| segment.address);
        let first = self.segments.first().ok_or(BadImage::Empty)?;
        // The chip reads the initial stack pointer and the reset vector, two words.
        if first.address != FLASH_START || first.bytes.len() < 8 {
            return Err(BadImage::NoVectors);
        }
        for segment in &self.segments {
            // Adds 4, because the bytes are padded to words later.
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

    /// Returns the number of bytes in the image.
    pub fn size(&self) -> usize {
        self.segments.iter().map(|segment| segment.bytes.len()).sum()
    }
}
