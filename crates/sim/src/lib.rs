//! The simulated board: the library's own control loop on a nonlinear simulation of the device, its motors and a hand.
//! [`SimulatedDevice`] is the physics without the control loop; the emulated chip uses it too. No code here reads a
//! clock or an unseeded random number, so the same inputs give the same numbers, bit for bit.
//!
//! ```
//! use haptic_host::link::Session;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut session = Session::of(haptic_sim::open(&"sim".parse()?)?);
//! let state = session.read_state()?;
//! println!("the tip is at {:?} m, step {}", state.tip, state.step);
//! # Ok(())
//! # }
//! ```
//!
//! | to | begin at |
//! |---|---|
//! | open a board by its port, simulated or not | [`open`] |
//! | use a simulated board and its wire | [`SharedBoard`], [`ready_board`] |
//! | move a hand | [`Hand`], [`Intent`] |
//! | serve other programs by TCP or a pseudo-terminal | [`server`] |
//! | compute how a limit reduces a wall's force | [`PressedBoard`] |
#![forbid(unsafe_code)]

mod board;
mod brushless;
mod device;
pub mod door;
mod encoder;
mod faults;
mod flash;
mod hand;
mod hand_loop;
mod machine;
mod motor;
mod noisy_wire;
mod open;
mod plant;
mod port;
mod pressed;
mod random;
pub mod server;
mod wire;

pub use board::{BoardOptions, DriveModel, IDEAL_BOARD, SimulatedBoard, TIMER_HZ};
pub use brushless::{BrokenPhase, BrushlessModel};
pub use device::{DeviceError, Options, SimulatedDevice, Support};
pub use encoder::EncoderModel;
pub use faults::BoardFaults;
pub use flash::SettingsFlash;
pub use hand::{Hand, HandSettings, Intent, Waypoint};
pub use hand_loop::HandLoop;
pub use machine::LocalMachine;
pub use motor::{MotorInput, MotorModel, PowerStage};
pub use noisy_wire::NoisyWire;
pub use open::{open, stop};
pub use plant::{Load, Plant};
pub use pressed::{Press, PressForces, PressedBoard, WIDE_LIMITS};
pub use random::Random;
pub use wire::{SHIPPED_DEVICE, SharedBoard, ready_board};
