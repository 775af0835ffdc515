//! The quantities of a five-bar at one pose.

use crate::math::Real;
use nalgebra::Vector2;

/// Quantities that depend on the two joint angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real> {
    /// Tip position, m.
    pub tip: Vector2<T>,
    /// Elbows relative to their motors, m. Rotated left by 90° they are the elbow velocities per joint rate.
    pub(in super::super) arm: [Vector2<T>; 2],
    /// Tip relative to the elbows, m.
    pub(super) rod: [Vector2<T>; 2],
    /// kᵢ = uᵢ·cᵢ, m².
    pub(super) k: [T; 2],
    /// 1/kᵢ, clamped.
    pub(super) inverse_k: [T; 2],
    /// 1/(u₁ x u₂), clamped.
    pub(super) inverse_det: T,
    /// |sin| of the angle between the rods; 0 if they are in line or cannot reach each other.
    pub(super) parallel: T,
}

/// A unit motion of the tip along a direction, and its inertia.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct UnitMotion<T: Real> {
    /// E, rad/m.
    pub e: Vector2<T>,
    /// Part of M E that acts at the joints directly, Iᵢ eᵢ + βᵢ cᵢ·n, kg m. The rest of M E acts through the tip.
    pub momentum: Vector2<T>,
    /// The arms' part of the mass at the tip, kg, computed in task space without J: Λ = Γ 1 + Σ Aᵢ aᵢaᵢᵀ + βᵢ(aᵢcᵢᵀ +
    /// cᵢaᵢᵀ) with aᵢ = uᵢ/kᵢ.
    pub arms: T,
}

/// Returns `v` rotated left by 90°.
#[inline(always)]
pub(super) fn rotated_left<T: Real>(v: &Vector2<T>) -> Vector2<T> {
    Vector2::new(-v[1], v[0])
}
