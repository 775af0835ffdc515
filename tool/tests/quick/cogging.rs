//! The cogging of a motor is learnt on a simulated board, which then compensates it.

use crate::common::cogged::CoggedPaddle;
use crate::common::run;
use haptic_bridge::model::cogging::Compensation;
use haptic_predict::cogging::{CoggingError, Learnt, Motion, Pass, Sample, fit};
use haptic_sim::Random;

#[test]
fn a_motors_cogging_is_learnt_and_compensated() {
    let paddle = CoggedPaddle::with_arc(3, 0.5);
    let (shared, mut board) = paddle.board();
    let learnt = paddle.learn(&mut board).unwrap();
    let (before, after) = paddle.ripple(&learnt.potential);
    assert!(after < 0.15 * before && learnt.held_out < 0.15 * learnt.before, "{after} of {before} N m, {learnt:?}");
    // The board commands the compensation in addition to the weight.
    board.arm().unwrap();
    shared.lock().run(0.6);
    let status = board.status().unwrap();
    let torque = board.force(&Default::default()).unwrap().torque[0];
    let device = paddle.file.device::<f32>().unwrap();
    let joint = &device.joints[0];
    let count = ((status.q[0] - joint.offset) / joint.radians_per_count).round() as i32;
    let weight = device.mechanism.gravity::<haptic_bridge::math::Libm>(&status.q)[0];
    let expected = weight + Compensation::new(joint, &learnt.potential).torque(count);
    assert!((torque - expected).abs() < 0.02 * before as f32, "{torque} N m, not {expected} N m");
}

/// Returns slow passes whose torque is `torque` of angle and direction, with noise.
fn passes(torque: impl Fn(f64, f64) -> f64) -> Vec<Pass> {
    let mut draw = Random::new(1);
    let mut pass = |forward: bool| {
        let direction = if forward { 1.0 } else { -1.0 };
        let sample = |i: u32| {
            let (time, q) = (1e-3 * f64::from(i), direction * (0.25e-3 * f64::from(i) - 0.75));
            Sample { time, q, torque: torque(q, direction) + draw.between(-2e-4, 2e-4) }
        };
        Pass { forward, samples: (0..6_000).map(sample).collect() }
    };
    vec![pass(true), pass(false)]
}

#[test]
fn friction_that_depends_on_the_angle_and_a_load_are_not_learnt() {
    let motion = Motion { inertia: 0.0, viscous: 0.0, speed: 0.25, count: 4e-4, ratio: 1.0 };
    let friction = |q: f64, direction: f64| direction * 0.01 * (2.0 + (84.0 * q).sin());
    let load = |q: f64| 0.05 * q.sin() + 0.02 * (q - 0.3).powi(2);
    let before = match fit(&passes(|q, direction| friction(q, direction) + load(q)), &motion) {
        Ok(Learnt { before, .. }) | Err(CoggingError::Nothing { before, .. }) => before,
        Err(error) => panic!("{error}"),
    };
    assert!(before < 1e-4, "{before} N m of friction or load");
    let magnets = |q: f64| 2e-3 * (84.0 * q + 1.0).sin();
    let learnt = fit(&passes(|q, direction| magnets(q) + friction(q, direction) + load(q)), &motion).unwrap();
    assert_eq!(learnt.potential[0].order, 84);
    assert!(learnt.after < 0.1 * learnt.before && (learnt.friction / 0.02 - 1.0).abs() < 0.05, "{learnt:?}");
    let noise = fit(&passes(|_, direction| 0.02 * direction), &motion);
    assert!(matches!(noise, Err(CoggingError::Nothing { .. })), "{noise:?}");
}

#[test]
fn a_board_with_another_device_is_refused() {
    let (code, _, err) = run(&["cogging", "devices/haply-2diy.toml", "--port", "sim"]);
    assert!(code == 1 && err.contains("haptic device"), "{code}: {err}");
}
