//! The virtual board: the unmodified firmware image on an emulated STM32F405, and the board's hardware around the chip.
//!
//! [`chip`] is the microcontroller, [`hardware`] is the board around it, and [`image`] is the ELF file that runs on it.
//! [`count`] counts the instructions between the markers of a counting image.
//!
//! Functions that prepare or drive a board panic if the board refuses a request or the image lacks a symbol.

pub mod angle_encoder;
pub mod boards;
pub mod campaign;
pub mod cases;
pub mod chip;
pub mod contact;
pub mod count;
pub mod cycles;
pub mod drv8301;
pub mod exchange;
pub mod hands;
pub mod hardware;
pub mod image;
pub mod inject;
pub mod load;
pub mod otg_core;
pub mod plant;
pub mod range;
pub mod rig;
pub mod rtt;
pub mod run;
pub mod sources;
pub mod timing;
pub mod trace;
pub mod usb;
pub mod wire;

use std::path::{Path, PathBuf};

/// Returns the path of the table docs/results/`name`.csv.
#[must_use]
pub fn results(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../docs/results/{name}.csv"))
}
