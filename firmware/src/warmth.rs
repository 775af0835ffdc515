//! The motors' heat in memory that survives a reset, because a motor does not cool when its board restarts.

use core::sync::atomic::AtomicU32;

use haptic_bridge::drive::heat::{self, Heat, KEPT};
use haptic_bridge::model::catalogue::MAX_JOINTS;

#[unsafe(link_section = ".uninit.HEAT")]
static HEAT: [AtomicU32; KEPT] = [const { AtomicU32::new(0) }; KEPT];

/// Returns the heat at the end of the previous run.
pub fn take() -> [Heat; MAX_JOINTS] {
    heat::kept(&HEAT)
}

/// Stores the heat for the next run.
pub fn keep(heat: &[Heat; MAX_JOINTS]) {
    heat::keep(heat, &HEAT);
}
