//! Speed against error: the cost of each variant of the control step on the chip, and its error.
//!
//! - [`counts`]: instructions on the Cortex-M4F, counted on the emulated chip and stored in bench/counts.json
//! - [`estimators`]: velocity estimators compared on a device, in simulation with encoder steps
//! - [`precompute`]: frozen matrices and tables of a device, computed in advance and ready to send
//! - [`probe`]: situations in which errors are computed: poses, normals, forces and hand motions over the workspace or
//!   on a wall
//! - [`report`]: every variant of every mechanism with cost and error, the Pareto front, and the tables
//! - [`error`]: the torque of a variant in the board's precision, compared with f64 and the closed form
//! - [`wall`]: one wall that the board's own step renders while a hand presses it, slides along it or taps it
//!
//! Errors are always relative to the complete equation (4) with its velocity terms, so the terms that a variant leaves
//! out count as error.

pub mod counts;
pub mod error;
pub mod estimators;
pub mod precompute;
pub mod probe;
pub mod report;
pub mod wall;
