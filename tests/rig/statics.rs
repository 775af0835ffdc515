//! Oracle for the joint torques and tip forces of the rig's five-bar, independent of the library's Jacobian.

use super::five_bar;
use haptic_bridge::math::Libm;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use nalgebra::{Matrix2, Vector2};

/// Computes Jᵀ f of the rig's five-bar by differences of the tip position in f64, without the library's J.
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

/// Computes the tip force of joint torques, J⁻ᵀ τ.
pub fn force_at_tip(q: &[f32; 3], torque: Vector2<f64>) -> Vector2<f64> {
    let transposed = Matrix2::from_columns(&[torques(q, [1.0, 0.0]), torques(q, [0.0, 1.0])]);
    transposed.try_inverse().expect("not a singular pose") * torque
}
