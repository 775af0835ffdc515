//! A page in the browser: a device to look at, walls to drag, gains to turn, and a hand where the device is simulated
//! (`haptic view`, docs/view.md).
//!
//! One thread owns the board ([`stage`]); each page has a thread that carries messages ([`door`]) and a place where the
//! newest picture waits for it ([`hub`]), so that a slow page sees fewer pictures and delays no other. Everything that
//! a page shows is inside the tool: it loads nothing from elsewhere. Of this only [`door`] needs a network, and only
//! [`Stage::run`] a clock: clients/page/ puts the rest into the page itself.

#[cfg(feature = "serve")]
pub mod door;
pub mod hub;
pub mod message;
pub mod picture;
pub mod scope;
pub mod stability;
pub mod stage;
pub mod world;

#[cfg(feature = "serve")]
pub use door::{PageListener, Reach};
pub use stage::{Stage, Turn};
pub use world::World;
