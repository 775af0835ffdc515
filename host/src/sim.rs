//! The simulated board: the library's own servo on a nonlinear simulation of the device, its motors and a hand.
//!
//! [`SimulatedDevice`] is the physics alone (drive in; encoder counts and currents out); it also stands behind the
//! emulated chip. Nothing here reads a clock or an unseeded random number: the same inputs give the same numbers, bit
//! for bit.

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
mod plant;
mod port;
mod random;
pub mod server;
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
pub use plant::{Load, Plant};
pub use random::Random;
pub use wire::{SHIPPED_DEVICE, SharedBoard, ready_board};
