//! Oracle for joint torques and tip forces of the rig's five-bar, without the library's geometry and Jacobian.

use super::Rig;
use nalgebra::{Matrix2, Vector2};

/// Computes the tip position (m) at two joint angles (rad) from the circles around the elbows.
pub fn tip(q: [f64; 2]) -> Vector2<f64> {
    let [left, right] =
        [(-0.025, q[0]), (0.025, q[1])].map(|(x, angle)| Vector2::new(x + 0.07 * angle.cos(), 0.07 * angle.sin()));
    let apart = right - left;
    let half = 0.5 * apart.norm();
    let height = (0.09_f64.powi(2) - half * half).sqrt() / (2.0 * half);
    (left + right) * 0.5 + Vector2::new(-apart.y, apart.x) * height
}

/// Computes Jᵀ f (N m) from differences of the tip position.
pub fn torques(q: &[f32; 3], f: [f64; 2]) -> Vector2<f64> {
    let moved = |i: usize, by: f64| {
        let mut at = [0, 1].map(|i| f64::from(q[i]));
        at[i] += by;
        tip(at)
    };
    let h = 1.0e-6;
    Vector2::from_fn(|i, _| (moved(i, h) - moved(i, -h)).dot(&Vector2::from(f)) / (2.0 * h))
}

/// Computes the tip force J⁻ᵀ τ of joint torques, N.
pub fn force_at_tip(q: &[f32; 3], torque: Vector2<f64>) -> Vector2<f64> {
    let transposed = Matrix2::from_columns(&[torques(q, [1.0, 0.0]), torques(q, [0.0, 1.0])]);
    transposed.try_inverse().expect("not a singular pose") * torque
}

impl Rig {
    /// Computes the tip force of the five-bar's torques in the last step, N.
    pub fn tip_force(&self) -> Vector2<f64> {
        let torque = self.torques();
        force_at_tip(&self.control_loop.frame().at.q, Vector2::new(torque[0], torque[1]).map(f64::from))
    }
}
