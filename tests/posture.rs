//! A spring holds the posture of a redundant arm without a force at the tip.
//!
//! The oracle solves M q̈ + c + g = τ by elimination, with the controller's torque.

use crate::common::{bilateral_wall, device_file, fine_counts, inverse, with_fine_encoders};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism, Serial3r};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Posture, Scene, SceneError, Surface, Wall};
use nalgebra::Vector3;

const RATE_HZ: f64 = 20_000.0;

type ArmController = Controller<f64, Serial3r<f64>, Libm, 3>;

fn shipped_device(name: &str) -> Description {
    Description { gravity: [0.0; 3], ..with_fine_encoders(device_file::shipped_device(name)) }
}

fn redundant_arm() -> (Serial3r<f64>, Device<f64>) {
    let device = Device::<f64>::new("arm", &shipped_device("serial-3r")).expect("a sound device");
    let AnyMechanism::Serial3r(arm) = device.mechanism else { panic!("a redundant arm") };
    (arm, device)
}

fn scene(posture: Option<Posture<f64>>) -> Scene<f64> {
    Scene { task: 2, rate_hz: RATE_HZ, cutoff_hz: 2_000.0, posture, ..Scene::default() }
}

/// Returns the torques at the end of a steady motion to `q` at `qd`.
fn settled_torque(scene: &Scene<f64>, q: &Vector3<f64>, qd: &Vector3<f64>) -> Vector3<f64> {
    let (arm, device) = redundant_arm();
    let mut steps = ArmController::new(arm, &device, scene).expect("a sound scene");
    (-80..=0).map(|k| steps.step(&fine_counts(&(q + qd * (f64::from(k) / RATE_HZ)))).torque).last().expect("steps")
}

/// With φ = q₀ + q₁ + q₂ and by virtual work, a moment f on the last link is the torque f at every joint.
#[test]
fn the_posture_spring_is_a_moment_on_the_last_link() {
    let posture = Posture { orientation: 2.6, stiffness: 0.4, damping: 0.03 };
    for (q, qd) in
        [([0.5, 0.8, 0.7], [0.0; 3]), ([-0.8, 1.4, -2.0], [0.2, 0.5, 0.6]), ([0.4, 0.0, 0.3], [0.1, 0.0, 0.2])]
    {
        let (q, qd) = (Vector3::from(q), Vector3::from(qd));
        let moment = 0.4 * (2.6_f64 - q.sum()).sin() - 0.03 * qd.sum();
        let error = settled_torque(&scene(Some(posture)), &q, &qd) - Vector3::repeat(moment);
        assert!(error.norm() < 1e-4 * moment.abs(), "torque error {error} at a moment of {moment} N m");
    }
}

/// Torques along the null motion alone would keep the arm moving, because the shipped joints have unequal friction.
#[test]
fn a_free_arm_comes_to_rest() {
    let (arm, device) = redundant_arm();
    for damping in [0.0, 0.03] {
        let scene = scene(Some(Posture { orientation: 2.3, stiffness: 0.5, damping }));
        let mut steps = ArmController::new(arm, &device, &scene).expect("a sound scene");
        let (mut q, mut qd) = (Vector3::new(0.3, 1.2, 0.6), Vector3::new(0.3, -0.2, 0.0));
        let viscous = Vector3::from(device.joints.map(|joint| joint.viscous));
        for _ in 0..(20.0 * RATE_HZ) as usize {
            let step = steps.step(&fine_counts(&q));
            let pose = arm.pose::<Libm>(&q);
            let moving = step.torque - viscous.component_mul(&qd) - arm.coriolis(&pose, &qd);
            qd += inverse(&arm.mass(&pose)) * moving / RATE_HZ;
            q += qd / RATE_HZ;
        }
        assert!(qd.norm() < 0.03, "the arm moves at damping {damping}: {qd:?}");
    }
}

#[test]
fn an_arm_that_presses_a_wall_reaches_and_keeps_its_posture() {
    let (arm, device) = redundant_arm();
    let start = Vector3::new(0.5, 0.8, 0.7);
    let pose = arm.pose::<Libm>(&start);
    let (tip, normal) = (arm.tip(&pose), [0.6, 0.8, 0.0]);
    let wall = |feed_forward| Wall {
        damping: 30.0,
        feed_forward,
        bilateral: false,
        ..bilateral_wall(Surface::Plane(Plane { point: [tip[0], tip[1], 0.0], normal }), 3_000.0)
    };
    // The full feed-forward is not tested, because (4) itself pushes a resting arm along the null motion.
    for feed_forward in [FeedForward::Off, FeedForward::Washout] {
        let mut scene = scene(Some(Posture { orientation: 2.2, stiffness: 0.5, damping: 0.15 }));
        scene.walls.push(wall(feed_forward)).expect("room");
        let mut steps = ArmController::new(arm, &device, &scene).expect("a sound scene");
        let (mut q, mut qd) = (start, Vector3::<f64>::zeros());
        // A hand presses with 6 N, prevents sliding along the wall, and damps the tip.
        let hand = Vector3::new(-0.6, -0.8, 0.0) * 6.0;
        for _ in 0..(3.0 * RATE_HZ) as usize {
            let step = steps.step(&fine_counts(&q));
            let pose = arm.pose::<Libm>(&q);
            let jacobian = arm.jacobian(&pose);
            let (away, rate) = (arm.tip(&pose) - tip, jacobian * qd);
            let across = Vector3::new(-0.8, 0.6, 0.0);
            let grip = hand - across * (across.dot(&away) * 300.0) - Vector3::new(rate[0], rate[1], 0.0) * 5.0;
            let moving = step.torque + jacobian.tr_mul(&grip) - arm.coriolis(&pose, &qd);
            qd += inverse(&arm.mass(&pose)) * moving / RATE_HZ;
            q += qd / RATE_HZ;
        }
        let pose = arm.pose::<Libm>(&q);
        let depth = (tip - arm.tip(&pose)).dot(&Vector3::from(normal));
        assert!((q.sum() - 2.2).abs() < 0.002, "{feed_forward:?}: the orientation is {}", q.sum());
        // The penetration is the hand's force over the stiffness, whatever the posture spring does.
        assert!((depth - 0.002).abs() < 4e-5, "{feed_forward:?}: the penetration is {depth} m");
        assert!(qd.norm() < 1e-2, "{feed_forward:?}: the arm moves, {qd:?}");
    }
}

#[test]
fn a_posture_that_cannot_be_held_is_refused() {
    let posture = Posture { orientation: 0.3, stiffness: 0.2, damping: 0.0 };
    let device = Device::<f64>::new("five-bar", &shipped_device("coupled-five-bar")).expect("a sound device");
    let AnyMechanism::FiveBar(five_bar) = device.mechanism else { panic!("a five-bar") };
    let result = Controller::<f64, _, Libm, 2>::new(five_bar, &device, &scene(Some(posture)));
    assert_eq!(result.err(), Some(SceneError::Posture));
    for invalid in [
        Posture { orientation: f64::NAN, ..posture },
        Posture { stiffness: -1.0, ..posture },
        Posture { damping: f64::INFINITY, ..posture },
    ] {
        assert_eq!(scene(Some(invalid)).check(2), Err(SceneError::Posture));
    }
}
