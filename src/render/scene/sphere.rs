//! A round wall: a ball touched from outside, or a bowl touched from inside. In the plane, a disc.

use super::shape::{Meaning, Shape, ShapeSpec, Values, number};
use super::{Contact, task_vector};
use crate::math::{Math, Real};
use nalgebra::SVector;

/// A ball, or (`inside`) all space outside the ball.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Sphere<T> {
    /// Centre, m.
    pub center: [T; 3],
    /// Radius, m.
    pub radius: T,
    /// True if the tip moves inside and the solid is outside.
    pub inside: bool,
}

impl<T: Real> Shape<T> for Sphere<T> {
    const SPEC: ShapeSpec = ShapeSpec {
        name: "sphere",
        least_task: 1,
        keys: &[("point", Meaning::Point), ("radius", Meaning::Length), ("inside", Meaning::Flag)],
    };

    fn from_values([x, y, z, radius, inside, ..]: &Values<T>) -> Self {
        Self { center: [*x, *y, *z], radius: *radius, inside: *inside > T::zero() }
    }

    fn values(&self) -> Values<T> {
        let ([x, y, z], zero) = (self.center, T::zero());
        [x, y, z, self.radius, number(self.inside), zero, zero, zero]
    }

    /// Returns the distance to the surface and the radial normal.
    #[inline(always)]
    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        round_contact::<T, K, N>(&self.centre_to_tip(p), self.radius, self.inside)
    }

    #[inline(always)]
    fn normal_rate<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        round_normal_rate::<T, K, N>(&self.centre_to_tip(p), velocity, self.inside)
    }
}

impl<T: Real> Sphere<T> {
    /// Returns the contact and the surface's curvature (1/m): the normal's rotation per tip motion, negative inside.
    #[inline(always)]
    pub(super) fn contact_and_curvature<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> (Contact<T, N>, T) {
        contact_and_curvature::<T, K, N>(&self.centre_to_tip(p), self.radius, self.inside)
    }

    /// Returns the vector from the centre to the tip. Coordinates beyond the task have no effect.
    #[inline(always)]
    fn centre_to_tip<const N: usize>(&self, p: &SVector<T, N>) -> SVector<T, N> {
        p - task_vector::<T, N>(&self.center)
    }
}

/// Returns the contact with a round wall whose centre (or axis) is at `-arm` from the tip. Normal and force are zero at
/// the exact centre, because no direction is distinguished there.
#[inline(always)]
pub(super) fn round_contact<T: Real, K: Math<T>, const N: usize>(
    arm: &SVector<T, N>,
    radius: T,
    inside: bool,
) -> Contact<T, N> {
    contact_and_curvature::<T, K, N>(arm, radius, inside).0
}

/// Returns [`round_contact`] and the curvature (1/m). ṅ is the curvature times the velocity across n.
#[inline(always)]
fn contact_and_curvature<T: Real, K: Math<T>, const N: usize>(
    arm: &SVector<T, N>,
    radius: T,
    inside: bool,
) -> (Contact<T, N>, T) {
    let length = K::sqrt(arm.dot(arm));
    let curvature = T::one() / length.greater(T::EPSILON * T::EPSILON);
    let normal = arm * curvature;
    if inside {
        (Contact { distance: radius - length, normal: -normal }, -curvature)
    } else {
        (Contact { distance: length - radius, normal }, curvature)
    }
}

/// Returns ṅ = (v - n(n·v))/ρ for a round wall, with the sign of its normal.
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
