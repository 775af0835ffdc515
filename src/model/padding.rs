//! Arrays with one entry for each possible joint. Entries beyond the device's joints are zero.

use crate::model::catalogue::MAX_JOINTS;

/// Borrows the entries of the first N joints; `None` if the array has fewer.
#[inline(always)]
pub(crate) fn as_joints<V, const N: usize>(values: &[V; MAX_JOINTS]) -> Option<&[V; N]> {
    values.first_chunk()
}

/// Returns the entries of the first N joints.
#[inline(always)]
pub(crate) fn to_joints<V: Copy, const N: usize>(values: &[V; MAX_JOINTS]) -> [V; N] {
    core::array::from_fn(|i| values[i.min(MAX_JOINTS - 1)])
}

/// Returns the entries of N joints, followed by zeros.
#[inline(always)]
pub(crate) fn pad<V: Copy + Default, const N: usize>(values: &[V; N]) -> [V; MAX_JOINTS] {
    core::array::from_fn(|i| if i < N { values[i.min(N - 1)] } else { V::default() })
}
