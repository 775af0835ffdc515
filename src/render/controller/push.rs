//! The host's addition to a scene: a force at the tip, and a plane that the board renders at the control rate.

use crate::math::Real;
use crate::render::scene::task_vector;
use nalgebra::SVector;

/// A force through Jᵀ, and a one-sided plane that acts like a wall without the feed-forward.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push<T> {
    /// Force at the tip, N.
    pub force: [T; 3],
    /// Plane that the board renders.
    pub plane: PushedPlane<T>,
}

/// A plane that pushes with stiffness (offset - n·p) - damping n·ṗ, never negative, where n·p is below the offset.
///
/// n may be shorter than 1, because a plane half way between two planes is their mean. Its distance from any point is
/// then the mean of the two distances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PushedPlane<T> {
    /// Normal n, out of the solid.
    pub normal: [T; 3],
    /// Offset of the plane along n, m.
    pub offset: T,
    /// Stiffness, N/m.
    pub stiffness: T,
    /// Damping, N s/m.
    pub damping: T,
}

impl<T: Real> Push<T> {
    /// Returns the force (N) at the tip position `place` (m) and velocity (m/s).
    #[inline(never)]
    pub fn force_at<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        task_vector::<T, N>(&self.force) + self.plane.force(place, velocity)
    }
}

impl<T: Real> PushedPlane<T> {
    /// Returns offset - n·p at the tip position `place` (m): positive where the plane pushes.
    #[inline(always)]
    pub(super) fn depth<const N: usize>(&self, place: &SVector<T, N>) -> T {
        self.offset - task_vector::<T, N>(&self.normal).dot(place)
    }

    /// Returns true if the plane cannot make a force.
    pub(super) fn is_absent(&self) -> bool {
        self.stiffness == T::zero() && self.damping == T::zero()
    }

    /// Returns the plane's force at the tip position `place` (m) and velocity (m/s), N.
    #[inline(never)]
    pub(super) fn force<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        task_vector::<T, N>(&self.normal) * self.normal_force(place, velocity)
    }

    /// Returns the plane's force along n, N.
    #[inline(always)]
    pub(super) fn normal_force<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> T {
        let depth = self.depth(place);
        if depth > T::zero() {
            let along = task_vector::<T, N>(&self.normal).dot(velocity);
            (self.stiffness * depth - self.damping * along).greater(T::zero())
        } else {
            T::zero()
        }
    }
}
