//! The images that this build took in, if it did.

use haptic_flash::{Layout, SETTINGS, WITHOUT_IMAGES, embedded, plan};

use crate::boot_loader::MEMORY;

#[test]
fn every_image_in_this_build_is_whole_and_has_its_board_and_version() {
    for image in embedded() {
        let whole = image.image().unwrap_or_else(|error| panic!("{}: {error}", image.board));
        assert_eq!(whole.board, image.board);
        assert!(whole.version.is_some() && whole.protocol.is_some());
        assert!(whole.size() > 100_000, "{} bytes", whole.size());
        let plan = plan(&whole, &Layout::parse(MEMORY).unwrap(), 2048).unwrap();
        assert!(plan.erase.iter().all(|sector| sector.end() <= SETTINGS.start || SETTINGS.end <= sector.start));
        assert_eq!(plan.vectors.len(), 1, "with the checksum behind them, in one piece");
    }
}

#[test]
fn a_build_without_images_says_how_to_get_them() {
    assert!(WITHOUT_IMAGES.contains("cargo xtask images") && WITHOUT_IMAGES.contains("update file"));
}
