//! Sampled-data analysis: which walls a device can render before the loop starts to oscillate, and how its inertia is
//! spread.
//!
//! Nothing here talks to a board: a pose, a direction and a few numbers about the loop go in, predictions come out.
//!
//! - [`amplitudes`]: how much of a recorded signal swings at which frequency
//! - [`control`]: rate, delay, estimator, drives and feed-forward: everything about a loop that is not the device
//! - [`cut`]: the plane of that map that is drawn, in tiles
//! - [`estimator`]: the velocity estimators as linear filters
//! - [`flexible`]: what is not rigid about it and what holds it: transmissions, a hand on the tip, a posture
//! - [`host`]: the same wall rendered by a program on a computer
//! - [`mod@line`]: walls along a line, their damping by a rule, and how far they are stable
//! - [`map`]: inertia over the workspace: what `haptic map` prints
//! - [`oscillation`]: the frequency at which a wall swings at given gains, and how fast that grows
//! - [`passivity`]: the classical bounds of walls that no hand can make oscillate
//! - [`plant`]: the device linearised at a pose, its joint damping and its drives, in continuous time
//! - [`sampled`]: zero-order hold, fractional delay, velocity estimator and feed-forward around it, in delta form
//! - [`spectrum`]: the small dense linear algebra this needs (matrix exponential, resolvent, growth), with its own
//!   eigenvalue iteration
//! - [`boundary`]: the stiffness at which a mode leaves the unit circle, and every other stable interval
//! - [`pose`]: from a device description and joint angles to the matrices all of this works on
//! - [`domain`]: boundary, area and islands of one device with one feed-forward
//! - [`prediction`]: a device in a loop: the one question that every command asks, and its answer
//! - [`range`]: the domains of every feed-forward side by side: what `haptic range` prints
//! - [`several`]: the same loop around walls that act together
//! - [`why`]: what each effect takes from the boundary
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
