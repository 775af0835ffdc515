//! Which walls a device renders stably, how they feel, and with which settings and links it renders the stiffest. All
//! of it is computed from device and scene, in double precision or in the board's own, and draws nothing. [`measure`]
//! asks a board instead, simulated or real, and knows no theory: what both say is compared.
//!
//! ```
//! use haptic_host::device_file::DeviceFile;
//! use haptic_predict::analysis::plant::{Drive, Linearised};
//! use haptic_predict::analysis::range::predict;
//! use haptic_predict::analysis::sampled::{LinearEstimator, Loop};
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
//! | to | begin at |
//! |---|---|
//! | evaluate the inertia of a pose | [`model`] |
//! | predict which walls are stable | [`analysis`] |
//! | measure it on a board | [`measure`] |
//! | hear what is doubtful about a device or a scene | [`plausible`] |
//! | find the cheapest step that is good enough | [`plan`], [`mod@bench`] |
//! | find the settings of the stiffest wall | [`mod@tune`] |
//! | find the best place, direction, posture and links for one | [`mod@design`] |
//!
//! What takes long goes through a [`sweep`], which uses every core, says how far it is and goes on where it was
//! stopped.
#![forbid(unsafe_code)]

pub mod analysis;
pub mod bench;
pub mod boards;
pub mod cores;
pub mod design;
pub mod measure;
pub mod model;
pub mod perception;
pub mod plan;
pub mod plausible;
pub mod skeleton;
pub mod summary;
pub mod sweep;
pub mod template;
pub mod tip;
pub mod tune;
pub mod wall_ahead;
