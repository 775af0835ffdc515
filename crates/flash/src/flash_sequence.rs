//! The flash sequence: the sectors to erase and the blocks to write and compare, in their order.
//!
//! The sector of the vectors is erased first and written last. Before the end the chip finds no vectors and starts no
//! program, so that an interrupted board keeps its bridges off. After a power cut while the vectors are written, the
//! checksum behind the vectors is missing, and the firmware refuses to arm (`ImageDamaged`).

use crate::image::{FLASH_START, Image, SETTINGS};
use crate::layout::{Layout, Sector};

/// The bytes of one write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Address of the first byte.
    pub address: u32,
    /// The bytes, padded to words.
    pub bytes: Vec<u8>,
}

/// All operations on the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashSequence {
    /// Sectors to erase, in this order.
    pub sectors: Vec<Sector>,
    /// Blocks to write and compare first, ascending.
    pub code: Vec<Block>,
    /// Blocks of the vectors' sector to write and compare last, descending, so that the vectors come last.
    pub vectors: Vec<Block>,
}

/// An image that does not fit a chip.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misfit {
    /// The chip has no flash at this address.
    #[error("the image needs flash at {0:#010x}, and this chip has none there: it is not the chip of this board")]
    NoFlash(u32),
    /// The sectors differ from an STM32F405's sectors, so that an erase could remove settings.
    #[error("the sectors of this chip are not those of an STM32F405: it is not the chip of this board")]
    OtherChip,
}

/// Start addresses of the chip's first sectors, four of 16 KB and one of 64 KB (RM0090, table "Flash module
/// organization").
const FIRST_SECTORS: [u32; 6] = [FLASH_START, 0x0800_4000, 0x0800_8000, 0x0800_C000, 0x0801_0000, 0x0802_0000];

/// Returns the flash sequence of an image, with blocks of at most `transfer` bytes.
pub fn flash_sequence(image: &Image, layout: &Layout, transfer: usize) -> Result<FlashSequence, Misfit> {
    if !layout.sectors.iter().map(|sector| sector.start).take(FIRST_SECTORS.len()).eq(FIRST_SECTORS) {
        return Err(Misfit::OtherChip);
    }
    let mut sectors: Vec<Sector> = Vec::new();
    let mut write = Vec::new();
    for segment in &image.segments {
        let range = segment.range();
        let mut at = range.start;
        while at < range.end {
            let sector =
                layout.sectors.iter().find(|sector| sector.usable && (sector.start..sector.end()).contains(&at));
            let sector = *sector.ok_or(Misfit::NoFlash(at))?;
            if sector.start < SETTINGS.end && SETTINGS.start < sector.end() {
                return Err(Misfit::OtherChip);
            }
            if !sectors.contains(&sector) {
                sectors.push(sector);
            }
            at = sector.end();
        }
        for (index, bytes) in segment.bytes.chunks(transfer).enumerate() {
            let mut bytes = bytes.to_vec();
            bytes.resize(bytes.len().next_multiple_of(4), 0xFF);
            write.push(Block { address: segment.address + (index * transfer) as u32, bytes });
        }
    }
    let vectors = sectors.iter().find(|sector| (sector.start..sector.end()).contains(&FLASH_START)).copied();
    let in_vector_sector = |address: u32| vectors.is_some_and(|sector| (sector.start..sector.end()).contains(&address));
    sectors.sort_by_key(|sector| (!in_vector_sector(sector.start), sector.start));
    let (mut vectors, code): (Vec<Block>, Vec<Block>) =
        write.into_iter().partition(|block| in_vector_sector(block.address));
    vectors.reverse();
    Ok(FlashSequence { sectors, code, vectors })
}
