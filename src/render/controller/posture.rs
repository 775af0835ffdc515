//! The posture of a redundant device: a torsional spring between the ground and its last link.
//!
//! Its torques are Jφᵀ f, those of a potential of φ and of a damper on φ̇: they take up energy whatever the device
//! does, and in rest they leave no force at the tip. Torques that do not accelerate the tip either, M e f/(eᵀ M e)
//! along the null motion e, do not dissipate: with uneven damping of the joints they drive a tip that is not held
//! (docs/model.md section 2).

use super::Controller;
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// The joint torques (N m) of the scene's posture in this pose and at these joint velocities (rad/s): f = k sin(φ₀ - φ) - d φ̇, whose spring no turn of φ makes larger than k.
    #[inline(never)]
    pub(super) fn posture_torque(&self, pose: &M::Pose, qd: &SVector<T, N>) -> SVector<T, N> {
        let Some(held) = &self.posture else { return SVector::zeros() };
        let last = |of: &SVector<T, N>| of.iter().last().copied().unwrap_or_default();
        let (sine, _) = K::sin_cos(held.orientation - last(&self.mechanism.tip(pose)));
        let moment = held.stiffness * sine - held.damping * last(&self.mechanism.velocity(pose, qd));
        let turning = SVector::<T, N>::from_fn(|i, _| if i + 1 == N { moment } else { T::zero() });
        self.mechanism.transpose(pose, &turning)
    }
}
