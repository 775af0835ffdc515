//! The page of `haptic view`: a device, walls to drag, gains, and a hand if the device is simulated (docs/view.md).
//!
//! One thread owns the board ([`stage`]). Each page has a thread that carries messages ([`door`]) and a slot for its
//! newest picture ([`hub`]), so that a slow page gets fewer pictures and does not delay others. The complete page is
//! inside the tool and loads nothing from elsewhere. Only [`door`] needs a network, and only [`Stage::run`] a clock;
//! clients/page/ runs everything else inside the page itself.

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
