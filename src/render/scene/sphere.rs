//! A round wall: a ball to feel from outside, or a bowl to feel from inside. In the plane, a disc.

use super::{Contact, task_vector};
use crate::math::{Math, Real};
use nalgebra::SVector;

/// A ball, or (`inside`) all that is not the ball.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Sphere<T> {
    /// Centre, m.
    pub center: [T; 3],
    /// m
    pub radius: T,
    /// The tip moves inside; the solid is around it.
    pub inside: bool,
}

impl<T: Real> Sphere<T> {
    /// Distance to the surface and the radial normal.
    #[inline(always)]
    pub fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        round_contact::<T, K, N>(&self.arm(p), self.radius, self.inside)
    }

    /// ṅ at the tip velocity `velocity` (m/s).
    #[inline(always)]
    pub fn normal_rate<K: Math<T>, const N: usize>(
        &self,
        p: &SVector<T, N>,
        velocity: &SVector<T, N>,
    ) -> SVector<T, N> {
        round_normal_rate::<T, K, N>(&self.arm(p), velocity, self.inside)
    }

    /// Centre to tip; coordinates beyond the task do not count.
    #[inline(always)]
    fn arm<const N: usize>(&self, p: &SVector<T, N>) -> SVector<T, N> {
        p - task_vector::<T, N>(&self.center)
    }
}

/// The contact with a round wall whose centre (or axis) lies at `-arm` from the tip. At the very centre the normal is
/// zero: no direction is the right one, and no force is.
#[inline(always)]
pub(super) fn round_contact<T: Real, K: Math<T>, const N: usize>(
    arm: &SVector<T, N>,
    radius: T,
    inside: bool,
) -> Contact<T, N> {
    let length = K::sqrt(arm.dot(arm));
    let normal = arm * (T::one() / length.greater(T::EPSILON * T::EPSILON));
    if inside {
        Contact { distance: radius - length, normal: -normal }
    } else {
        Contact { distance: length - radius, normal }
    }
}

/// ṅ = (v - n(n·v))/ρ for a round wall, with the sign of its normal.
#[inline(always)]
pub(super) fn round_normal_rate<T: Real, K: Math<T>, const N: usize>(
    arm: &SVector<T, N>,
    velocity: &SVector<T, N>,
    inside: bool,
) -> SVector<T, N> {
    let inverse = T::one() / K::sqrt(arm.dot(arm)).greater(T::EPSILON * T::EPSILON);
    let n = arm * inverse;
    let rate = (velocity - n * n.dot(velocity)) * inverse;
    if inside { -rate } else { rate }
}
