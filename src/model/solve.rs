//! Linear equations of the size of a device's joints.

use crate::math::Real;
use nalgebra::{SMatrix, SVector};

/// Returns true if a symmetric A (N x N) is positive definite: its LDLᵀ pivots are positive beyond rounding.
#[inline(never)]
pub fn is_positive_definite<T: Real, const N: usize>(a: &SMatrix<T, N, N>) -> bool {
    let mut left = *a;
    (0..N).all(|j| {
        let pivot = left[(j, j)];
        // Written so that NaN is not `positive`.
        let positive = pivot > T::EPSILON * a[(j, j)].abs();
        if positive {
            for i in j + 1..N {
                let part = left[(i, j)] / pivot;
                for k in j + 1..N {
                    let change = part * left[(j, k)];
                    left[(i, k)] -= change;
                }
            }
        }
        positive
    })
}

/// Returns x with A x = y for a symmetric positive definite A (N x N), by LDLᵀ without a square root. The smallest
/// usable positive number replaces a pivot that is not positive, so the result is finite for any finite input.
pub fn solve_symmetric<T: Real, const N: usize>(a: &SMatrix<T, N, N>, y: &SVector<T, N>) -> SVector<T, N> {
    let mut l = SMatrix::<T, N, N>::identity();
    let mut d = SVector::<T, N>::zeros();
    let mut x = *y;
    for j in 0..N {
        let mut pivot = a[(j, j)];
        for k in 0..j {
            pivot -= l[(j, k)] * l[(j, k)] * d[k];
        }
        d[j] = clamped_pivot(pivot, a[(j, j)]);
        for i in j + 1..N {
            let mut entry = a[(i, j)];
            for k in 0..j {
                entry -= l[(i, k)] * l[(j, k)] * d[k];
            }
            l[(i, j)] = entry / d[j];
        }
        for k in 0..j {
            let step = l[(j, k)] * x[k];
            x[j] -= step;
        }
    }
    for j in 0..N {
        x[j] /= d[j];
    }
    for j in (0..N).rev() {
        for k in j + 1..N {
            let step = l[(k, j)] * x[k];
            x[j] -= step;
        }
    }
    x
}

/// Returns yᵀ A⁻¹ y for a symmetric positive definite A (N x N), N > 0, as a numerator and a positive denominator. Runs
/// the forward half of [`solve_symmetric`] without its last division.
#[inline(always)]
pub fn quotient<T: Real, const N: usize>(a: &SMatrix<T, N, N>, y: &SVector<T, N>) -> (T, T) {
    let (mut left, mut x) = (*a, *y);
    let (mut above, mut below) = (T::zero(), T::one());
    for j in 0..N {
        let pivot = clamped_pivot(left[(j, j)], a[(j, j)]);
        if j + 1 == N {
            (above, below) = (above * pivot + x[j] * x[j], pivot);
            break;
        }
        let inverse = T::one() / pivot;
        above += x[j] * x[j] * inverse;
        for i in j + 1..N {
            let part = left[(i, j)] * inverse;
            for k in j + 1..=i {
                let change = part * left[(k, j)];
                left[(i, k)] -= change;
            }
            let change = part * x[j];
            x[i] -= change;
        }
    }
    (above, below)
}

/// Returns `pivot`, or the smallest usable positive number if `pivot` is only rounding of the diagonal entry `of`.
#[inline(always)]
fn clamped_pivot<T: Real>(pivot: T, of: T) -> T {
    pivot.greater(T::EPSILON * T::EPSILON * T::EPSILON * of.abs().greater(T::EPSILON))
}
