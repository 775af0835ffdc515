//! DfuSe update files, which contain an image in segments, so that the settings between the segments are not erased.
//!
//! The format is STMicroelectronics UM0391, "DfuSe file format specification". All numbers are little-endian.

use crate::checksum::crc32;
use crate::image::Segment;

/// USB vendor id of the STM32's boot loader.
const VENDOR_ID: u16 = 0x0483;
/// USB product id of the STM32's boot loader.
const PRODUCT_ID: u16 = 0xDF11;

/// Returns an update file of these segments for the boot loader's internal flash (alternate setting 0), with the
/// board's name.
pub fn file(segments: &[Segment], name: &str) -> Vec<u8> {
    let mut elements = Vec::new();
    for segment in segments {
        elements.extend(segment.address.to_le_bytes());
        elements.extend((segment.bytes.len() as u32).to_le_bytes());
        elements.extend(&segment.bytes);
    }

    let mut target = Vec::new();
    target.extend(b"Target");
    target.push(0);
    target.extend(1_u32.to_le_bytes());
    let mut label = [0; 255];
    for (slot, byte) in label.iter_mut().zip(name.bytes()) {
        *slot = byte;
    }
    target.extend(label);
    target.extend((elements.len() as u32).to_le_bytes());
    target.extend((segments.len() as u32).to_le_bytes());
    target.extend(elements);

    let mut file = Vec::new();
    file.extend(b"DfuSe");
    file.push(1);
    file.extend((11 + target.len() as u32).to_le_bytes());
    file.push(1);
    file.extend(target);

    file.extend(0xFFFF_u16.to_le_bytes());
    file.extend(PRODUCT_ID.to_le_bytes());
    file.extend(VENDOR_ID.to_le_bytes());
    file.extend(0x011A_u16.to_le_bytes());
    file.extend(b"UFD");
    file.push(16);
    // The suffix contains the CRC without its final inversion.
    let check = !crc32(&file);
    file.extend(check.to_le_bytes());
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_every_segment_at_its_address() {
        let segments =
            [Segment { address: 0x0800_0000, bytes: vec![1; 8] }, Segment { address: 0x0800_C000, bytes: vec![2; 4] }];
        let file = file(&segments, "odrive-v3");
        // The file has a prefix of 11 bytes, a target prefix of 274, two element headers of 8, the bytes, and a suffix
        // of 16.
        assert_eq!(file.len(), 11 + 274 + 2 * 8 + 8 + 4 + 16);
        let size = u32::from_le_bytes(file[6..10].try_into().unwrap());
        assert_eq!(size as usize, file.len() - 16);
        assert_eq!(file[11 + 274..][..4], 0x0800_0000_u32.to_le_bytes());
        assert_eq!(file[11 + 274 + 16..][..4], 0x0800_C000_u32.to_le_bytes());
        assert_eq!(&file[file.len() - 8..file.len() - 4], b"UFD\x10");
        let (checked, check) = file.split_at(file.len() - 4);
        assert_eq!(check, (!crc32(checked)).to_le_bytes(), "without the final inversion");
    }
}
