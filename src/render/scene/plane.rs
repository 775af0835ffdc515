//! A flat wall.

use super::{Contact, task_vector};
use crate::math::Real;
use nalgebra::SVector;

/// The half-space behind a plane.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Plane<T> {
    /// A point of the plane, m.
    pub point: [T; 3],
    /// Unit normal out of the solid.
    pub normal: [T; 3],
}

impl<T: Real> Plane<T> {
    /// x = n·(p - p₀), the normal everywhere the same.
    #[inline(always)]
    pub fn contact<const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        let normal: SVector<T, N> = task_vector(&self.normal);
        Contact { distance: normal.dot(&(p - task_vector::<T, N>(&self.point))), normal }
    }
}
