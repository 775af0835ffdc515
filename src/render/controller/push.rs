//! The host's addition to a scene in one step: a force at the tip, and a plane that is rendered here, at the loop's
//! rate.

use crate::math::Real;
use crate::render::scene::task_vector;
use nalgebra::SVector;

/// A force, through Jᵀ alone, and a one-sided plane, which acts as a wall without the feed-forward does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push<T> {
    /// Force at the tip, N.
    pub force: [T; 3],
    /// The plane.
    pub plane: PushedPlane<T>,
}

/// A plane n·p = offset that pushes along n where n·p is less: f = stiffness (offset - n·p) - damping n·ṗ, never pulling.
///
/// n may be shorter than 1: a plane half way between two others is their mean, and so is its distance from any point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PushedPlane<T> {
    /// n, out of the solid.
    pub normal: [T; 3],
    /// m
    pub offset: T,
    /// N/m
    pub stiffness: T,
    /// N s/m
    pub damping: T,
}

impl<T: Real> Push<T> {
    /// The force (N) at the tip position `place` (m) and velocity (m/s).
    #[inline(never)]
    pub fn at<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        task_vector::<T, N>(&self.force) + self.plane.pushes(place, velocity)
    }
}

impl<T: Real> PushedPlane<T> {
    /// offset - n·p at the tip position `place` (m): positive where it pushes.
    #[inline(always)]
    pub(super) fn depth<const N: usize>(&self, place: &SVector<T, N>) -> T {
        self.offset - task_vector::<T, N>(&self.normal).dot(place)
    }

    /// Returns true if it can make no force.
    pub(super) fn is_absent(&self) -> bool {
        self.stiffness == T::zero() && self.damping == T::zero()
    }

    /// Its force at the tip position `place` (m) and velocity (m/s), N.
    #[inline(never)]
    pub(super) fn pushes<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        task_vector::<T, N>(&self.normal) * self.force(place, velocity)
    }

    /// Its force along n, N.
    #[inline(always)]
    pub(super) fn force<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> T {
        let depth = self.depth(place);
        if depth > T::zero() {
            let along = task_vector::<T, N>(&self.normal).dot(velocity);
            (self.stiffness * depth - self.damping * along).greater(T::zero())
        } else {
            T::zero()
        }
    }
}
