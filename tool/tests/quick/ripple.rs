//! Ripple of a pressed wall from encoder steps, compared with an independent program and with the board's own step.

use crate::common::prelude::*;
use crate::common::{self, ideal_loop, shipped_device, type_lines};
use haptic_bridge::render::velocity::{Chosen, Estimator as Kind};
use haptic_predict::bench::estimators::{Comparison, ripple_of};
use haptic_predict::ripple::{LIGHT_HAND, PUSH_N, PressedWall};
use haptic_stability::analysis::line::DampingRule;

const POSE: [f64; 2] = [2.6, 1.75];
const NORMAL: [f64; 2] = [0.25881904510252074, 0.9659258262890683];

/// Runs `work` on the shipped device with this number of counts per turn.
fn with_pressed_wall<T>(around: &Loop, counts: Option<f64>, work: impl FnOnce(&PressedWall<'_>) -> T) -> T {
    let mut file = shipped_device("coupled-five-bar");
    for encoder in file.description.joints.iter_mut().flat_map(|joint| &mut joint.encoder) {
        encoder.counts_per_turn = counts.unwrap_or(encoder.counts_per_turn);
    }
    let device = Linearised::at(&file.description, &POSE, &NORMAL).unwrap();
    work(&PressedWall {
        device: &device,
        description: file.description,
        q: POSE.to_vec(),
        normal: NORMAL.to_vec(),
        around,
        hand: LIGHT_HAND,
        push_n: PUSH_N,
    })
}

/// Rate, Hz, cutoff, Hz, stiffness, N/m, damping, N s/m, then root mean squares of the ripple without and with the
/// feed-forward, N. A program that shares no code with this one simulated the linearised five-bar with dry friction in
/// steps of 20 µs, with a hand against the wall's tip force J⁻ᵀ M E Wrr⁻¹. Each ripple is the largest with 4 offsets of
/// the encoder counts.
const INDEPENDENT_RIPPLES: [(f64, f64, f64, f64, f64, f64); 4] = [
    (1_000.0, 100.0, 15_000.0, 40.0, 0.419, 0.292),
    (5_000.0, 200.0, 20_000.0, 60.0, 1.011, 0.684),
    (20_000.0, 500.0, 5_000.0, 150.0, 3.728, 3.708),
    (20_000.0, 500.0, 50_000.0, 150.0, 4.143, 4.071),
];

#[test]
fn the_ripple_agrees_with_an_independent_program() {
    for (rate, cutoff, kp, kd, off, full) in INDEPENDENT_RIPPLES {
        let around = ideal_loop(rate, 0.0, LinearEstimator::Butterworth(cutoff));
        for (mode, known) in [(Mode::Off, off), (Mode::Full, full)] {
            let found = with_pressed_wall(&around, None, |wall| wall.ripple(mode, kp, kd).unwrap().rms_n.unwrap());
            // The motion is chaotic, so the ripple depends on the start.
            assert!((0.93..1.07).contains(&(found / known)), "{rate} Hz, {kp} N/m, {mode:?}: {found} is not {known}");
        }
    }
}

#[test]
fn coarse_encoders_make_a_fast_loop_buzz_below_its_limit() {
    let around = ideal_loop(20_000.0, 0.0, LinearEstimator::Butterworth(500.0));
    let rms = |counts| {
        with_pressed_wall(&around, counts, |pressed| pressed.ripple(Mode::Off, 5_000.0, 150.0).unwrap().rms_n.unwrap())
    };
    let limit = with_pressed_wall(&around, None, |pressed| {
        pressed.ripple_line(Mode::Off, DampingRule::Damping(150.0), 0.1, &Sweep::quiet()).unwrap().unwrap().kp_stable
    });
    assert!(limit > 50.0 * 5_000.0, "{limit}");
    assert!(rms(None) > 2.0);
    // With fine encoders only the rounding of positions in the loop's arithmetic is left.
    assert!(rms(Some(2.0_f64.powi(30))) < 1e-3, "{}", rms(Some(2.0_f64.powi(30))));
    assert!(rms(Some(2.0_f64.powi(17))) < 0.5 * rms(None));
}

#[test]
fn the_boards_own_step_has_a_similar_ripple() {
    let mut file = shipped_device("coupled-five-bar");
    // Leave out dry friction, which may hold the tip between two counts while the comparison's hand presses constantly.
    file.description.joints.iter_mut().for_each(|joint| joint.coulomb = 0.0);
    for (rate_hz, cutoff_hz, wall) in [(1_000.0, 100.0, (15_000.0, 40.0)), (20_000.0, 500.0, (50_000.0, 150.0))] {
        let comparison = Comparison { file: &file, q: &POSE, normal: &NORMAL, rate_hz, cutoff_hz, wall };
        // The comparison has a delay of half a carrier period.
        let delay = 0.5 * rate_hz / 20_000.0;
        for (kind, linear) in [
            (Kind::Butterworth, LinearEstimator::Butterworth(cutoff_hz)),
            (
                Kind::Difference(Chosen { value: 8, filtered: false }),
                LinearEstimator::BackwardDifference.with_window(8),
            ),
        ] {
            let board = ripple_of(&comparison, kind).unwrap().unwrap();
            let around = ideal_loop(rate_hz, delay, linear);
            let found = with_pressed_wall(&around, None, |pressed| {
                let free_press = PressedWall { description: file.description, ..pressed.clone() };
                free_press.ripple(Mode::Off, wall.0, wall.1).unwrap().rms_n.unwrap()
            });
            assert!((0.6..1.7).contains(&(found / board)), "{rate_hz} Hz, {kind:?}: {found} is not {board}");
        }
    }
}

fn range_json(arguments: &[&str]) -> Value {
    let wall = ["range", "devices/coupled-five-bar.toml", "--q=2.6,1.75", "--normal=0.2588,0.9659"];
    common::json(&[&wall[..], arguments].concat())
}

#[test]
fn the_ripple_keeps_its_bound_up_to_the_named_stiffness() {
    let document = range_json(&["--rate", "1000", "--cutoff", "100", "--ripple", "0.1", "--wall", "15000,40"]);
    let ripple = &document["ripple"];
    assert!((ripple["count_m"].as_f64().unwrap() - 3.25e-5).abs() < 1e-7);
    assert!(ripple["wall"]["off"]["rms_n"].as_f64().unwrap() > 0.2);
    let off = &ripple["lines"][0]["off"];
    let (from, stable) = (off["kp_from"].as_f64().unwrap(), off["kp_stable"].as_f64().unwrap());
    assert!(from < 0.5 * stable, "{from} {stable}");
    let points = off["points"].as_array().unwrap();
    assert!(points.len() > 20);
    let number = |point: &Value, key: &str| point[key].as_f64().unwrap();
    for pair in points.windows(2) {
        assert!(number(&pair[0], "kp") < number(&pair[1], "kp"));
    }
    for point in points {
        let ratio = number(point, "kd") / number(point, "kp").sqrt();
        assert!((ratio / (number(&points[0], "kd") / number(&points[0], "kp").sqrt()) - 1.0).abs() < 1e-9);
        if number(point, "kp") < 0.999 * from {
            assert!(number(point, "rms_n") <= 0.1, "{point}");
        }
    }
    assert_eq!(document, range_json(&["--rate", "1000", "--cutoff", "100", "--ripple", "0.1", "--wall", "15000,40"]));
}

#[test]
fn impossible_bounds_and_walls_are_refused() {
    let line = "2: range devices/coupled-five-bar.toml --q=2.6,1.75 --normal=0.2588,0.9659";
    type_lines(
        &format!(
            "{line} --ripple 0 => --ripple 0 is not more than zero
            {line} --wall 0,1 => --wall needs a stiffness above zero
            {line} --ripple 1 --normal 1,0 => --ripple and --wall apply to one wall, and there are several --normal"
        ),
        &[],
    );
}
