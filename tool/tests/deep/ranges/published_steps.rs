//! A higher rate raises the stiffness less than rigid theory with perfect sensors predicts, as published measurements
//! show (docs/published.md). Only orders and trends are checked, because friction and cables were not published.

use crate::common::prelude::*;
use crate::common::{ideal_loop, shipped_device};
use haptic_predict::ripple::{LIGHT_HAND, PUSH_N, PressedWall};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::line::DampingRule;

/// Smallest ripple that a finger feels in a steady force of some newtons, N rms.
const RIPPLE_BOUND_N: f64 = 0.1;

fn with_pressed_wall<T>(
    device: &str,
    normal: &[f64],
    hand: Option<Hand>,
    (rate_hz, estimator): (f64, LinearEstimator),
    work: impl FnOnce(&PressedWall<'_>) -> T,
) -> T {
    let description = shipped_device(device).description;
    let q = description.home.unwrap()[..description.kind.spec().joints].to_vec();
    let device = Linearised::at(&description, &q, normal).unwrap().with_hand(hand.unwrap_or_default());
    let around = ideal_loop(rate_hz, 0.0, estimator);
    let (normal, hand) = (normal.to_vec(), hand.unwrap_or(LIGHT_HAND));
    work(&PressedWall { device: &device, description, q, normal, around: &around, hand, push_n: PUSH_N })
}

/// Returns the largest damping, N s/m, up to which a wall's ripple is within the bound, in steps of 10 % from `least`.
fn max_quiet_damping(pressed: &PressedWall<'_>, kp: f64, least: f64) -> f64 {
    let dampings = (0..100).map(|i| least * 1.1_f64.powi(i));
    let clean = |kd: &f64| pressed.ripple(Mode::Off, kp, *kd).unwrap().is_within(RIPPLE_BOUND_N);
    dampings.take_while(clean).last().unwrap_or(0.0)
}

/// Returns the largest stiffness, N/m, of a quiet and of a stable undamped spring in a relaxed hand.
fn spring_limits(rate_hz: f64) -> (f64, f64) {
    let hand = Hand { mass: 0.12, damping: 6.0, stiffness: 250.0 };
    with_pressed_wall(
        "phantom-premium-1.5",
        &[0.0, 1.0, 0.0],
        Some(hand),
        (rate_hz, LinearEstimator::BackwardDifference),
        |pressed| {
            let along = pressed
                .ripple_line(Mode::Off, DampingRule::Damping(0.0), RIPPLE_BOUND_N, &Sweep::quiet())
                .unwrap()
                .unwrap();
            (along.kp_from.unwrap_or(along.kp_stable), along.kp_stable)
        },
    )
}

#[test]
fn stiffness_grows_far_less_than_the_rate() {
    let [slow, usual] = [250.0, 1_000.0].map(|rate| (rate, spring_limits(rate)));
    for ((from, slow), rate, least, most) in
        [(slow, 1_000.0, 2.0, 4.5), (slow, 40_000.0, 2.5, 6.0), (usual, 20_000.0, 1.0, 1.1)]
    {
        let found = spring_limits(rate);
        let (gained, rigid) = (found.0 / slow.0, found.1 / slow.1);
        assert!((rigid / (rate / from) - 1.0).abs() < 0.1, "rigid theory is not proportional to {rate} Hz: {rigid}");
        assert!((least..most).contains(&gained), "{rate}: {gained}");
    }
}

#[test]
fn a_higher_rate_is_stiffer_and_leaves_less_virtual_damping() {
    let of = |rate| {
        let estimator = LinearEstimator::BackwardDifference;
        with_pressed_wall("coupled-five-bar", &[0.0, 1.0], None, (rate, estimator), |pressed| {
            let theory = domain(pressed.device, pressed.around, Mode::Off, Some(&[])).unwrap().kd_max;
            (max_quiet_damping(pressed, 1_000.0, 0.5), theory)
        })
    };
    let (slow, fast) = (of(1_000.0), of(10_000.0));
    assert!(fast.1 > 5.0 * slow.1, "theory predicts too little damping");
    assert!(fast.0 < 0.5 * slow.0, "encoder steps leave too much damping: {slow:?} {fast:?}");
}

#[test]
fn velocities_over_ten_samples_keep_the_damping_of_a_slow_loop() {
    let of = |rate, estimator| {
        with_pressed_wall("pantograph-mk2", &[0.0, 1.0], None, (rate, estimator), |pressed| {
            let area = domain(pressed.device, pressed.around, Mode::Off, Some(&[])).unwrap().area;
            (max_quiet_damping(pressed, 1_000.0, 0.05), area)
        })
    };
    let bare = LinearEstimator::BackwardDifference;
    let (slow, uniform, dual) = (of(2_000.0, bare), of(20_000.0, bare), of(20_000.0, bare.with_window(10)));
    assert!(uniform.0 < 0.5 * slow.0, "{slow:?} {uniform:?}");
    assert!(dual.0 > 0.8 * slow.0, "{slow:?} {dual:?}");
    assert!(dual.1 > slow.1, "the fast position gains no area: {slow:?} {dual:?}");
}
