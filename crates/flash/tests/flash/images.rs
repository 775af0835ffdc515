//! The images embedded in this build, if any.

use haptic_flash::{Layout, SETTINGS, WITHOUT_IMAGES, embedded_images, flash_sequence};

use crate::boot_loader::MEMORY;

#[test]
fn every_embedded_image_is_valid_and_has_board_and_version() {
    for image in embedded_images() {
        let image_file = image.image().unwrap_or_else(|error| panic!("{}: {error}", image.board));
        assert_eq!(image_file.board, image.board);
        assert!(image_file.version.is_some() && image_file.protocol.is_some());
        assert!(image_file.size() > 100_000, "{} bytes", image_file.size());
        let sequence = flash_sequence(&image_file, &Layout::parse(MEMORY).unwrap(), 2048).unwrap();
        assert!(sequence.sectors.iter().all(|sector| sector.end() <= SETTINGS.start || SETTINGS.end <= sector.start));
        assert_eq!(sequence.vectors.len(), 1, "one block with the checksum behind the vectors");
    }
}

#[test]
fn a_build_without_images_names_the_remedy() {
    assert!(WITHOUT_IMAGES.contains("cargo xtask images") && WITHOUT_IMAGES.contains("update file"));
}
