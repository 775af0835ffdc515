//! Talks to a haptic-bridge board: finds its port, sends the requests of its protocol, receives its telemetry, and
//! reads and writes device and scene files. The bindings for C, Python and CHAI3D use this crate, so the crate contains
//! no code that draws, predicts or simulates. A [`link::Board`] has one method for every request. A program that sends
//! forces to a board uses a [`link::Session`].
//!
//! ```no_run
//! use haptic_host::{device_file::DeviceFile, link::Board, scene_file::SceneFile};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let device = DeviceFile::load("devices/coupled-five-bar.toml")?;
//! let scene = SceneFile::load("devices/scenes/coupled-five-bar/wall.toml", device.spec().task)?;
//! // A serial number or a port, as `haptic --port` takes it.
//! let mut board = Board::open(&"/dev/ttyACM0".parse()?)?;
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
//! | send forces to a board, 1000 times a second | [`link::Session`] |
//! | read device and scene files | [`device_file`], [`scene_file`] |
//! | back up a board's settings | [`backup`] |
//! | write a board's scene as a file, list differences | [`read_back`] |
//! | measure the round-trip time to a board | [`latency`] |
//! | convert to the axes of another program | [`frame`] |
//!
//! Crates that use this crate: `haptic-flash` (firmware on a board), `haptic-sim` (a board without hardware),
//! `haptic-stability` (which walls are stable), `haptic-predict` (measuring, tuning, design), `haptic-show`
//! (recordings, drawings, the page) and the tool `haptic`. The programs in `examples/` press a wall, follow telemetry,
//! push and predict a range in about twenty lines each. [`haptic_bridge`] is the code that runs on the board itself;
//! this crate uses its types (scenes, gains, faults).
#![forbid(unsafe_code)]

pub use haptic_bridge;

pub mod backup;
pub mod device_file;
pub mod digits;
pub mod error;
pub mod file_error;
pub mod frame;
pub mod input;
pub mod latency;
pub mod link;
pub mod output;
pub mod places;
pub mod read_back;
pub mod scene_file;
pub mod toml_file;
pub mod vectors;
pub mod words;
