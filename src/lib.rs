//! haptic-bridge: the shared control library of board and host.
#![no_std]
#![forbid(unsafe_code)]

pub mod description;
pub mod inertia;
pub mod math;
pub mod mechanism;
pub mod velocity;
