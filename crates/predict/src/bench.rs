//! Speed against error: what each way of computing the control step costs on the chip, and what error it leaves.
//!
//! - [`counts`]: instructions on the Cortex-M4F, counted on the emulated chip and kept in bench/counts.json
//! - [`estimators`]: velocity estimators compared on a device, in simulation with the steps of its encoders
//! - [`precompute`]: frozen matrices and tables of a device, made here and sent ready to use
//! - [`probe`]: where errors are looked at: poses, normals, forces and hand motions over the workspace or along a wall
//! - [`report`]: every variant of every mechanism with both, its Pareto front, and the tables made of them
//! - [`error`]: the torque a variant renders, in the board's precision, against f64 and the closed form
//! - [`wall`]: one wall rendered by the board's own step, pressed, slid along, struck or tapped
//!
//! Error is always against the whole of equation (4) with its velocity terms: what a variant leaves out counts.

pub mod counts;
pub mod error;
pub mod estimators;
pub mod precompute;
pub mod probe;
pub mod report;
pub mod wall;
