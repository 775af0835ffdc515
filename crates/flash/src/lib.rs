//! Firmware on a board, through the boot loader that ST put into the chip.
//!
//! The boot loader speaks DfuSe: the USB DFU class (version 1.1a) with ST's commands in it, as AN2662 (a program that
//! flashes through it) shows; ST's AN3156, which specifies them, was not at hand. [`dfuse`] is one conversation with it over a [`Transport`],
//! [`plan`] says what is erased and written in which order, [`flash`] goes from a running board to the same board with
//! another image in it. Nothing here needs a USB stack: `usb` (a feature) brings the one there is, and tests put a
//! scripted boot loader in its place.
//!
//! `dfu-core` 0.11 and `dfu-nusb` 0.2 do not fit. They write one piece and leave the boot loader after it, and an image
//! has two with the settings between them; they cannot read back; they erase from the first address to the last; and
//! the second needs an executor.

pub mod dfuse;
mod embedded;
mod image;
mod layout;
mod plan;
pub mod probe;
mod sequence;
#[cfg(feature = "usb")]
mod site;
pub mod udev;
mod update_file;
#[cfg(feature = "usb")]
pub mod usb;

pub use dfuse::{DfuError, Transport, UsbError};
pub use embedded::{Embedded, WITHOUT_IMAGES, embedded};
pub use image::{BadImage, FLASH_START, Image, SETTINGS, Segment};
pub use layout::{BadLayout, Layout, Sector};
pub use plan::{Block, Misfit, Plan, plan};
pub use sequence::{
    BootLoader, Cause, Done, FlashError, Found, Opened, Progress, Said, Step, Surroundings, flash, look,
};
#[cfg(feature = "usb")]
pub use site::{Bus, motors_and_unsaved, put_back};
pub use update_file::{BadFile, parse};
