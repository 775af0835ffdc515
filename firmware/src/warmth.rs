//! The motors' heat over a reset: in memory that start-up leaves alone, with a checksum. A motor does not cool because
//! its board starts anew; where nothing is known of it, the servo takes it for half way to its budget.

use core::sync::atomic::{AtomicU32, Ordering};

use haptic_bridge::model::catalogue::MAX_JOINTS;

/// Starts the checksum: says that heats were written and not that SRAM happens to hold something.
const MARK: u32 = 0x4845_4154;

/// The bits of each motor's heat (A² s), and their checksum. Any bits are valid words.
#[unsafe(link_section = ".uninit.HEAT")]
static HEAT: [AtomicU32; MAX_JOINTS + 1] = [const { AtomicU32::new(0) }; MAX_JOINTS + 1];

fn sum(bits: [u32; MAX_JOINTS]) -> u32 {
    bits.iter().fold(MARK, |sum, word| (sum ^ word).wrapping_mul(0x0100_0193))
}

/// What the run before left, if it is whole: a reset in the middle of [`keep`], or a time without power, leave none.
pub fn take() -> Option<[f32; MAX_JOINTS]> {
    let bits = core::array::from_fn(|i| HEAT[i].load(Ordering::Relaxed));
    (HEAT[MAX_JOINTS].load(Ordering::Relaxed) == sum(bits)).then(|| bits.map(f32::from_bits))
}

/// Keeps the heats for the run after this.
pub fn keep(heat: [f32; MAX_JOINTS]) {
    let bits = heat.map(f32::to_bits);
    for (kept, word) in HEAT.iter().zip(bits.into_iter().chain([sum(bits)])) {
        kept.store(word, Ordering::Relaxed);
    }
}
