//! DfuSe update files, which contain the segments of an image and the name of its board. `cargo xtask` writes them.
//!
//! The format is STMicroelectronics UM0391, "DfuSe file format specification". All numbers are little-endian.

use haptic_bridge::checksum::crc32;

use crate::image::{BadImage, Image, Segment};

/// A file that is not a valid update file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum BadFile {
    #[error("the file is not a DfuSe update file (.dfu), such as `cargo xtask dfu BOARD` writes")]
    NotDfuse,
    #[error("the file is damaged: its checksum is wrong")]
    Damaged,
    #[error("the file is damaged: its lengths contradict its contents")]
    Lengths,
    #[error("the file is for {0} memories instead of one")]
    Targets(u8),
    #[error(transparent)]
    Image(#[from] BadImage),
}

/// Parses a file. The board of the image is the name in the file. The versions are `None`, because no file contains
/// them.
pub fn parse(file: &[u8]) -> Result<Image, BadFile> {
    if !file.starts_with(b"DfuSe\x01") {
        return Err(BadFile::NotDfuse);
    }
    let (content, suffix) = file.split_last_chunk::<16>().ok_or(BadFile::Lengths)?;
    if &suffix[8..12] != b"UFD\x10" {
        return Err(BadFile::NotDfuse);
    }
    let (summed, sum) = file.split_last_chunk::<4>().ok_or(BadFile::Lengths)?;
    // The suffix contains the CRC without its final inversion.
    if !crc32(summed) != u32::from_le_bytes(*sum) {
        return Err(BadFile::Damaged);
    }
    let mut rest = content.get(6..).ok_or(BadFile::Lengths)?;
    let length = number(&mut rest)?;
    let [targets] = *bytes::<1>(&mut rest)?;
    if length as usize != content.len() {
        return Err(BadFile::Lengths);
    }
    if targets != 1 {
        return Err(BadFile::Targets(targets));
    }
    let prefix = bytes::<266>(&mut rest)?;
    let (size, elements) = (number(&mut rest)?, number(&mut rest)?);
    if !prefix.starts_with(b"Target") || size as usize != rest.len() {
        return Err(BadFile::Lengths);
    }
    // The prefix is "Target", the alternate setting, the flag for a name, and the name from byte 11.
    let board = prefix[11..].split(|byte| *byte == 0).next().unwrap_or_default();
    let mut segments = Vec::new();
    for _ in 0..elements {
        let (address, length) = (number(&mut rest)?, number(&mut rest)?);
        let (bytes, after) = rest.split_at_checked(length as usize).ok_or(BadFile::Lengths)?;
        segments.push(Segment { address, bytes: bytes.to_vec() });
        rest = after;
    }
    if !rest.is_empty() {
        return Err(BadFile::Lengths);
    }
    let board = String::from_utf8_lossy(board).into_owned();
    Ok(Image { board, version: None, protocol: None, segments }.check()?)
}

fn bytes<'a, const N: usize>(rest: &mut &'a [u8]) -> Result<&'a [u8; N], BadFile> {
    let (first, after) = rest.split_first_chunk::<N>().ok_or(BadFile::Lengths)?;
    *rest = after;
    Ok(first)
}

fn number(rest: &mut &[u8]) -> Result<u32, BadFile> {
    bytes::<4>(rest).map(|bytes| u32::from_le_bytes(*bytes))
}
