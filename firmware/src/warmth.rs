//! The motors' heat over a reset, in memory that start-up leaves alone. A motor does not cool because its board
//! restarts.

use core::sync::atomic::AtomicU32;

use haptic_bridge::drive::heat::{self, Heat, KEPT};
use haptic_bridge::model::catalogue::MAX_JOINTS;

#[unsafe(link_section = ".uninit.HEAT")]
static HEAT: [AtomicU32; KEPT] = [const { AtomicU32::new(0) }; KEPT];

/// The heat that the previous run left.
pub fn take() -> [Heat; MAX_JOINTS] {
    heat::kept(&HEAT)
}

/// Keeps the heats for the run after this.
pub fn keep(heat: &[Heat; MAX_JOINTS]) {
    heat::keep(heat, &HEAT);
}
