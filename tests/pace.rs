//! Tests the check of the control loop's pace (every 20 ms, as in the firmware) with loops of known rate.

use crate::common::property_config;
use haptic_bridge::safety::pace::{Pace, Verdict};
use proptest::prelude::*;

const RATES_HZ: [u32; 4] = [200, 1_000, 5_000, 20_000];
const CHECK_INTERVAL_US: u64 = 20_000;

/// Runs a loop at `share` of its rate (Hz) for at most 500 checks (10 s). Returns the first verdict other than `Kept`
/// and the number of checks until then.
fn first_failure(rate: u32, share: f64, excused: bool, jitter: impl Fn(u64) -> u64) -> Option<(Verdict, u64)> {
    let mut pace = Pace::new(rate);
    let (mut before, mut time) = (0, 0);
    for check in 1..=500 {
        let now = check * CHECK_INTERVAL_US + jitter(check);
        let steps = (now as f64 * 1.0e-6 * f64::from(rate) * share) as u64;
        let found = pace.check_rate((steps - before) as u32, now - time, rate, excused);
        (before, time) = (steps, now);
        if found != Verdict::Kept {
            return Some((found, check));
        }
    }
    None
}

#[test]
fn a_rate_error_of_a_fifth_is_found_within_80_steps() {
    for rate in RATES_HZ {
        // The tolerance over 80 steps is 12 steps: 10 %, and four steps at the ends.
        let checks = (80 * 1_000_000 / u64::from(rate)).div_ceil(CHECK_INTERVAL_US);
        for (share, expected) in [(1.2, Verdict::TooFast), (0.8, Verdict::TooSlow)] {
            let found = first_failure(rate, share, false, |_| 0);
            assert!(
                found.is_some_and(|(verdict, check)| verdict == expected && check <= checks),
                "{rate} Hz: {found:?}"
            );
        }
        assert_eq!(first_failure(rate, 0.8, true, |_| 0), None, "{rate} Hz: an excused loop failed");
    }
}

/// The watchdog is fed only at the right pace. It resets the board 208 ms after the last feeding at the latest.
#[test]
fn a_loop_at_a_wrong_pace_lets_the_watchdog_reset_the_board() {
    for rate in [200_u32, 500, 1_000, 2_000, 20_000] {
        for share in [0.5, 0.7, 0.8, 1.2, 1.3, 1.45, 2.0] {
            let mut pace = Pace::new(rate);
            let (mut before, mut unfed, mut longest) = (0, 0, 0);
            for check in 1..=200 {
                let steps = ((check * CHECK_INTERVAL_US) as f64 * 1.0e-6 * f64::from(rate) * share) as u64;
                let kept = pace.check_rate((steps - before) as u32, CHECK_INTERVAL_US, rate, false) == Verdict::Kept;
                before = steps;
                unfed = if kept { 0 } else { unfed + CHECK_INTERVAL_US };
                longest = longest.max(unfed);
            }
            assert!(longest > 500_000, "{rate} Hz times {share}: not fed for {longest} us");
        }
    }
}

/// Errors that cancel over several checks must be found in single checks.
#[test]
fn an_irregular_loop_is_found() {
    let mut pace = Pace::new(1_000);
    let found = [28, 12, 28, 12].map(|steps| pace.check_rate(steps, CHECK_INTERVAL_US, 1_000, false));
    assert!(found.iter().all(|verdict| *verdict != Verdict::Kept), "{found:?}");
}

#[test]
fn a_loop_that_recovers_its_pace_is_fed_again() {
    let mut pace = Pace::new(1_000);
    assert_eq!(pace.check_rate(60, CHECK_INTERVAL_US, 1_000, false), Verdict::TooFast);
    let found = [20; 4].map(|steps| pace.check_rate(steps, CHECK_INTERVAL_US, 1_000, false));
    assert_eq!(found, [Verdict::TooFast, Verdict::TooFast, Verdict::TooFast, Verdict::Kept]);
}

#[test]
fn a_change_of_rate_is_not_a_wrong_pace() {
    let mut pace = Pace::new(20_000);
    assert_eq!(pace.check_rate(400, CHECK_INTERVAL_US, 20_000, false), Verdict::Kept);
    // The interval has 15 ms at the old rate and 5 ms at the new rate.
    assert_eq!(pace.check_rate(301, CHECK_INTERVAL_US, 200, false), Verdict::Kept);
    for _ in 0..100 {
        assert_eq!(pace.check_rate(4, CHECK_INTERVAL_US, 200, false), Verdict::Kept);
    }
    assert_eq!(pace.check_rate(100, CHECK_INTERVAL_US, 20_000, false), Verdict::Kept);
    assert_eq!(pace.check_rate(800, CHECK_INTERVAL_US, 20_000, false), Verdict::TooFast);
}

#[test]
fn an_excused_stall_has_no_later_effect() {
    let mut pace = Pace::new(1_000);
    assert_eq!(pace.check_rate(1, 10 * CHECK_INTERVAL_US, 1_000, true), Verdict::Kept);
    for _ in 0..50 {
        assert_eq!(pace.check_rate(20, CHECK_INTERVAL_US, 1_000, false), Verdict::Kept);
    }
}

#[test]
fn no_number_makes_the_check_panic() {
    let mut pace = Pace::new(u32::MAX);
    for _ in 0..3 {
        pace.check_rate(u32::MAX, u64::MAX, u32::MAX, false);
    }
}

proptest! {
    #![proptest_config(property_config(256))]

    /// Checks come up to a fifth of their interval late, like checks in a task.
    #[test]
    fn a_loop_at_its_rate_never_fails_the_check(rate in 200_u32..50_000, share in 0.999_f64..1.001, late in prop::array::uniform16(0_u64..4_000)) {
        prop_assert_eq!(first_failure(rate, share, false, |check| late[check as usize % 16]), None);
    }
}
