//! The motors' heat over a reset: in memory that start-up leaves alone, with a checksum. A motor does not cool because
//! its board starts anew; where nothing is known of it, the servo takes it for half way to its budget.

use core::sync::atomic::{AtomicU32, Ordering};

use haptic_bridge::drive::heat::{Heat, WORDS};
use haptic_bridge::model::catalogue::MAX_JOINTS;

/// Starts the checksum: says that heats were written and not that SRAM happens to hold something.
const MARK: u32 = 0x4845_4154;

/// The words of each motor's heat, and their checksum.
#[unsafe(link_section = ".uninit.HEAT")]
static HEAT: [AtomicU32; MAX_JOINTS * WORDS + 1] = [const { AtomicU32::new(0) }; MAX_JOINTS * WORDS + 1];

fn sum(heat: &[[u32; WORDS]; MAX_JOINTS]) -> u32 {
    heat.iter().flatten().fold(MARK, |sum, word| (sum ^ word).wrapping_mul(0x0100_0193))
}

/// What the run before left, if it is whole: a reset in the middle of [`keep`], or a time without power, leave nothing
/// that is known.
pub fn take() -> [Heat; MAX_JOINTS] {
    let word = |i: usize| HEAT[i].load(Ordering::Relaxed);
    let heat = core::array::from_fn(|joint| core::array::from_fn(|i| word(WORDS * joint + i)));
    if word(MAX_JOINTS * WORDS) == sum(&heat) { heat.map(Heat::from_words) } else { [Heat::UNKNOWN; MAX_JOINTS] }
}

/// Keeps the heats for the run after this.
pub fn keep(heat: [Heat; MAX_JOINTS]) {
    let heat = heat.map(|heat| heat.words());
    for (kept, word) in HEAT.iter().zip(heat.iter().flatten().copied().chain([sum(&heat)])) {
        kept.store(word, Ordering::Relaxed);
    }
}
