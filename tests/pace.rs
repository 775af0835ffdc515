//! The pace of the control loop, looked at every 20 ms as the firmware does, for loops whose rate is known.

use crate::common::cases;
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

/// A watchdog that is fed only where the pace is kept bites within 208 ms of the last feeding.
#[test]
fn a_loop_at_a_wrong_pace_is_not_fed_until_the_watchdog_bites() {
    for rate in [200_u32, 500, 1_000, 2_000, 20_000] {
        for share in [0.5, 0.7, 0.8, 1.2, 1.3, 1.45, 2.0] {
            let mut pace = Pace::new(rate);
            let (mut before, mut hungry, mut longest) = (0, 0, 0);
            for look in 1..=200 {
                let steps = ((look * LOOK_US) as f64 * 1.0e-6 * f64::from(rate) * share) as u64;
                let kept = pace.look((steps - before) as u32, LOOK_US, rate, false) == Verdict::Kept;
                before = steps;
                hungry = if kept { 0 } else { hungry + LOOK_US };
                longest = longest.max(hungry);
            }
            assert!(longest > 500_000, "{rate} Hz times {share}: {longest} us");
        }
    }
}

/// An error in single looks is found even if it cancels over several.
#[test]
fn a_loop_that_runs_in_fits_is_found() {
    let mut pace = Pace::new(1_000);
    let found = [28, 12, 28, 12].map(|steps| pace.look(steps, LOOK_US, 1_000, false));
    assert!(found.iter().all(|verdict| *verdict != Verdict::Kept), "{found:?}");
}

#[test]
fn a_loop_that_keeps_its_pace_again_is_fed_again() {
    let mut pace = Pace::new(1_000);
    assert_eq!(pace.look(60, LOOK_US, 1_000, false), Verdict::TooOften);
    let found = [20; 4].map(|steps| pace.look(steps, LOOK_US, 1_000, false));
    assert_eq!(found, [Verdict::TooOften, Verdict::TooOften, Verdict::TooOften, Verdict::Kept]);
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
    #![proptest_config(cases(256))]

    /// Looks come up to a fifth of their time early or late, as a task's do.
    #[test]
    fn a_loop_at_its_rate_is_never_found_wrong(rate in 200_u32..50_000, share in 0.999_f64..1.001, late in prop::array::uniform16(0_u64..4_000)) {
        prop_assert_eq!(verdict(rate, share, false, |look| late[look as usize % 16]), None);
    }
}
