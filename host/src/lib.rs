//! Configure, watch, simulate and analyse haptic devices: everything that the `haptic` tool does, for programs.
//!
//! A board, real or simulated, is a [`link::Board`]: one method for every request, and rows of telemetry.
//!
//! ```no_run
//! use haptic::{device_file::DeviceFile, link::Board, scene_file::SceneFile};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let device = DeviceFile::load("devices/coupled-five-bar.toml")?;
//! let scene = SceneFile::load("devices/scenes/coupled-five-bar/wall.toml", device.spec().task)?;
//! // A serial number or a port, as `haptic --port` takes it; "sim" is a simulated board.
//! let mut board = Board::open(&"sim".parse()?)?;
//! board.set_device(&device.device()?)?;
//! board.set_scene(&scene.scene()?)?;
//! board.arm()?;
//! # board.disarm()?;
//! # Ok(())
//! # }
//! ```
//!
//! | to | begin at |
//! |---|---|
//! | talk to a board | [`link`] |
//! | push through one, 1000 times a second | [`link::Session`] |
//! | read device and scene files | [`device_file`], [`scene_file`] |
//! | simulate a board, a device and a hand | [`sim`] |
//! | evaluate the inertia of a pose | [`model`] |
//! | predict which walls are stable | [`analysis`] |
//! | measure it on a board | [`measure`]; the way to one and back: [`latency`] |
//! | find the cheapest step that is good enough | [`plan`], [`mod@bench`] |
//! | find the settings of the stiffest wall | [`mod@tune`] |
//! | find the best place, direction, posture and links for one | [`mod@design`] |
//! | let programs made for other devices use one | [`haply`], [`frame`] |
//! | draw | [`plot`] |
//! | record, and play a recording once more | [`recorder`], [`replay`] |
//! | show a device in the browser, in a terminal | [`view`], [`monitor`] |
//!
//! What a program does not need it can leave out: with `default-features = false` there is neither the command line nor
//! PNG (feature `png`) nor HTTP and WebSocket (`serve`: the door of [`view`], [`haply`]).
//!
//! The programs in `examples/` press a wall, follow telemetry, push and predict a range in about twenty lines each.
//! [`haptic_bridge`] is the code that runs on the board itself; its types (scenes, gains, faults) are those used here.
#![forbid(unsafe_code)]

pub use haptic_bridge;

pub mod analysis;
pub mod backup;
pub mod bench;
pub mod boards;
pub mod cores;
pub mod demo;
#[cfg(feature = "tool")]
pub mod design;
pub mod device_file;
pub mod digits;
pub mod error;
pub mod file_error;
pub mod frame;
#[cfg(feature = "serve")]
pub mod haply;
pub mod input;
#[cfg(feature = "tool")]
pub mod interrupt;
pub mod latency;
pub mod link;
pub mod measure;
pub mod model;
#[cfg(feature = "tool")]
pub mod monitor;
mod open;
pub mod outline;
pub mod output;
pub mod perception;
mod places;
pub mod plan;
pub mod plausible;
pub mod plot;
pub mod recorder;
pub mod replay;
pub mod scene_file;
pub mod sim;
pub mod skeleton;
pub mod summary;
pub mod sweep;
pub mod template;
pub mod tip;
pub mod toml_file;
#[cfg(feature = "tool")]
pub mod tune;
pub mod vectors;
pub mod view;
pub mod words;
