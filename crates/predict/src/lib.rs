//! Tools for a given device, which measure its stable walls on a real or simulated board; find the settings, place,
//! posture and links for the stiffest wall; warn of implausible values in a device or a scene; simulate encoder steps
//! at a wall; and choose the cheapest sufficient control step.
//!
//! The theory is in [`haptic_stability`]. [`measure`] does not use it, so that measurement and theory can be compared.
//!
//! ```
//! use haptic_bridge::model::admissible::Admissible;
//! use haptic_host::device_file::DeviceFile;
//! use haptic_predict::design::place::directions;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let device = DeviceFile::load("../../devices/coupled-five-bar.toml")?;
//! // At these joint angles (rad).
//! let found = directions(&device.description, &[2.6, 1.75], Admissible::default())?;
//! // Without the feed-forward the stiffest wall is along the direction in which the tip is heaviest, kg.
//! assert!(found.stiffest.w_eff > found.softest.w_eff);
//! # Ok(())
//! # }
//! ```
//!
//! | to | start at |
//! |---|---|
//! | measure stable walls on a board | [`measure`] |
//! | learn a motor's cogging | [`cogging`] |
//! | warn of implausible values in a device or a scene | [`plausible`] |
//! | simulate encoder steps at a pressed wall | [`ripple`] |
//! | find the cheapest sufficient control step | [`plan`], [`mod@bench`] |
//! | find the settings of the stiffest wall | [`mod@tune`] |
//! | find the best place, direction, posture and links for a wall | [`mod@design`] |
//! | write a device's first files | [`template`], [`wall_ahead`] |
#![forbid(unsafe_code)]

pub mod bench;
pub mod boards;
pub mod cogging;
mod contact;
pub mod design;
pub mod measure;
pub mod plan;
pub mod plausible;
pub mod ripple;
pub mod summary;
pub mod template;
pub mod tip;
pub mod tune;
pub mod wall_ahead;
