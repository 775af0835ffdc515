//! Stiffness in the plane, from which the stiffest direction is found.

use crate::math::Real;

/// A stiffness matrix Σ k n nᵀ in the plane, N/m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stiffness<T> {
    pub xx: T,
    pub xy: T,
    pub yy: T,
}

impl<T: Real> Stiffness<T> {
    /// Returns a stiffness of zero.
    pub fn none() -> Self {
        Self { xx: T::zero(), xy: T::zero(), yy: T::zero() }
    }

    /// Adds a stiffness along a normal.
    #[inline(always)]
    pub fn add(&mut self, x: T, y: T, k: T) {
        let (kx, ky) = (k * x, k * y);
        self.xx += kx * x;
        self.xy += kx * y;
        self.yy += ky * y;
    }

    /// Adds a stiffness across a line of direction d, k (1 - d dᵀ)², or in every direction if d is zero, as in
    /// [`Pull`](crate::model::principal::Pull).
    pub fn add_across(&mut self, x: T, y: T, k: T) {
        let kd = k * (x * x + y * y - T::one() - T::one());
        self.xx += k + kd * x * x;
        self.xy += kd * x * y;
        self.yy += k + kd * y * y;
    }

    /// Returns nᵀ K n.
    #[inline(always)]
    pub fn along(&self, x: T, y: T) -> T {
        (self.xx * x + self.xy * y) * x + (self.xy * x + self.yy * y) * y
    }
}
