//! Velocity terms, which grow with the square of the speed, do not respond to single encoder counts.

use crate::common::prelude::*;
use crate::common::{all_shipped_devices, plane_wall, shipped_device};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::with_mechanism;
use nalgebra::SVector;
use std::f64::consts::TAU;

/// Returns a scene with a bilateral plane through the tip and the full feed-forward.
fn wall_scene(tip: &[f64], task: usize, estimator: Estimator, velocity_terms: VelocityTerms) -> Scene<f64> {
    let mut scene =
        Scene { task: task as u8, rate_hz: 20_000.0, cutoff_hz: 500.0, estimator, velocity_terms, ..Scene::default() };
    let length = (task as f64).sqrt();
    let at = |i: usize, value: f64| if i < task { value } else { 0.0 };
    let normal = std::array::from_fn(|i| at(i, 1.0 / length));
    let point = std::array::from_fn(|i| if i < task { tip[i] + 0.002 * normal[i] } else { 0.0 });
    let plane = plane_wall(point, normal, 100.0, 0.0);
    scene.walls.push(Wall { feed_forward: FeedForward::Full, bilateral: true, ..plane }).unwrap();
    scene
}

/// Returns the largest torque (N m) of the velocity terms while one joint after the other moves by one count and rests.
fn velocity_torque<M: Mechanism<f64, N>, const N: usize>(
    mechanism: &M,
    device: &Device<f64>,
    estimator: Estimator,
) -> f64 {
    let home = device.home.unwrap_or_default();
    let scale = |i: usize| device.joints[i].radians_per_count;
    let mut counts: [i32; N] = std::array::from_fn(|i| ((home[i] - device.joints[i].offset) / scale(i)).round() as i32);
    let tip = mechanism.tip(&mechanism.pose::<Libm>(&SVector::from_fn(|i, _| home[i])));
    let of = |terms| {
        let scene = wall_scene(tip.as_slice(), M::SPEC.task, estimator, terms);
        Controller::<f64, _, Libm, N>::new(*mechanism, device, &scene).unwrap()
    };
    let (mut with, mut without) = (of(VelocityTerms::Rendered), of(VelocityTerms::Off));
    let mut largest_torque = 0.0_f64;
    for period in 0..400 * (N + 1) {
        if period % 400 == 399 && period / 400 < N {
            counts[period / 400] += 1;
        }
        let [with, without] = [with.step(&counts), without.step(&counts)];
        assert_eq!(with.contacts, 1);
        largest_torque = largest_torque.max((with.torque - without.torque).amax());
    }
    largest_torque
}

#[test]
fn velocity_terms_do_not_act_on_single_counts() {
    let mut case_count = 0;
    for file in all_shipped_devices() {
        let device = file.device().unwrap();
        for (name, estimator) in Estimator::ALL {
            let largest_torque = with_mechanism!(&device.mechanism, m => velocity_torque(m, &device, *estimator));
            assert!(largest_torque < 1e-9, "{}, {name}: one count causes {largest_torque} N m", file.name);
            case_count += 1;
        }
    }
    assert!(case_count >= 9 * Estimator::ALL.len(), "{case_count}");
}

/// Returns the mean torques, N m, of the velocity terms over 200 periods while a five-bar's joints turn evenly.
fn mean_torque(counts_per_turn: f64, speed: f64) -> SVector<f64, 2> {
    let mut description = shipped_device("coupled-five-bar").description;
    for joint in &mut description.joints[..2] {
        joint.encoder.as_mut().unwrap().counts_per_turn = counts_per_turn;
    }
    let device = Device::<f64>::new("turning", &description).unwrap();
    let haptic_bridge::model::mechanism::AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!() };
    let start = [2.6, 1.75];
    let tip = mechanism.tip(&mechanism.pose::<Libm>(&SVector::from(start)));
    let of = |terms| {
        let scene = wall_scene(tip.as_slice(), 2, Estimator::Butterworth, terms);
        Controller::<f64, _, Libm, 2>::new(mechanism, &device, &scene).unwrap()
    };
    let (mut with, mut without) = (of(VelocityTerms::Rendered), of(VelocityTerms::Off));
    let (periods, window) = (600, 200);
    let mut sum = SVector::zeros();
    for period in 0..periods {
        let turn_angle = speed * f64::from(period) / 20_000.0;
        let counts = [start[0] + turn_angle, start[1] - turn_angle].map(|q| (q / TAU * counts_per_turn).floor() as i32);
        let added = with.step(&counts).torque - without.step(&counts).torque;
        if period >= periods - window {
            sum += added / f64::from(window);
        }
    }
    sum
}

/// A velocity of 12 times its uncertainty is reduced by 1/12², and a product of two velocities by 2/12².
#[test]
fn velocity_terms_act_on_a_motion() {
    // Largest response of a 2nd-order Butterworth to a step of its input's integral: ω e^(-π/4) sin(π/4) √2.
    let uncertainty = TAU / 20_000.0 * TAU * 500.0 * (-std::f64::consts::FRAC_PI_4).exp();
    let [coarse, fine] = [20_000.0, 16_777_216.0].map(|counts| mean_torque(counts, 12.0 * uncertainty));
    assert!(fine.amax() > 0.01, "{fine}");
    assert!((coarse - fine).amax() < 0.03 * fine.amax(), "{coarse} for {fine}");
    // If counts are rare, the velocity terms almost vanish.
    let slow = mean_torque(20_000.0, 0.1 * uncertainty);
    assert!(slow.amax() < 1e-4 * fine.amax(), "{slow}");
}
