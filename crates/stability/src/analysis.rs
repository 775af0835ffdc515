//! Sampled-data analysis: which walls a device renders before the control loop oscillates, and how its inertia is
//! distributed.
//!
//! The analysis uses no board. Its input is a pose, a direction and a few numbers about the control loop; its output
//! are predictions.
//!
//! - [`amplitudes`]: amplitude spectrum of a recorded signal
//! - [`control_loop`]: rate, delay, estimator, drives and feed-forward: everything about a control loop except the
//!   device
//! - [`cut`]: the plane of the inertia map that is drawn, in tiles
//! - [`estimator`]: the velocity estimators as linear filters
//! - [`flexible`]: compliant transmissions and modes, a hand on the tip, and a posture that holds the device
//! - [`host`]: a wall rendered by a program on a computer
//! - [`mod@line`]: walls along a line with a rule for their damping, and their largest stable stiffness
//! - [`map`]: inertia over the workspace, the output of `haptic map`
//! - [`oscillation`]: frequency and growth of a wall's oscillation at given gains
//! - [`passivity`]: the classical bounds of walls that no hand can make oscillate
//! - [`plant`]: the device linearised at a pose, its joint damping and its drives, in continuous time
//! - [`sampled`]: the sampled loop with zero-order hold, fractional delay, velocity estimator and feed-forward, in
//!   delta form
//! - [`spectrum`]: small dense linear algebra (matrix exponential, resolvent, growth), with its own eigenvalue
//!   iteration
//! - [`boundary`]: the stiffness at which a mode leaves the unit circle, and every other stable interval
//! - [`pose`]: matrices of the analysis from a device description and joint angles
//! - [`domain`]: boundary, area and islands of one device with one feed-forward
//! - [`prediction`]: a device in a control loop, the prediction that every command uses
//! - [`range`]: the domains of every feed-forward side by side, the output of `haptic range`
//! - [`several`]: the sampled loop with several walls that act together
//! - [`why`]: the share of each effect in the boundary
//!
//! Source: "Inertia Properties and Their Role in Haptic Rendering", the stable domain of virtual walls; sampled-data
//! theory as in Åström and Wittenmark, *Computer-Controlled Systems*, chapters 2 and 3.

pub mod amplitudes;
pub mod boundary;
pub mod control_loop;
pub mod cut;
pub mod domain;
mod drift;
mod eigenvalues;
pub mod error;
pub mod estimator;
pub mod flexible;
mod flexible_reduction;
pub mod host;
pub mod line;
pub mod map;
pub mod oscillation;
pub mod passivity;
pub mod plant;
pub mod pose;
pub mod prediction;
pub mod range;
mod reduction;
pub mod sampled;
pub mod several;
pub mod spectrum;
mod subject;
pub mod why;
