//! haptic-bridge: the shared control library of board and host.
#![no_std]
#![forbid(unsafe_code)]

pub mod controller;
pub mod description;
pub mod device;
pub mod inertia;
pub mod math;
pub mod mechanism;
pub mod precomputed;
pub mod scene;
pub mod velocity;
