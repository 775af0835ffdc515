//! haptic-bridge: the shared control library of board and host.
#![no_std]
#![forbid(unsafe_code)]

pub mod description;
pub mod math;
pub mod mechanism;
