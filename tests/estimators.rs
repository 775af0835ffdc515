//! The estimators that watch joints: each against its definition, with the counts of a real encoder, in the board's
//! precision.

use crate::rig;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Scene, SceneError};
use haptic_bridge::render::velocity::{
    Chosen, Coefficients, CutoffMeans, Difference, Estimator, EstimatorSpec, JointEstimator, JointVelocity, Predicted,
    Seen,
};

const RATE: f64 = 20_000.0;
const PLAIN: Chosen = Chosen { value: 0, filtered: false };

fn taking(value: u32) -> Chosen {
    Chosen { value, ..PLAIN }
}

fn warped(cutoff: f64) -> f64 {
    (std::f64::consts::PI * cutoff / RATE).tan()
}

fn seen<T: Real>(moved: T) -> Seen<T> {
    Seen { moved, pushed: T::zero(), unit: T::one() }
}

/// Wild but repeatable, between -1 and 1.
fn wild(n: u32) -> f64 {
    let mixed = n.wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(0x9E37_79B9);
    f64::from(mixed) / f64::from(u32::MAX) * 2.0 - 1.0
}

/// The mean of this sample's and the last's motion.
#[derive(Clone, Copy)]
struct Toy<T>(T);

impl<T: Real> JointEstimator<T> for Toy<T> {
    const SPEC: EstimatorSpec =
        EstimatorSpec { name: "toy", cutoff: CutoffMeans::LowPassBehind, key: None, predicts: false };
    type Design = T;
    fn design(_: &Chosen, _: T) -> T {
        T::from_f64(0.5)
    }
    fn lag(_: &T) -> T {
        T::one()
    }
    fn moving_at(velocity: T) -> Self {
        Self(velocity)
    }
    fn step<K: Math<T>>(&mut self, half: &T, seen: &Seen<T>) -> T {
        let mean = (self.0 + seen.moved) * *half;
        self.0 = seen.moved;
        mean
    }
}

/// Velocities of an estimator that is fed these motions, from rest.
fn run<E: JointEstimator<f64>>(chosen: Chosen, cutoff: f64, moved: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let design = E::design(&chosen, warped(cutoff));
    let mut memory = E::moving_at(0.0);
    moved.into_iter().map(|moved| memory.step::<Libm>(&design, &seen(moved))).collect()
}

#[test]
fn a_toy_estimator_is_one_impl() {
    assert_eq!(run::<Toy<f64>>(PLAIN, 500.0, [2.0, 4.0, 0.0]), [1.0, 3.0, 2.0]);
}

#[test]
fn the_difference_is_that_over_k_samples() {
    for k in [1_usize, 2, 10, 32] {
        let moved: Vec<f64> = (0..500).map(|n| (3.0 * wild(n)).round()).collect();
        for (n, found) in run::<Difference<f64>>(taking(k as u32), 500.0, moved.iter().copied()).into_iter().enumerate()
        {
            let over: f64 = moved[(n + 1).saturating_sub(k)..=n].iter().sum();
            assert!((found - over / k as f64).abs() < 1e-12, "over {k}, sample {n}");
        }
    }
}

#[test]
fn the_predicting_observer_forgets_by_three_equal_poles() {
    // Whatever it believed, what is wrong with its velocity ends like (a + b n + c n²) pⁿ: three steps of (z - p) on it
    // leave nothing.
    let g = warped(200.0);
    let p = (1.0 - g) / (1.0 + g);
    let design = Predicted::<f64>::design(&PLAIN, g);
    let mut memory = Predicted::moving_at(0.0);
    for n in 0..50 {
        memory.step::<Libm>(&design, &seen(wild(n)));
    }
    let wrong: Vec<f64> = (0..600).map(|_| memory.step::<Libm>(&design, &seen(0.0))).collect();
    assert!(wrong[0].abs() > 1e-3 && wrong[599].abs() < 1e-6 * wrong[0].abs(), "{} {}", wrong[0], wrong[599]);
    for w in wrong.windows(4) {
        let left = w[3] - 3.0 * p * w[2] + 3.0 * p * p * w[1] - p * p * p * w[0];
        assert!(left.abs() < 1e-12, "{left:e}");
    }
}

#[test]
fn a_known_push_is_known_at_once_and_an_unknown_one_learnt_without_an_error() {
    let design = Predicted::<f64>::design(&PLAIN, warped(100.0));
    let mut memory = Predicted::moving_at(0.0);
    let (mut v, mut found) = (0.0, 0.0);
    for n in 0..2_000 {
        let (known, unknown) = (1e-3 * wild(n / 100), if n < 1_000 { 0.0 } else { 2e-4 });
        let moved = v + 0.5 * (known + unknown);
        v += known + unknown;
        found = memory.step::<Libm>(&design, &Seen { moved, pushed: known, unit: 1.0 });
        if n < 1_000 {
            assert!((found - v).abs() < 1e-12, "step {n}: {found} is not {v}");
        } else if n == 1_005 {
            assert!((found - v).abs() > 1e-4, "what nobody said cannot be known so soon");
        }
    }
    assert!((found / v - 1.0).abs() < 1e-9, "{found} is not {v}");
}

#[test]
fn a_velocity_that_grows_steadily_is_known_as_late_as_said() {
    // In counts per period.
    let growth = 1e-5;
    for (_, kind) in Estimator::ALL {
        let (Some(spec), Some(chosen)) = (kind.spec(), kind.chosen()) else { continue };
        if spec.predicts {
            continue;
        }
        for filtered in [false, spec.cutoff == CutoffMeans::LowPassBehind] {
            let kind = kind.choosing(Chosen { filtered, ..chosen });
            let coefficients = Coefficients::<f64>::new(kind, RATE, 500.0).unwrap();
            let mut joint = JointVelocity::default();
            let x = |n: f64| 0.5 * growth * n * n;
            let found = (1..=5_000)
                .map(f64::from)
                .map(|n| joint.step::<Libm>(&coefficients, &seen(x(n) - x(n - 1.0)), 0.0))
                .last()
                .unwrap();
            let late = (growth * 5_000.0 - found) / growth;
            let said = coefficients.lag() * RATE;
            assert!((late / said - 1.0).abs() < 1e-6, "{kind:?}: {late} periods, said {said}");
        }
    }
}

#[test]
fn every_estimator_finds_the_speed_of_an_encoder_of_20000_counts_at_20_khz_in_single_precision() {
    for (name, kind) in Estimator::ALL {
        if kind.spec().is_none() {
            continue;
        }
        let board = Coefficients::<f32>::new(*kind, RATE as f32, 500.0).unwrap();
        let double = Coefficients::<f64>::new(*kind, RATE, 500.0).unwrap();
        // One rad/s² in counts per period².
        let unit = 20_000.0 / std::f64::consts::TAU / (RATE * RATE);
        // 2 rad/s: a third of a count a period. From 30 s of motion the last 1000 periods are averaged.
        let speed = 2.0 / std::f64::consts::TAU * 20_000.0 / RATE;
        let (mut on_board, mut in_double) = (JointVelocity::<f32>::default(), JointVelocity::<f64>::default());
        let (mut mean, mut apart) = (0.0, 0.0_f64);
        let periods = 600_000;
        for n in 1..=periods {
            let moved = (speed * f64::from(n)).floor() - (speed * f64::from(n - 1)).floor();
            let seen32 = Seen { moved: moved as f32, pushed: 0.0, unit: unit as f32 };
            let v = f64::from(on_board.step::<BoardMath>(&board, &seen32, 0.0));
            let exact = in_double.step::<Libm>(&double, &Seen { moved, pushed: 0.0, unit }, 0.0);
            if n > periods - 1_000 {
                mean += v / 1_000.0;
                apart = apart.max((v - exact).abs());
            }
        }
        assert!((mean / speed - 1.0).abs() < 1e-2, "{name}: {mean} is not {speed}");
        // Of a count per period.
        assert!(apart < 1e-4, "{name}: {apart:e} apart");
    }
}

#[test]
fn nothing_that_is_fed_makes_an_estimator_panic() {
    for (_, kind) in Estimator::ALL {
        for value in [0, 1, 32, 33, u32::MAX] {
            let kind = kind.choosing(Chosen { value, filtered: value == 32 });
            let coefficients = Coefficients::<f32>::new(kind, 1000.0, 100.0).unwrap();
            let mut joint = JointVelocity::default();
            for moved in [0.0, 1.0, -4.3e9, f32::NAN, f32::INFINITY, 1.0, 2.0] {
                for unit in [0.0, -1.0, f32::NAN] {
                    joint.step::<BoardMath>(&coefficients, &Seen { moved, pushed: moved, unit }, moved);
                }
            }
        }
    }
}

/// A five-bar with one wall that damps and does not push, and a controller for it.
fn wall(estimator: Estimator) -> Scene<f32> {
    let mut wall = rig::wall(0.0, 0.0);
    wall.damping = 10.0;
    wall.bilateral = true;
    wall.feed_forward = FeedForward::Off;
    Scene { estimator, rate_hz: RATE as f32, cutoff_hz: 500.0, ..rig::scene(2, &[wall]) }
}

#[test]
fn the_velocity_at_a_wall_is_that_of_the_tip() {
    let device = rig::device(&rig::five_bar());
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    let scale = device.joints[0].radians_per_count;
    for (name, kind) in Estimator::ALL {
        let mut controller: Controller<f32, _, BoardMath, 2> =
            Controller::new(mechanism, &device, &wall(*kind)).unwrap();
        // Joint 0 turns by a count a step.
        let rate = scale * RATE as f32;
        let mut last = None;
        for n in 0..400 {
            let step = controller.step(&[n, 0]);
            last =
                Some((step, last.map(|(step, _): (haptic_bridge::render::controller::Step<f32, 2>, _)| step.distance)));
        }
        let (step, before) = last.expect("steps");
        let moved = (step.distance - before.expect("a step before")) * RATE as f32;
        assert!((step.qd[0] / rate - 1.0).abs() < 0.02, "{name}: {} is not {rate} rad/s", step.qd[0]);
        assert!(
            (step.normal_velocity / moved - 1.0).abs() < 0.05,
            "{name}: {} is not {moved} m/s",
            step.normal_velocity
        );
    }
}

#[test]
fn another_estimator_goes_on_from_the_velocity_that_was() {
    let device = rig::device(&rig::five_bar());
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    for (from, first) in Estimator::ALL {
        for (to, second) in Estimator::ALL {
            let mut controller: Controller<f32, _, BoardMath, 2> =
                Controller::new(mechanism, &device, &wall(*first)).unwrap();
            let mut speeds = Vec::new();
            for n in 0..600 {
                if n == 400 {
                    controller.set_coefficients(&Coefficients::new(*second, RATE as f32, 500.0).unwrap());
                }
                speeds.push(controller.step(&[4 * n, 0]).normal_velocity);
            }
            let jump = speeds[395..].windows(2).map(|v| (v[1] - v[0]).abs()).fold(0.0, f32::max);
            // The backward difference keeps no low-passed velocity: what follows it starts from rest.
            let from_rest = *from == "backward-difference" && from != to;
            assert!(jump < 0.1 * speeds[395].abs() || from_rest, "{from} to {to}: {jump} of {}", speeds[395]);
        }
    }
}

#[test]
fn a_value_outside_its_range_is_refused() {
    for (name, kind) in Estimator::ALL {
        let Some(key) = kind.spec().and_then(|spec| spec.key) else { continue };
        for (value, sound) in
            [(key.range.0 - 1, false), (key.range.0, true), (key.range.1, true), (key.range.1 + 1, false)]
        {
            let checked = wall(kind.choosing(taking(value))).check(2);
            assert_eq!(checked, if sound { Ok(()) } else { Err(SceneError::Estimator) }, "{name} {value}");
        }
    }
}
