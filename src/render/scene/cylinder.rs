//! A round wall along an axis: a rod touched from outside, or a pipe touched from inside.

use super::shape::{Meaning, Shape, ShapeSpec, Values, number};
use super::sphere::{round_contact, round_normal_rate};
use super::{Contact, task_vector};
use crate::math::{Math, Real};
use nalgebra::SVector;

/// An infinitely long cylinder, or (`inside`) all space outside the cylinder.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Cylinder<T> {
    /// A point of the axis, m.
    pub point: [T; 3],
    /// Unit direction of the axis.
    pub axis: [T; 3],
    /// Radius, m.
    pub radius: T,
    /// True if the tip moves inside and the solid is outside.
    pub inside: bool,
}

impl<T: Real> Shape<T> for Cylinder<T> {
    const SPEC: ShapeSpec = ShapeSpec {
        name: "cylinder",
        least_task: 3,
        keys: &[
            ("point", Meaning::Point),
            ("axis", Meaning::Direction),
            ("radius", Meaning::Length),
            ("inside", Meaning::Flag),
        ],
    };

    fn from_values([a, b, c, x, y, z, radius, inside]: &Values<T>) -> Self {
        Self { point: [*a, *b, *c], axis: [*x, *y, *z], radius: *radius, inside: *inside > T::zero() }
    }

    fn values(&self) -> Values<T> {
        let ([a, b, c], [x, y, z]) = (self.point, self.axis);
        [a, b, c, x, y, z, self.radius, number(self.inside)]
    }

    /// Returns the distance to the surface and the normal across the axis.
    #[inline(always)]
    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        round_contact::<T, K, N>(&self.radial_part(&(p - task_vector::<T, N>(&self.point))), self.radius, self.inside)
    }

    #[inline(always)]
    fn normal_rate<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        let arm = self.radial_part(&(p - task_vector::<T, N>(&self.point)));
        round_normal_rate::<T, K, N>(&arm, &self.radial_part(velocity), self.inside)
    }
}

impl<T: Real> Cylinder<T> {
    /// Returns the part of `v` perpendicular to the axis.
    #[inline(always)]
    fn radial_part<const N: usize>(&self, v: &SVector<T, N>) -> SVector<T, N> {
        let axis = task_vector::<T, N>(&self.axis);
        v - axis * axis.dot(v)
    }
}
