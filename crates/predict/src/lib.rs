//! Work with a device at hand: measure which walls it renders, on a board or a simulated one, and find the settings,
//! place, posture and links with which it renders the stiffest. It also says what is doubtful about a device or a
//! scene, what encoder steps make of a wall, and which control step is the cheapest that is good enough. The theory
//! comes from [`haptic_stability`]; [`measure`] knows none of it, so that both can be compared.
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
//! // Without the feed-forward the stiffest wall stands where the tip is heaviest, kg.
//! assert!(found.stiffest.w_eff > found.softest.w_eff);
//! # Ok(())
//! # }
//! ```
//!
//! | to | begin at |
//! |---|---|
//! | measure stable walls on a board | [`measure`] |
//! | hear what is doubtful about a device or a scene | [`plausible`] |
//! | see what encoder steps make of a pressed wall | [`ripple`] |
//! | find the cheapest step that is good enough | [`plan`], [`mod@bench`] |
//! | find the settings of the stiffest wall | [`mod@tune`] |
//! | find the best place, direction, posture and links for one | [`mod@design`] |
//! | write a device's first files | [`template`], [`wall_ahead`] |
//! | write the file of a device that a board runs | [`equivalent`] |
#![forbid(unsafe_code)]

pub mod bench;
pub mod boards;
mod contact;
pub mod design;
pub mod equivalent;
pub mod measure;
pub mod plan;
pub mod plausible;
pub mod ripple;
pub mod summary;
pub mod template;
pub mod tip;
pub mod tune;
pub mod wall_ahead;
