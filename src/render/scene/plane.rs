//! A flat wall.

use super::shape::{Meaning, Shape, ShapeSpec, Values};
use super::{Contact, task_vector};
use crate::math::{Math, Real};
use nalgebra::SVector;

/// The half-space behind a plane.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Plane<T> {
    /// A point of the plane, m.
    pub point: [T; 3],
    /// Unit normal out of the solid.
    pub normal: [T; 3],
}

impl<T: Real> Shape<T> for Plane<T> {
    const SPEC: ShapeSpec =
        ShapeSpec { name: "plane", least_task: 1, keys: &[("point", Meaning::Point), ("normal", Meaning::Direction)] };
    const CURVED: bool = false;

    fn from_values([a, b, c, x, y, z, ..]: &Values<T>) -> Self {
        Self { point: [*a, *b, *c], normal: [*x, *y, *z] }
    }

    fn values(&self) -> Values<T> {
        let ([a, b, c], [x, y, z]) = (self.point, self.normal);
        [a, b, c, x, y, z, T::zero(), T::zero()]
    }

    /// Returns x = n·(p - p₀) and the normal, which is constant.
    #[inline(always)]
    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        let normal: SVector<T, N> = task_vector(&self.normal);
        Contact { distance: normal.dot(&(p - task_vector::<T, N>(&self.point))), normal }
    }

    #[inline(always)]
    fn normal_rate<K: Math<T>, const N: usize>(&self, _: &SVector<T, N>, _: &SVector<T, N>) -> SVector<T, N> {
        SVector::zeros()
    }
}
