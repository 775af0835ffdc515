//! Flashing without a USB stack: the steps against a scripted boot loader on a board with a cable and a power switch.

mod bench;
mod boot_loader;
mod conversation;
mod images;
mod interrupted;
mod refusals;
#[cfg(feature = "usb")]
mod settings;
mod steps;
mod update_files;

/// The writer of update files, with what it expects around itself.
#[path = "../../../../xtask/src/dfu.rs"]
mod dfu;
mod checksum {
    pub use haptic_bridge::checksum::crc32;
}
mod image {
    pub use haptic_flash::Segment;
}
