//! The `haptic` library: device and scene files, and everything the command-line tool does with them.
#![forbid(unsafe_code)]

pub mod analysis;
pub mod backup;
pub mod bench;
pub mod demo;
pub mod device_file;
pub mod error;
pub mod file_error;
pub mod interrupt;
pub mod link;
pub mod measure;
pub mod model;
pub mod plan;
pub mod plot;
pub mod precision;
pub mod recorder;
pub mod scene_file;
pub mod sim;
pub mod toml_file;
