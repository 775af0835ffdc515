//! The motors' heat in memory that survives a reset, because a motor does not cool when its board restarts.

use core::sync::atomic::AtomicU32;

use haptic_bridge::drive::heat::{self, Heat, STORED_WORDS};
use haptic_bridge::model::catalogue::MAX_JOINTS;

#[unsafe(link_section = ".uninit.HEAT")]
static HEAT: [AtomicU32; STORED_WORDS] = [const { AtomicU32::new(0) }; STORED_WORDS];

/// Returns the heat at the end of the previous run.
pub fn take() -> [Heat; MAX_JOINTS] {
    heat::stored_heat(&HEAT)
}

/// Stores the heat for the next run.
pub fn store(heat: &[Heat; MAX_JOINTS]) {
    heat::store_heat(heat, &HEAT);
}
