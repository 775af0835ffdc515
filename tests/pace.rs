//! The pace of the control loop, looked at every 20 ms as the firmware does, for loops whose rate is known.

use haptic_bridge::safety::pace::{Pace, Verdict};
use proptest::prelude::*;

const RATES: [u32; 4] = [200, 1_000, 5_000, 20_000];
const LOOK_US: u64 = 20_000;

/// The first verdict against a loop that runs at `share` of its rate, and the looks until then; of 500 (10 s).
fn verdict(rate: u32, share: f64, excused: bool, jitter: impl Fn(u64) -> u64) -> Option<(Verdict, u64)> {
    let mut pace = Pace::new(rate);
    let (mut before, mut time) = (0, 0);
    for look in 1..=500 {
        let now = look * LOOK_US + jitter(look);
        let steps = (now as f64 * 1.0e-6 * f64::from(rate) * share) as u64;
        let found = pace.look((steps - before) as u32, now - time, rate, excused);
        (before, time) = (steps, now);
        if found != Verdict::Kept {
            return Some((found, look));
        }
    }
    None
}

#[test]
fn a_loop_a_fifth_too_fast_or_too_slow_is_found_within_80_steps_at_every_rate() {
    for rate in RATES {
        // Of 80 steps 10 % and the four at the ends are 12.
        let looks = (80 * 1_000_000 / u64::from(rate)).div_ceil(LOOK_US);
        for (share, expected) in [(1.2, Verdict::TooOften), (0.8, Verdict::TooSeldom)] {
            let found = verdict(rate, share, false, |_| 0);
            assert!(found.is_some_and(|(what, look)| what == expected && look <= looks), "{rate} Hz: {found:?}");
        }
        assert_eq!(verdict(rate, 0.8, true, |_| 0), None, "{rate} Hz, with a reason");
    }
}

#[test]
fn a_new_rate_is_held_against_neither() {
    let mut pace = Pace::new(20_000);
    assert_eq!(pace.look(400, LOOK_US, 20_000, false), Verdict::Kept);
    // 15 ms at the old rate, 5 ms at the new one.
    assert_eq!(pace.look(301, LOOK_US, 200, false), Verdict::Kept);
    for _ in 0..100 {
        assert_eq!(pace.look(4, LOOK_US, 200, false), Verdict::Kept);
    }
    assert_eq!(pace.look(100, LOOK_US, 20_000, false), Verdict::Kept);
    assert_eq!(pace.look(800, LOOK_US, 20_000, false), Verdict::TooOften);
}

#[test]
fn a_loop_that_stalled_with_a_reason_is_not_held_to_what_it_missed() {
    let mut pace = Pace::new(1_000);
    assert_eq!(pace.look(1, 10 * LOOK_US, 1_000, true), Verdict::Kept);
    for _ in 0..50 {
        assert_eq!(pace.look(20, LOOK_US, 1_000, false), Verdict::Kept);
    }
}

#[test]
fn no_number_makes_it_panic() {
    let mut pace = Pace::new(u32::MAX);
    for _ in 0..3 {
        pace.look(u32::MAX, u64::MAX, u32::MAX, false);
    }
}

proptest! {
    /// Looks come up to a fifth of their time early or late, as a task's do.
    #[test]
    fn a_loop_at_its_rate_is_never_found_wrong(rate in 200_u32..50_000, share in 0.999_f64..1.001, late in prop::array::uniform16(0_u64..4_000)) {
        prop_assert_eq!(verdict(rate, share, false, |look| late[look as usize % 16]), None);
    }
}
