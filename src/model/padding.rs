//! One entry for each joint that a device may have, behind those of the joints that it has zeros.

use crate::model::catalogue::MAX_JOINTS;

/// The entries of the first N joints, where they are.
#[inline(always)]
pub(crate) fn first<V, const N: usize>(values: &[V; MAX_JOINTS]) -> Option<&[V; N]> {
    values.first_chunk()
}

/// The entries of the first N joints.
#[inline(always)]
pub(crate) fn head<V: Copy, const N: usize>(values: &[V; MAX_JOINTS]) -> [V; N] {
    core::array::from_fn(|i| values[i.min(MAX_JOINTS - 1)])
}

/// The entries of N joints, and zeros.
#[inline(always)]
pub(crate) fn padded<V: Copy + Default, const N: usize>(values: &[V; N]) -> [V; MAX_JOINTS] {
    core::array::from_fn(|i| if i < N { values[i.min(N - 1)] } else { V::default() })
}
