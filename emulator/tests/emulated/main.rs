//! The release firmware of every board on the emulated chip, through the real protocol, with a simulated device.
//! Virtual time stands still during a test's checks, so every run has the same bytes at the same times.

mod absolute;
mod arming;
mod boot;
mod brushless;
mod equality;
mod faults;
mod force;
mod gate;
mod injection;
mod load;
mod lying;
mod power;
mod promises;
mod range;
mod requests;
mod session;
mod timing;
mod toy;
mod usb;
mod walls;
mod wiring;
