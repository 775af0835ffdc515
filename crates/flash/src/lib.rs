//! Flashes firmware onto a board through ST's boot loader in the chip.
//!
//! The protocol of the boot loader is DfuSe, the USB DFU class (version 1.1a) with ST's commands. The source is AN2662;
//! ST's AN3156, which specifies the commands, was not available. [`dfuse`] is a session with the boot loader over a
//! [`Transport`], [`flash_sequence`] returns the blocks to erase and write, and [`flash`] flashes a board. The feature
//! `usb` adds a USB stack; tests use a scripted boot loader instead.
//!
//! The crates `dfu-core` 0.11 and `dfu-nusb` 0.2 are not used, because they write only one segment, cannot read back,
//! and erase all sectors from the first address to the last. An image has two segments with the settings between them.

pub mod dfuse;
mod embedded;
mod flash_sequence;
mod flashing;
mod image;
mod layout;
pub mod probe;
#[cfg(feature = "usb")]
mod site;
pub mod udev;
mod update_file;
#[cfg(feature = "usb")]
pub mod usb;

pub use dfuse::{DfuError, Transport, UsbError};
pub use embedded::{EmbeddedImage, WITHOUT_IMAGES, embedded_images};
pub use flash_sequence::{Block, FlashSequence, Misfit, flash_sequence};
pub use flashing::{
    BootLoader, Cause, FlashError, FlashSummary, FlashTarget, Identity, OpenBootLoader, Phase, Progress, Surroundings,
    find_board, flash,
};
pub use image::{BadImage, FLASH_START, Image, SETTINGS, Segment};
pub use layout::{BadLayout, Layout, Sector};
#[cfg(feature = "usb")]
pub use site::{Bus, motors_on_and_unsaved_settings, restore_lost_settings};
pub use update_file::{BadFile, parse};
