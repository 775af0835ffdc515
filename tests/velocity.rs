//! The velocity estimators have the transfer functions of the usual digital designs, in single and double precision.

use crate::rig;
use haptic_bridge::math::Libm;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::velocity::{
    Chosen, Coefficients, Estimator, JointSample, JointVelocity, LowPass, Velocity, Washout,
};

/// Computes the direct-form coefficients (b0, b1, b2, a1, a2) of a 2nd-order digital Butterworth low-pass from its
/// definition, the prewarped bilinear transform of 1/(s² + √2 s + 1).
fn butterworth_coefficients(cutoff: f64, rate: f64) -> [f64; 5] {
    let g = (std::f64::consts::PI * cutoff / rate).tan();
    let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * g + g * g);
    let b = g * g * norm;
    [b, 2.0 * b, b, 2.0 * (g * g - 1.0) * norm, (1.0 - std::f64::consts::SQRT_2 * g + g * g) * norm]
}

#[test]
fn the_butterworth_filter_agrees_with_the_direct_form() {
    for (rate, cutoff) in [(200.0, 20.0), (1000.0, 20.0), (20_000.0, 500.0), (50_000.0, 20_000.0)] {
        let coefficients = Coefficients::<f64>::new(Estimator::Butterworth, rate, cutoff).unwrap();
        let [b0, b1, b2, a1, a2] = butterworth_coefficients(cutoff, rate);
        let mut filter = LowPass::default();
        let (mut x, mut y) = ([0.0; 2], [0.0; 2]);
        for step in 0..2000 {
            let input = ((step * step % 97) as f64) / 97.0 - 0.3;
            let direct = b0 * input + b1 * x[0] + b2 * x[1] - a1 * y[0] - a2 * y[1];
            (x, y) = ([input, x[0]], [direct, y[0]]);
            let ours = filter.step(&coefficients, input);
            assert!((ours - direct).abs() < 1e-9, "{rate} Hz, {cutoff} Hz, step {step}: {ours}, not {direct}");
        }
    }
}

#[test]
fn single_precision_keeps_the_gain_at_a_thousandth_of_the_rate() {
    let coefficients = Coefficients::<f32>::new(Estimator::Butterworth, 20_000.0, 20.0).unwrap();
    let mut filter = LowPass::default();
    let output = (0..200_000).map(|_| filter.step(&coefficients, 0.7)).last().unwrap();
    assert!((f64::from(output) / f64::from(0.7f32) - 1.0).abs() < 4e-6, "{output}");
}

#[test]
fn every_estimator_finds_the_slope_of_a_ramp() {
    for kind in [Estimator::Butterworth, Estimator::FirstOrder, Estimator::BackwardDifference] {
        let coefficients = Coefficients::<f64>::new(kind, 1000.0, 50.0).unwrap();
        let mut velocity = Velocity::resting_at(3.0);
        let last = (0..2000).map(|step| velocity.step(&coefficients, 3.0 + 0.25e-3 * f64::from(step))).last().unwrap();
        assert!((last - 0.25).abs() < 1e-9, "{kind:?}: last velocity {last}");
    }
}

#[test]
fn the_lag_at_constant_acceleration_is_as_reported() {
    for kind in [Estimator::Butterworth, Estimator::FirstOrder, Estimator::BackwardDifference] {
        for (rate, cutoff) in [(200.0, 20.0), (1_000.0, 100.0), (1_000.0, 400.0), (20_000.0, 500.0)] {
            let coefficients = Coefficients::<f64>::new(kind, rate, cutoff).unwrap();
            let mut filter = LowPass::default();
            // With x = t²/2 the velocity equals the time.
            let position = |k: f64| 0.5 * (k / rate).powi(2);
            let last = 2_000.0;
            let mut estimate = 0.0;
            for k in 1..=2_000 {
                let k = f64::from(k);
                estimate = filter.step(&coefficients, (position(k) - position(k - 1.0)) * rate);
            }
            let (late, reported) = (last / rate - estimate, coefficients.lag());
            assert!(
                (late / reported - 1.0).abs() < 1e-6,
                "{kind:?}, {rate} Hz, cutoff {cutoff} Hz: a lag of {late} s, reported {reported}"
            );
        }
    }
}

#[test]
fn the_first_position_is_not_a_motion() {
    let coefficients = Coefficients::<f32>::new(Estimator::BackwardDifference, 1000.0, 50.0).unwrap();
    let mut velocity = Velocity::resting_at(0.4);
    assert_eq!(velocity.step(&coefficients, 0.4), 0.0);
}

#[test]
fn a_cutoff_at_or_above_half_the_rate_is_refused() {
    for cutoff in [0.0, -1.0, 500.0, 501.0, f32::NAN, f32::INFINITY] {
        assert!(Coefficients::<f32>::new(Estimator::Butterworth, 1000.0, cutoff).is_err(), "{cutoff}");
        assert!(Washout::<f32>::new(cutoff, 1000.0).is_err(), "{cutoff}");
    }
}

#[test]
fn a_slow_washout_removes_a_constant_force_in_single_precision() {
    let mut washout = Washout::<f32>::new(0.2, 50_000.0).unwrap();
    assert!((washout.step(5.0) - 5.0).abs() < 1e-3);
    // After twelve time constants of 1/(2π 0.2 Hz) 6e-6 of the force is left.
    let left = (0..(12.0 * 0.8 * 50_000.0) as u32).map(|_| washout.step(5.0)).last().unwrap();
    assert!(left.abs() < 1e-4, "{left} of the force is left");
}

/// The library computes the response to a single count over a shorter time than the 4 s of this test.
#[test]
fn the_response_to_one_count_is_right_although_truncated() {
    let device: Device<f64> = rig::device(&rig::five_bar()).cast();
    let filtered = |value| Chosen { value, filtered: true };
    let estimators = [
        Estimator::Difference(filtered(32)),
        Estimator::Difference(filtered(3)),
        Estimator::Predicted(Chosen { value: 0, filtered: false }),
    ];
    for (kind, cutoff) in estimators.into_iter().flat_map(|kind| [1.0, 30.0, 500.0].map(|cutoff| (kind, cutoff))) {
        let rate = 20_000.0;
        let found = Coefficients::of_device::<Libm>((kind, rate, cutoff), &device).unwrap();
        for (joint, known) in device.joints.iter().zip(found.one_count()).take(device.axes()) {
            let speed = joint.radians_per_count.abs() * rate;
            let mut velocity = JointVelocity::default();
            let response = (0..80_000).map(|period| {
                let moved = if period == 7 { 1.0 } else { 0.0 };
                let seen = JointSample { moved, pushed: 0.0, unit: 1.0 / (speed * rate) };
                velocity.step::<Libm>(&found, &seen, 0.0).abs()
            });
            let peak = speed * response.fold(0.0, f64::max);
            assert!(peak > 0.0, "{kind:?}");
            assert!((known - peak).abs() <= 1e-9 * peak, "{kind:?} at {cutoff} Hz: peak {known}, measured {peak}");
        }
    }
    // If the window is much shorter than the low-pass, the peak equals the peak of the low-pass's impulse response. For
    // a 2nd-order Butterworth filter that is √2 e^(-π/4) sin(π/4) 2πf counts per second.
    let found = Coefficients::of_device::<Libm>((Estimator::Difference(filtered(3)), 20_000.0, 20.0), &device).unwrap();
    let peak = 2f64.sqrt() * (-std::f64::consts::FRAC_PI_4).exp() * (0.5f64.sqrt()) * 40.0 * std::f64::consts::PI;
    let expected = device.joints[0].radians_per_count.abs() * peak;
    assert!((found.one_count()[0] / expected - 1.0).abs() < 0.01, "peak {}, expected {expected}", found.one_count()[0]);
}
