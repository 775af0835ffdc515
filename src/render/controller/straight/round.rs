//! The step of a scene with a single round wall whose velocity terms follow its normal, on a device with two joints.

use super::super::Controller;
use super::Start;
use crate::math::{Math, Real};
use crate::model::mechanism::{Mechanism, Shaped};
use crate::render::step_result::StepResult;
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Implements [`Controller::render`] for one ball with the feed-forward and [`VelocityTerms::Rendered`], in the
    /// plane: like [`Controller::render_wall`], plus the rotation of the normal.
    ///
    /// [`VelocityTerms::Rendered`]: crate::render::scene::VelocityTerms::Rendered
    #[inline(never)]
    pub(in super::super) fn render_round(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        self.render_single::<true>(counts, result);
    }

    /// Computes equation (4) for the force `force` (N) of the only wall, with this curvature (1/m).
    #[inline(always)]
    pub(super) fn shaped_round(
        &self,
        start: &Start<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        curvature: T,
    ) -> Shaped<T, N> {
        let Some(certain) = self.certain_velocities(start) else {
            return self.shaped_rarely(start, normal, force, Some(0));
        };
        let turning = turning(normal, &self.mechanism.velocity(&start.pose, &certain), curvature);
        self.mechanism.shaped_turning(&start.pose, normal, force, &certain, &turning)
    }
}

/// Returns -κ of [`frame_rate`](crate::model::inertia::frame_rate) in the plane, m/s²: with the normal n, the line t
/// across it and ṅ = c (t·v) t, κ = c (t·v)(n (t·v) - t (n·v)); the bracket is v rotated right by 90°.
#[inline(always)]
fn turning<T: Real, const N: usize>(normal: &SVector<T, N>, velocity: &SVector<T, N>, curvature: T) -> SVector<T, N> {
    let (n, v) = (normal, velocity);
    let rate = curvature * (n[0] * v[1] - n[1] * v[0]);
    let mut turning = SVector::zeros();
    (turning[0], turning[1]) = (-v[1] * rate, v[0] * rate);
    turning
}
