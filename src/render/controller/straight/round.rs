//! The step for a single round wall whose velocity terms follow its normal, on a device with two joints.

use super::super::Controller;
use super::Start;
use crate::math::{Math, Real};
use crate::model::mechanism::{Mechanism, ShapedTorque};
use crate::render::step_result::StepResult;
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Implements [`Controller::render`] for one ball with the feed-forward and `VelocityTerms::Rendered`, in the
    /// plane. Adds the rotation of the normal to [`Controller::render_wall`].
    #[inline(never)]
    pub(in super::super) fn render_round(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        self.render_single::<true>(counts, result);
    }

    /// Computes equation (4) for `force` (N) of the only wall, whose normal is `normal`, with this curvature (1/m).
    #[inline(always)]
    pub(super) fn shaped_torque_of_round_wall(
        &self,
        start: &Start<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        curvature: T,
    ) -> ShapedTorque<T, N> {
        let Some(certain) = self.certain_velocities(start) else {
            return self.shaped_torque_with_partial_terms(start, normal, force, Some(0));
        };
        let turning = normal_turn_acceleration(normal, &self.mechanism.velocity(&start.pose, &certain), curvature);
        self.mechanism.shaped_torque_of_turning_wall(&start.pose, normal, force, &certain, &turning)
    }
}

/// Returns -κ of [`frame_rate`](crate::model::inertia::frame_rate) in the plane, m/s². κ = c (t·v)(n (t·v) - t (n·v))
/// with normal n, tangent t, curvature c and ṅ = c (t·v) t. The bracket is v rotated right by 90°.
#[inline(always)]
fn normal_turn_acceleration<T: Real, const N: usize>(
    normal: &SVector<T, N>,
    velocity: &SVector<T, N>,
    curvature: T,
) -> SVector<T, N> {
    let (n, v) = (normal, velocity);
    let rate = curvature * (n[0] * v[1] - n[1] * v[0]);
    let mut turning = SVector::zeros();
    (turning[0], turning[1]) = (-v[1] * rate, v[0] * rate);
    turning
}
