//! The posture of a redundant device: held by a torque that accelerates the null motion alone.
//!
//! With e the joint motion of a unit turn φ̇ that moves no tip, the joint torques τ = M e f/(eᵀ M e) of a moment f (N m) make
//! q̈ = e f/(eᵀ M e): φ turns, and the tip is not accelerated, whatever f is (the dynamically consistent null space of
//! Khatib, A unified approach for motion and force control of robot manipulators, 1987). So walls feel as they do
//! without it.

use super::{Controller, fade};
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// The joint torques (N m) of the scene's posture at this task position (φ in its last entry) and these joint velocities
    /// (rad/s): f = k sin(φ₀ - φ) - d φ̇, whose spring no turn of φ makes larger than k, and nothing at a singularity.
    #[inline(never)]
    pub(super) fn posture_torque(&self, pose: &M::Pose, place: &SVector<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        let Some(held) = &self.posture else { return SVector::zeros() };
        let last = |of: &SVector<T, N>| of.iter().last().copied().unwrap_or_default();
        let rate = last(&self.mechanism.velocity(pose, qd));
        let (sine, _) = K::sin_cos(held.orientation - last(place));
        let moment = held.stiffness * sine - held.damping * rate;
        let null = self.null(pose);
        let share = fade(self.mechanism.regularity(pose).serial);
        if null.w_rr > T::zero() { null.me * (moment * share / null.w_rr) } else { SVector::zeros() }
    }
}
