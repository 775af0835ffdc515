//! What is erased, written and compared, and in which order.
//!
//! The sector of the vectors is erased first and written last. While anything is missing, the chip finds no vectors and
//! starts nothing: a board that is interrupted has its bridges off, because nobody turns them on. A power cut within
//! the vectors leaves the checksum behind them unwritten, and the firmware then refuses to arm (`ImageDamaged`).

use crate::image::{FLASH_START, Image, SETTINGS};
use crate::layout::{Layout, Sector};

/// Bytes for one write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// The address of the first.
    pub address: u32,
    /// The bytes, whole words.
    pub bytes: Vec<u8>,
}

/// All that is done to the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Sectors to erase, in this order.
    pub erase: Vec<Sector>,
    /// What to write and compare first, ascending.
    pub code: Vec<Block>,
    /// What to write and compare last: the vectors' sector, and in it the vectors after what follows them.
    pub vectors: Vec<Block>,
}

/// Why an image does not go into a chip.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misfit {
    /// There is no flash there.
    #[error("the image needs flash at {0:#010x}, and this chip has none there: it is not the chip of this board")]
    NoFlash(u32),
    /// Sectors of another size, so that erasing for the image could erase settings.
    #[error("the sectors of this chip are not those of an STM32F405: it is not the chip of this board")]
    OtherChip,
}

/// Where the chip's first sectors begin, four of 16 KB and one of 64 KB (RM0090, table "Flash module organization").
const FIRST_SECTORS: [u32; 6] = [FLASH_START, 0x0800_4000, 0x0800_8000, 0x0800_C000, 0x0801_0000, 0x0802_0000];

/// Plans for blocks of at most `transfer` bytes.
pub fn plan(image: &Image, layout: &Layout, transfer: usize) -> Result<Plan, Misfit> {
    if !layout.sectors.iter().map(|sector| sector.start).take(FIRST_SECTORS.len()).eq(FIRST_SECTORS) {
        return Err(Misfit::OtherChip);
    }
    let mut erase: Vec<Sector> = Vec::new();
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
            if !erase.contains(&sector) {
                erase.push(sector);
            }
            at = sector.end();
        }
        for (index, bytes) in segment.bytes.chunks(transfer).enumerate() {
            let mut bytes = bytes.to_vec();
            bytes.resize(bytes.len().next_multiple_of(4), 0xFF);
            write.push(Block { address: segment.address + (index * transfer) as u32, bytes });
        }
    }
    let vectors = erase.iter().find(|sector| (sector.start..sector.end()).contains(&FLASH_START)).copied();
    let beside = |address: u32| vectors.is_some_and(|sector| (sector.start..sector.end()).contains(&address));
    erase.sort_by_key(|sector| (!beside(sector.start), sector.start));
    let (mut vectors, code): (Vec<Block>, Vec<Block>) = write.into_iter().partition(|block| beside(block.address));
    vectors.reverse();
    Ok(Plan { erase, code, vectors })
}
