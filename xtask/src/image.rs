//! Reads the size of an image in flash and RAM from its ELF file, and checks that the image does not overwrite the
//! settings.

use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader as _, ProgramHeader as _};
use object::{Endianness, Object as _, ObjectSection as _, ObjectSymbol as _, SectionFlags};

use crate::checksum::crc32;

/// Addresses of the flash of the STM32F405RG.
const FLASH: Range<u64> = 0x0800_0000..0x0810_0000;
/// Addresses of the RAM of the STM32F405RG without the core-coupled memory.
const RAM: Range<u64> = 0x2000_0000..0x2002_0000;
/// Addresses of the settings, sectors 1 and 2.
const SETTINGS: Range<u64> = 0x0800_4000..0x0800_C000;

/// Maximum size of an image in flash, bytes: half of the chip's flash.
pub const FLASH_LIMIT: u64 = 512 * 1024;
/// Maximum size of statics and reserved stack together, bytes: three quarters of the chip's SRAM.
pub const RAM_LIMIT: u64 = 96 * 1024;

/// Writes an image's checksum, which the firmware checks at every start, into the word that memory.x reserves. The
/// checksum is the CRC-32 of the vectors up to this word, and of all bytes from the first instruction to the last
/// initial value of a static.
pub fn seal(path: &Path) -> Result<()> {
    let mut data = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let image = Image::read(path)?;
    let file = object::File::parse(&*data).context("bad ELF file")?;
    let symbol = |name: &str| {
        let found = file.symbols().find(|symbol| symbol.name() == Ok(name)).map(|symbol| symbol.address() as u32);
        found.with_context(|| format!("the image has no symbol {name}"))
    };
    let check = symbol("_image_check")?;
    let parts = [
        symbol("__vector_table")?..check,
        symbol("__stext")?..symbol("__sidata")? + symbol("__edata")? - symbol("__sdata")?,
    ];
    let place = file.section_by_name(".image_check").and_then(|section| section.file_range());
    let (offset, _) = place.context("the image has no section .image_check for its checksum")?;
    let bytes: Vec<u8> = parts.into_iter().flatten().map(|address| image.byte(address)).collect();
    let at = offset as usize;
    data[at..at + 4].copy_from_slice(&crc32(&bytes).to_le_bytes());
    fs::write(path, data).with_context(|| format!("cannot write {}", path.display()))
}

pub struct Segment {
    /// First address in flash.
    pub address: u32,
    pub bytes: Vec<u8>,
}

/// Segments and sizes of an image.
pub struct Image {
    /// Segments in flash, by ascending address.
    pub segments: Vec<Segment>,
    /// Flash of the segments, bytes.
    pub flash: u64,
    /// RAM of the statics, bytes.
    pub statics: u64,
    /// RAM that the linker script reserves for the stack, bytes.
    pub stack: u64,
}

impl Image {
    pub fn read(path: &Path) -> Result<Self> {
        let data = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let header = FileHeader32::<Endianness>::parse(&*data).context("not a 32-bit ELF file")?;
        let endian = header.endian().context("bad ELF header")?;
        let mut segments = Vec::new();
        for segment in header.program_headers(endian, &*data).context("bad program headers")? {
            if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
                continue;
            }
            let bytes = segment.data(endian, &*data).ok().context("a segment is outside the file")?;
            segments.push(Segment { address: segment.p_paddr(endian), bytes: bytes.to_vec() });
        }
        segments.sort_by_key(|segment| segment.address);
        let mut flash = 0;
        for segment in &segments {
            let range = u64::from(segment.address)..u64::from(segment.address) + segment.bytes.len() as u64;
            ensure!(FLASH.contains(&range.start) && range.end <= FLASH.end, "a segment at {range:#x?} is not in flash");
            if range.start < SETTINGS.end && SETTINGS.start < range.end {
                bail!("a segment at {range:#x?} would overwrite the settings at {SETTINGS:#x?}");
            }
            flash += range.end - range.start;
        }

        let file = object::File::parse(&*data).context("bad ELF file")?;
        let statics = file
            .sections()
            .filter(|section| RAM.contains(&section.address()))
            .filter(|section| matches!(section.flags(), SectionFlags::Elf { sh_flags } if sh_flags & 2 != 0))
            .map(|section| section.size())
            .sum();
        let symbol =
            |name: &str| file.symbols().find(|symbol| symbol.name() == Ok(name)).map(|symbol| symbol.address());
        let (top, bottom) = (symbol("_stack_start"), symbol("_stack_end"));
        let stack = top.zip(bottom).context("the image has no symbols _stack_start and _stack_end")?;
        Ok(Self { segments, flash, statics, stack: stack.0 - stack.1 })
    }

    /// Returns the byte at this address after the image is written. Bytes between segments are erased (0xFF).
    fn byte(&self, address: u32) -> u8 {
        let inside = |segment: &&Segment| address.wrapping_sub(segment.address) < segment.bytes.len() as u32;
        self.segments.iter().find(inside).map_or(0xFF, |segment| segment.bytes[(address - segment.address) as usize])
    }
    /// Returns the RAM of statics and reserved stack, bytes.
    pub fn ram(&self) -> u64 {
        self.statics + self.stack
    }
}
