//! The posture of a redundant device: a torsional spring between the ground and its last link.
//!
//! Its torques are Jφᵀ f, the torques of a potential of φ and of a damper on φ̇: they absorb energy in every motion of
//! the device, and at rest they make no force at the tip. The torques M e f/(eᵀ M e) along the null motion e do not
//! accelerate the tip, but they do not dissipate: with uneven damping of the joints they drive a free tip
//! (docs/model.md section 2).

use super::Controller;
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Returns the joint torques (N m) of the scene's posture in this pose and at these joint velocities (rad/s):
    /// f = k sin(φ₀ - φ) - d φ̇. The spring's moment is at most k for any rotation of φ.
    #[inline(never)]
    pub(super) fn posture_torque(&self, pose: &M::Pose, qd: &SVector<T, N>) -> SVector<T, N> {
        let Some(posture) = &self.posture else { return SVector::zeros() };
        let last = |of: &SVector<T, N>| of.iter().last().copied().unwrap_or_default();
        let (sine, _) = K::sin_cos(posture.orientation - last(&self.mechanism.tip(pose)));
        let moment = posture.stiffness * sine - posture.damping * last(&self.mechanism.velocity(pose, qd));
        let turning = SVector::<T, N>::from_fn(|i, _| if i + 1 == N { moment } else { T::zero() });
        self.mechanism.transpose(pose, &turning)
    }
}
