//! Predicts which walls a device renders stably, by theory alone: the exact sampled loop of device, drives, velocity
//! estimator and delay, linearised at a pose, in double precision. The crate also maps the device's inertia, optionally
//! in the board's precision. The crate needs no board, and simulates and draws nothing.
//!
//! ```
//! use haptic_host::device_file::DeviceFile;
//! use haptic_stability::analysis::plant::{Drive, Linearised};
//! use haptic_stability::analysis::range::predict;
//! use haptic_stability::analysis::sampled::{LinearEstimator, Loop};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let device = DeviceFile::load("../../devices/coupled-five-bar.toml")?;
//! // Joint angles (rad), and the wall's unit normal out of the solid.
//! let seen = Linearised::at(&device.description, &[2.6, 1.75], &[0.6, 0.8])?;
//! let around = Loop {
//!     rate_hz: 20_000.0,
//!     delay_samples: 0.5,
//!     estimator: LinearEstimator::Butterworth(500.0),
//!     drive: Drive::Ideal,
//!     damping_compensation: false,
//! };
//! // The stiffest wall at 20 N s/m, without the feed-forward and with it, N/m.
//! let range = predict(&seen, &around, Some(&[20.0]), None)?;
//! assert!(range.full.boundary[0].kp > range.off.boundary[0].kp);
//! # Ok(())
//! # }
//! ```
//!
//! | to | start at |
//! |---|---|
//! | evaluate the inertia of a pose | [`model`], [`perception`] |
//! | predict which walls are stable | [`analysis`] |
//! | get the positions of a mechanism's links | [`skeleton`] |
//!
//! Long computations run in a [`sweep`] on every core ([`cores`]), with progress, and can be resumed.
#![forbid(unsafe_code)]

pub mod analysis;
pub mod cores;
pub mod model;
pub mod perception;
pub mod skeleton;
pub mod sweep;
