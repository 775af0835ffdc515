//! Joint torques and forces at the tip of the five-bar of these tests, worked out apart from the library's own.

use super::five_bar;
use haptic_bridge::math::Libm;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use nalgebra::{Matrix2, Vector2};

/// Jᵀ f of the five-bar of this rig, by differences of the tip in f64: neither J nor its transpose is asked.
pub fn torques(q: &[f32; 3], f: [f64; 2]) -> Vector2<f64> {
    let device = Device::<f64>::new("test", &five_bar()).expect("a sound device");
    let AnyMechanism::FiveBar(mechanism) = device.mechanism else { panic!("a five-bar") };
    let tip = |i: usize, by: f64| {
        let mut at = Vector2::new(f64::from(q[0]), f64::from(q[1]));
        at[i] += by;
        let pose = mechanism.pose::<Libm>(&at);
        mechanism.tip(&pose)
    };
    let h = 1.0e-6;
    Vector2::from_fn(|i, _| (tip(i, h) - tip(i, -h)).dot(&Vector2::from(f)) / (2.0 * h))
}

/// The force at the tip that joint torques are worth, J⁻ᵀ τ.
pub fn worth(q: &[f32; 3], torque: Vector2<f64>) -> Vector2<f64> {
    let transposed = Matrix2::from_columns(&[torques(q, [1.0, 0.0]), torques(q, [0.0, 1.0])]);
    transposed.try_inverse().expect("not a singular pose") * torque
}
