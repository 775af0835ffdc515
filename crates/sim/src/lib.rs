//! The simulated board: the library's own control loop on a nonlinear simulation of the device, its motors and a hand.
//! [`SimulatedDevice`] is the physics alone (drive in; encoder counts and currents out); it also stands behind the
//! emulated chip. Nothing here reads a clock or an unseeded random number: the same inputs give the same numbers, bit
//! for bit.
//!
//! ```
//! use haptic_host::link::Session;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut session = Session::of(haptic_sim::open(&"sim".parse()?)?);
//! let state = session.look()?;
//! println!("the tip is at {:?} m, step {}", state.tip, state.step);
//! # Ok(())
//! # }
//! ```
//!
//! | to | begin at |
//! |---|---|
//! | open a board by its port, simulated or not | [`open`] |
//! | hold a simulated board and the client's end of it | [`SharedBoard`], [`ready_board`] |
//! | lead a hand | [`Hand`], [`Intent`] |
//! | let other programs in, by TCP or a pseudo-terminal | [`server`] |
//! | know what a limit leaves of a wall | [`Held`] |
#![forbid(unsafe_code)]

mod around;
mod board;
mod broken;
mod device;
pub mod door;
mod encoder;
mod flash;
mod hand;
mod held;
mod machine;
mod motor;
mod open;
mod plant;
mod port;
mod random;
pub mod server;
mod spoilt;
mod wire;

pub use around::Around;
pub use board::{BoardOptions, DriveModel, IDEAL_BOARD, SimulatedBoard, TIMER_HZ};
pub use broken::Broken;
pub use device::{DeviceError, Options, SimulatedDevice, Support};
pub use encoder::EncoderModel;
pub use flash::SettingsFlash;
pub use hand::{Hand, HandSettings, Intent, Waypoint};
pub use held::{Felt, Held, Press, WIDE};
pub use machine::LocalMachine;
pub use motor::{MotorInput, MotorModel, PowerStage};
pub use open::{open, stop};
pub use plant::{Load, Plant};
pub use random::Random;
pub use spoilt::SpoiltWire;
pub use wire::{SHIPPED_DEVICE, SharedBoard, ready_board};
