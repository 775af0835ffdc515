//! Flashing without a USB stack: a scripted boot loader on a board with a cable and a power switch.

mod boot_loader;
mod images;
mod interrupted;
mod phases;
mod refusals;
mod rig;
mod session;
#[cfg(feature = "usb")]
mod settings;
mod update_files;

/// The writer of update files, with the modules that it imports.
#[path = "../../../../xtask/src/dfu.rs"]
mod dfu;
mod checksum {
    pub use haptic_bridge::checksum::crc32;
}
mod image {
    pub use haptic_flash::Segment;
}
