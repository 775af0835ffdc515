//! Compares the velocity estimators of joints with their definitions, with whole counts and in the board's precision.

use crate::rig;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Scene, SceneError};
use haptic_bridge::render::velocity::{
    Chosen, Coefficients, CutoffMeaning, Difference, Estimator, EstimatorSpec, JointEstimator, JointSample,
    JointVelocity, Predicted,
};

const RATE_HZ: f64 = 20_000.0;
const NO_OPTIONS: Chosen = Chosen { value: 0, filtered: false };

fn with_value(value: u32) -> Chosen {
    Chosen { value, ..NO_OPTIONS }
}

fn prewarped_cutoff(cutoff: f64) -> f64 {
    (std::f64::consts::PI * cutoff / RATE_HZ).tan()
}

fn motion_sample<T: Real>(moved: T) -> JointSample<T> {
    JointSample { moved, pushed: T::zero(), unit: T::one() }
}

fn noise(n: u32) -> f64 {
    let mixed = n.wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(0x9E37_79B9);
    f64::from(mixed) / f64::from(u32::MAX) * 2.0 - 1.0
}

#[derive(Clone, Copy)]
struct ToyEstimator<T>(T);

impl<T: Real> JointEstimator<T> for ToyEstimator<T> {
    const SPEC: EstimatorSpec =
        EstimatorSpec { name: "toy", cutoff: CutoffMeaning::LowPassAfter, key: None, predicts: false };
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
    fn step<K: Math<T>>(&mut self, half: &T, seen: &JointSample<T>) -> T {
        let mean = (self.0 + seen.moved) * *half;
        self.0 = seen.moved;
        mean
    }
}

/// Returns the velocities that an estimator computes from rest for these motions.
fn run_estimator<E: JointEstimator<f64>>(
    chosen: Chosen,
    cutoff: f64,
    moved: impl IntoIterator<Item = f64>,
) -> Vec<f64> {
    let design = E::design(&chosen, prewarped_cutoff(cutoff));
    let mut memory = E::moving_at(0.0);
    moved.into_iter().map(|moved| memory.step::<Libm>(&design, &motion_sample(moved))).collect()
}

#[test]
fn a_toy_estimator_is_one_impl() {
    assert_eq!(run_estimator::<ToyEstimator<f64>>(NO_OPTIONS, 500.0, [2.0, 4.0, 0.0]), [1.0, 3.0, 2.0]);
}

#[test]
fn the_difference_is_the_mean_over_k_samples() {
    for k in [1_usize, 2, 10, 32] {
        let moved: Vec<f64> = (0..500).map(|n| (3.0 * noise(n)).round()).collect();
        for (n, found) in
            run_estimator::<Difference<f64>>(with_value(k as u32), 500.0, moved.iter().copied()).into_iter().enumerate()
        {
            let over: f64 = moved[(n + 1).saturating_sub(k)..=n].iter().sum();
            assert!((found - over / k as f64).abs() < 1e-12, "wrong mean over {k} samples at sample {n}");
        }
    }
}

#[test]
fn the_predicting_observer_has_three_equal_poles() {
    // For any initial state the velocity error is (a + b n + c n²) pⁿ, so (z - p)³ times the error is zero.
    let g = prewarped_cutoff(200.0);
    let p = (1.0 - g) / (1.0 + g);
    let design = Predicted::<f64>::design(&NO_OPTIONS, g);
    let mut memory = Predicted::moving_at(0.0);
    for n in 0..50 {
        memory.step::<Libm>(&design, &motion_sample(noise(n)));
    }
    let errors: Vec<f64> = (0..600).map(|_| memory.step::<Libm>(&design, &motion_sample(0.0))).collect();
    assert!(errors[0].abs() > 1e-3 && errors[599].abs() < 1e-6 * errors[0].abs(), "{} to {}", errors[0], errors[599]);
    for w in errors.windows(4) {
        let left = w[3] - 3.0 * p * w[2] + 3.0 * p * p * w[1] - p * p * p * w[0];
        assert!(left.abs() < 1e-12, "{left:e}");
    }
}

#[test]
fn a_known_push_acts_at_once_and_an_unknown_push_is_learned() {
    let design = Predicted::<f64>::design(&NO_OPTIONS, prewarped_cutoff(100.0));
    let mut memory = Predicted::moving_at(0.0);
    let (mut v, mut found) = (0.0, 0.0);
    for n in 0..2_000 {
        let (known, unknown) = (1e-3 * noise(n / 100), if n < 1_000 { 0.0 } else { 2e-4 });
        let moved = v + 0.5 * (known + unknown);
        v += known + unknown;
        found = memory.step::<Libm>(&design, &JointSample { moved, pushed: known, unit: 1.0 });
        if n < 1_000 {
            assert!((found - v).abs() < 1e-12, "step {n}: velocity {found} is not {v}");
        } else if n == 1_005 {
            assert!((found - v).abs() > 1e-4, "an unknown push cannot be estimated so soon");
        }
    }
    assert!((found / v - 1.0).abs() < 1e-9, "velocity {found} is not {v}");
}

#[test]
fn the_lag_at_constant_acceleration_is_as_reported() {
    // Acceleration in counts per period².
    let growth = 1e-5;
    for (_, kind) in Estimator::ALL {
        let (Some(spec), Some(chosen)) = (kind.spec(), kind.chosen()) else { continue };
        if spec.predicts {
            continue;
        }
        for filtered in [false, spec.cutoff == CutoffMeaning::LowPassAfter] {
            let kind = kind.with_options(Chosen { filtered, ..chosen });
            let coefficients = Coefficients::<f64>::new(kind, RATE_HZ, 500.0).unwrap();
            let mut joint = JointVelocity::default();
            let x = |n: f64| 0.5 * growth * n * n;
            let found = (1..=5_000)
                .map(f64::from)
                .map(|n| joint.step::<Libm>(&coefficients, &motion_sample(x(n) - x(n - 1.0)), 0.0))
                .last()
                .unwrap();
            let late = (growth * 5_000.0 - found) / growth;
            let reported = coefficients.lag() * RATE_HZ;
            assert!((late / reported - 1.0).abs() < 1e-6, "{kind:?}: a lag of {late} periods, reported {reported}");
        }
    }
}

#[test]
fn every_estimator_finds_the_speed_in_single_precision() {
    for (name, kind) in Estimator::ALL {
        if kind.spec().is_none() {
            continue;
        }
        let board = Coefficients::<f32>::new(*kind, RATE_HZ as f32, 500.0).unwrap();
        let double = Coefficients::<f64>::new(*kind, RATE_HZ, 500.0).unwrap();
        // 1 rad/s² in counts per period², for an encoder of 20,000 counts.
        let unit = 20_000.0 / std::f64::consts::TAU / (RATE_HZ * RATE_HZ);
        // 2 rad/s is 1/3 count per period. The mean is over the last 1,000 periods of 30 s of motion.
        let speed = 2.0 / std::f64::consts::TAU * 20_000.0 / RATE_HZ;
        let (mut on_board, mut in_double) = (JointVelocity::<f32>::default(), JointVelocity::<f64>::default());
        let (mut mean, mut difference) = (0.0, 0.0_f64);
        let periods = 600_000;
        for n in 1..=periods {
            let moved = (speed * f64::from(n)).floor() - (speed * f64::from(n - 1)).floor();
            let seen32 = JointSample { moved: moved as f32, pushed: 0.0, unit: unit as f32 };
            let v = f64::from(on_board.step::<BoardMath>(&board, &seen32, 0.0));
            let exact = in_double.step::<Libm>(&double, &JointSample { moved, pushed: 0.0, unit }, 0.0);
            if n > periods - 1_000 {
                mean += v / 1_000.0;
                difference = difference.max((v - exact).abs());
            }
        }
        assert!((mean / speed - 1.0).abs() < 1e-2, "{name}: mean velocity {mean} is not {speed}");
        // The difference is in counts per period.
        assert!(difference < 1e-4, "{name}: {difference:e} from double precision");
    }
}

#[test]
fn no_input_makes_an_estimator_panic() {
    for (_, kind) in Estimator::ALL {
        for value in [0, 1, 32, 33, u32::MAX] {
            let kind = kind.with_options(Chosen { value, filtered: value == 32 });
            let coefficients = Coefficients::<f32>::new(kind, 1000.0, 100.0).unwrap();
            let mut joint = JointVelocity::default();
            for moved in [0.0, 1.0, -4.3e9, f32::NAN, f32::INFINITY, 1.0, 2.0] {
                for unit in [0.0, -1.0, f32::NAN] {
                    joint.step::<BoardMath>(&coefficients, &JointSample { moved, pushed: moved, unit }, moved);
                }
            }
        }
    }
}

/// Returns a scene for the five-bar with one bilateral wall that has damping and no stiffness.
fn damped_wall_scene(estimator: Estimator) -> Scene<f32> {
    let mut wall = rig::wall(0.0, 0.0);
    wall.damping = 10.0;
    wall.bilateral = true;
    wall.feed_forward = FeedForward::Off;
    Scene { estimator, rate_hz: RATE_HZ as f32, cutoff_hz: 500.0, ..rig::scene(2, &[wall]) }
}

#[test]
fn the_velocity_at_a_wall_is_the_velocity_of_the_tip() {
    let device = rig::device(&rig::five_bar());
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    let scale = device.joints[0].radians_per_count;
    for (name, kind) in Estimator::ALL {
        let mut controller: Controller<f32, _, BoardMath, 2> =
            Controller::new(mechanism, &device, &damped_wall_scene(*kind)).unwrap();
        // Joint 0 turns by one count per step.
        let rate = scale * RATE_HZ as f32;
        let mut last = None;
        for n in 0..400 {
            let step = controller.step(&[n, 0]);
            last =
                Some((step, last.map(|(step, _): (haptic_bridge::render::controller::Step<f32, 2>, _)| step.distance)));
        }
        let (step, before) = last.expect("steps");
        let moved = (step.distance - before.expect("a step before")) * RATE_HZ as f32;
        assert!((step.qd[0] / rate - 1.0).abs() < 0.02, "{name}: joint velocity {} is not {rate} rad/s", step.qd[0]);
        assert!(
            (step.normal_velocity / moved - 1.0).abs() < 0.05,
            "{name}: wall velocity {} is not {moved} m/s",
            step.normal_velocity
        );
    }
}

#[test]
fn a_new_estimator_starts_from_the_present_velocity() {
    let device = rig::device(&rig::five_bar());
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    for (from, first) in Estimator::ALL {
        for (to, second) in Estimator::ALL {
            let mut controller: Controller<f32, _, BoardMath, 2> =
                Controller::new(mechanism, &device, &damped_wall_scene(*first)).unwrap();
            let mut speeds = Vec::new();
            for n in 0..600 {
                if n == 400 {
                    controller.set_coefficients(&Coefficients::new(*second, RATE_HZ as f32, 500.0).unwrap());
                }
                speeds.push(controller.step(&[4 * n, 0]).normal_velocity);
            }
            let jump = speeds[395..].windows(2).map(|v| (v[1] - v[0]).abs()).fold(0.0, f32::max);
            // The backward difference stores no low-passed velocity, so the next estimator starts from rest.
            let from_rest = *from == "backward-difference" && from != to;
            assert!(jump < 0.1 * speeds[395].abs() || from_rest, "{from} to {to}: a jump by {jump} of {}", speeds[395]);
        }
    }
}

#[test]
fn a_value_outside_the_range_is_refused() {
    for (name, kind) in Estimator::ALL {
        let Some(key) = kind.spec().and_then(|spec| spec.key) else { continue };
        for (value, is_valid) in
            [(key.range.0 - 1, false), (key.range.0, true), (key.range.1, true), (key.range.1 + 1, false)]
        {
            let checked = damped_wall_scene(kind.with_options(with_value(value))).check(2);
            assert_eq!(checked, if is_valid { Ok(()) } else { Err(SceneError::Estimator) }, "{name} = {value}");
        }
    }
}
