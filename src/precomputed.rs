//! Mass matrices that are not computed in the step: frozen at a pose, or none but the exact one.

use crate::guard::Refusal;
use crate::math::Real;
use crate::mechanism::{Mechanism, Shaping};
use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
    /// What a unit tip motion along `n` takes and weighs. Shared by single walls and corners: a call costs less than a second
    /// copy of every mechanism in the board's flash.
    #[inline(never)]
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

/// A mass model as it is sent and stored.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub enum MassModelData {
    /// The mechanism's closed form.
    #[default]
    Exact,
    /// The lower triangle of one matrix, row by row, kg m².
    Frozen([f32; 6]),
}

impl MassModelData {
    /// Puts `values` of a table at `offset`. Refused for a model that has no table.
    pub fn receive(&mut self, _offset: usize, _values: &[f32]) -> Result<(), Refusal> {
        Err(Refusal::BadTable)
    }
}

impl<const N: usize> MassModel<f32, N> {
    /// The run-time form; `None` when the data do not fit N joints or are not a mass matrix.
    pub fn new(data: &MassModelData) -> Option<Self> {
        match data {
            MassModelData::Exact => Some(Self::Exact),
            MassModelData::Frozen(triangle) => {
                let mass = SMatrix::<f32, N, N>::from_fn(|i, j| {
                    let (row, column) = if i > j { (i, j) } else { (j, i) };
                    triangle.get(row * (row + 1) / 2 + column).copied().unwrap_or(f32::NAN)
                });
                let usable = (0..N).all(|i| mass[(i, i)] > 0.0) && mass.iter().all(|entry| entry.is_finite());
                usable.then_some(Self::Frozen(mass))
            }
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
