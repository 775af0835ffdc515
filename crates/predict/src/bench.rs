//! Cost and error of each variant of the control step on the chip.
//!
//! - [`counts`]: instructions on the Cortex-M4F, counted on the emulated chip and stored in bench/counts.json
//! - [`estimators`]: comparison of velocity estimators on a device, simulated with encoder steps
//! - [`probe`]: situations in which errors are computed: poses, normals, forces and hand motions
//! - [`report`]: cost, error and Pareto front of each variant, as tables
//! - [`error`]: torque of a variant in the board's precision, compared with the closed form in f64
//! - [`wall`]: simulation of a wall that the board's own step renders while a hand presses, slides along or taps it
//!
//! All errors are relative to the complete equation (4), so terms that a variant omits count as error.

pub mod counts;
pub mod error;
pub mod estimators;
pub mod probe;
pub mod report;
pub mod wall;
