//! Sampled-data analysis: predicts the stable walls of a device and the distribution of its inertia.
//!
//! The analysis needs no board, and computes its predictions from a pose, a direction and the data of the control loop.
//!
//! - [`amplitudes`]: amplitude spectrum of a recorded signal
//! - [`control_loop`]: a control loop without its device: rate, delay, estimator, drives and feed-forward
//! - [`cut`]: the plane of the inertia map that is drawn, divided into tiles
//! - [`estimator`]: the velocity estimators as linear filters
//! - [`flexible`]: compliant transmissions and modes, a hand at the tip, and the posture control of a redundant device
//! - [`host`]: a wall rendered by a program on a computer
//! - [`mod@line`]: walls whose damping follows a rule, and their largest stable stiffness
//! - [`map`]: inertia over the workspace, the output of `haptic map`
//! - [`oscillation`]: frequency and growth of a wall's oscillation at given gains
//! - [`passivity`]: the classical bounds for walls that stay stable with any hand
//! - [`plant`]: the device linearised at a pose, its joint damping and its drives, in continuous time
//! - [`sampled`]: the sampled loop with zero-order hold, fractional delay, velocity estimator and feed-forward
//! - [`spectrum`]: small dense linear algebra: matrix exponential, resolvent and growth
//! - [`boundary`]: the stable intervals of stiffness and of damping
//! - [`pose`]: the analysis's matrices for a device description and joint angles
//! - [`domain`]: boundary, area and islands for one device and one feed-forward
//! - [`prediction`]: the prediction for a device in a control loop, used by every command
//! - [`range`]: the domains of all feed-forwards, the output of `haptic range`
//! - [`several`]: the sampled loop with several walls that act together
//! - [`why`]: the share of each effect in the stability boundary
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
