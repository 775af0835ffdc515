//! Update files that `cargo xtask` writes.

use haptic_bridge::checksum::crc32;
use haptic_flash::{BadFile, BadImage, Image, parse};

use crate::dfu;
use crate::rig::image;

fn written_file() -> (Image, Vec<u8>) {
    let image = image("odrive-v3", "0.1.0", 10);
    let file = dfu::file(&image.segments, &image.board);
    (image, file)
}

/// Corrects the checksum of a changed file.
fn with_checksum(mut file: Vec<u8>) -> Vec<u8> {
    let end = file.len() - 4;
    let sum = !crc32(&file[..end]);
    file[end..].copy_from_slice(&sum.to_le_bytes());
    file
}

#[test]
fn update_files_of_the_build_are_parsed() {
    let (image, file) = written_file();
    assert_eq!(parse(&file), Ok(Image { version: None, protocol: None, ..image }));
}

#[test]
fn any_changed_byte_is_detected() {
    let (_, file) = written_file();
    for at in (0..400).chain(file.len() - 40..file.len()) {
        let mut changed = file.clone();
        changed[at] ^= 0x10;
        assert!(parse(&changed).is_err(), "byte {at}");
    }
}

#[test]
fn wrong_lengths_are_refused_without_a_panic() {
    let (_, file) = written_file();
    for length in (0..400).chain([file.len() - 1]) {
        assert!(parse(&file[..length]).is_err());
        if length >= 20 {
            assert!(parse(&with_checksum(file[..length].to_vec())).is_err(), "{length}");
        }
    }
    // Offsets of the file length, target length, number of elements and first element length, bytes.
    for at in [6, 277, 281, 289] {
        for wrong in [0_u32, 1, 7, u32::MAX] {
            let mut changed = file.clone();
            changed[at..at + 4].copy_from_slice(&wrong.to_le_bytes());
            assert_eq!(parse(&with_checksum(changed)), Err(BadFile::Lengths), "{at}: {wrong}");
        }
    }
    assert_eq!(parse(b"\x7FELF").unwrap_err(), BadFile::NotDfuse);
    let two = {
        let mut file = file.clone();
        file[10] = 2;
        with_checksum(file)
    };
    assert_eq!(parse(&two), Err(BadFile::Targets(2)));
}

#[test]
fn a_file_that_would_overwrite_settings_is_refused() {
    let (mut image, _) = written_file();
    image.segments[0].bytes.resize(0x5000, 0);
    assert_eq!(parse(&dfu::file(&image.segments, "odrive-v3")), Err(BadFile::Image(BadImage::OverSettings)));
}
