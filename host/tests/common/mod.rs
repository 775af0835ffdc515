//! What tests of both runs need.
#![allow(dead_code, reason = "every run uses its own part")]

#[cfg(unix)]
pub mod documents;
pub mod domains;
pub mod page;
pub mod sim;
pub mod socket;
