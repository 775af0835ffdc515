//! Mass matrices that are not computed in the step: frozen at a pose, or none but the exact one.

use crate::math::Real;
use crate::mechanism::{Mechanism, Shaping};
use nalgebra::{SMatrix, SVector};

/// Where the step takes the mass matrix from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum MassModel<T: Real, const N: usize> {
    /// The mechanism's closed form, at every step.
    #[default]
    Exact,
    /// One matrix for the whole workspace, kg m².
    Frozen(SMatrix<T, N, N>),
}

impl<T: Real, const N: usize> MassModel<T, N> {
    /// What a unit tip motion along `n` takes and weighs.
    #[inline(always)]
    pub fn shaping<M: Mechanism<T, N>>(
        &self,
        mechanism: &M,
        _q: &SVector<T, N>,
        pose: &M::Pose,
        n: &SVector<T, N>,
    ) -> Shaping<T, N> {
        match self {
            Self::Exact => mechanism.shaping(pose, n),
            Self::Frozen(mass) => with_mass(mechanism, pose, n, mass),
        }
    }
}

#[inline(always)]
fn with_mass<T: Real, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    pose: &M::Pose,
    n: &SVector<T, N>,
    mass: &SMatrix<T, N, N>,
) -> Shaping<T, N> {
    let e = mechanism.inverse(pose, n);
    let me = mass * e;
    Shaping { e, me, w_rr: e.dot(&me) }
}
