//! Rendered and admissible motion: what a wall meets, and the feed-forward that makes it meet more.
//!
//! Source: "Inertia Properties and Their Role in Haptic Rendering", equations (1) to (4), in the joint form of
//! docs/model.md section 2, which subtracts no nearly equal numbers and inverts no admissible-sized matrix:
//! with E = J⁻¹ Q (Q an orthonormal basis of the rendered directions) and b = c + g - M T⁻¹Ṫ q̇,
//! Wrr = Eᵀ M E, zr = Eᵀ b and **τ = M E Wrr⁻¹ (fr - Eᵀ b) + b**.
//!
//! [`shaped_torque`] is that line, the one the board runs for a wall ([`crate::model::principal`] for several); [`Split`]
//! and [`Inertia`] hold the paper's own quantities for the analysis.

use crate::math::{Math, Real};
use crate::model::admissible::Admissible;
use crate::model::mechanism::{Mechanism, Shaping};
use crate::model::principal::{Principal, Pull};
use crate::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Directions along which the walls' stiffness is less than this share of the largest do not count as rendered in an
/// [`Inertia`]: the square of the angle by which rounding in f32 parts two equal normals, and a hundred times more.
pub const NO_STIFFNESS: f64 = 1.0e-12;

/// An orthonormal basis of the task space whose first columns span the rendered directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Split<T: Real, const N: usize> {
    /// Columns: R rendered directions, then N - R admissible ones.
    pub basis: SMatrix<T, N, N>,
    /// R.
    pub rendered: usize,
}

impl<T: Real, const N: usize> Split<T, N> {
    /// The split for one wall with this unit normal (zeros beyond the task dimension `task`).
    ///
    /// It is completed in the plane by (-n_y, n_x), in space by the normalised part of e_k across n (k the smallest
    /// |n_k|) and its cross product; coordinates beyond the task are admissible as they stand.
    pub fn new<K: Math<T>>(normal: &SVector<T, N>, task: usize) -> Self {
        let normal = &(normal / K::sqrt(normal.dot(normal)));
        let mut basis = SMatrix::<T, N, N>::identity();
        basis.set_column(0, normal);
        if task == 2 && N >= 2 {
            basis[(0, 1)] = -normal[1];
            basis[(1, 1)] = normal[0];
        } else if task == 3 && N >= 3 {
            let smallest = (1..3).fold(0, |k, i| if normal[i].abs() < normal[k].abs() { i } else { k });
            let mut across = SVector::<T, N>::zeros();
            across[smallest] = T::one();
            across -= normal * normal[smallest];
            across /= K::sqrt(across.dot(&across));
            basis.set_column(1, &across);
            basis.set_column(2, &cross(normal, &across));
        }
        Self { basis, rendered: 1 }
    }

    /// The split for these walls: one wall's by its normal, several walls' by the directions of their stiffness.
    fn of<K: Math<T>>(walls: &[Pull<T, N>], task: usize) -> Self {
        match walls {
            [] => Self { basis: SMatrix::identity(), rendered: 0 },
            [only] => Self::new::<K>(&only.normal, task),
            several => {
                let principal = Principal::new::<K>(several, task);
                let least = principal.along(0) * T::from_f64(NO_STIFFNESS);
                let rendered = principal.stiffness.iter().filter(|along| **along > least).count();
                Self { basis: principal.basis, rendered }
            }
        }
    }
}

/// Cross product in the first three coordinates (zero where there are fewer).
fn cross<T: Real, const N: usize>(a: &SVector<T, N>, b: &SVector<T, N>) -> SVector<T, N> {
    let mut product = SVector::<T, N>::zeros();
    if N >= 3 {
        product[0] = a[1] * b[2] - a[2] * b[1];
        product[1] = a[2] * b[0] - a[0] * b[2];
        product[2] = a[0] * b[1] - a[1] * b[0];
    }
    product
}

/// The joint torques (N m) that render the task force `force` (N) with the paper's feed-forward in one direction:
/// τ = M E Wrr⁻¹ (n·f - Eᵀ b) + b.
#[inline(always)]
pub fn shaped_torque<T: Real, const N: usize>(shaping: &Shaping<T, N>, force: T, b: &SVector<T, N>) -> SVector<T, N> {
    shaped_torque_beside(shaping, force, b, b)
}

/// As [`shaped_torque`], with the rendered part of `met` alone left for the wall to meet: `b` itself by the paper's (4),
/// zero where the wall's force is rendered whatever moves: τ = M E Wrr⁻¹ (n·f - Eᵀ met) + b.
#[inline(always)]
pub fn shaped_torque_beside<T: Real, const N: usize>(
    shaping: &Shaping<T, N>,
    force: T,
    b: &SVector<T, N>,
    met: &SVector<T, N>,
) -> SVector<T, N> {
    shaping.me * ((force - shaping.e.dot(met)) / shaping.w_rr) + b
}

/// How the task frame turns under curved walls: κ (m/s²) such that T⁻¹Ṫ q̇ = J⁻¹(J̇ q̇ + κ), for one rendered
/// direction `n` with rate `n_rate` and the tip moving at `velocity`: κ = n(ṅ·ṗ) - ṅ(n·ṗ). The admissible directions
/// do not spin about n. With several directions in space, pass the one admissible direction and its rate instead.
pub fn frame_rate<T: Real, const N: usize>(
    n: &SVector<T, N>,
    n_rate: &SVector<T, N>,
    velocity: &SVector<T, N>,
) -> SVector<T, N> {
    n * n_rate.dot(velocity) - n_rate * n.dot(velocity)
}

/// The paper's quantities at one configuration, in the basis of a [`Split`].
#[derive(Clone, Copy, Debug)]
pub struct Inertia<T: Real, const N: usize> {
    /// Which directions are rendered.
    pub split: Split<T, N>,
    /// W = T⁻ᵀ M T⁻¹ (1a): rendered block first, kg.
    pub w: SMatrix<T, N, N>,
    /// z = T⁻ᵀ(c + g) - W Ṫ q̇ (1b), rendered entries first, N.
    pub z: SVector<T, N>,
    /// Weff = (Jr M⁻¹ Jrᵀ)⁻¹ in the leading R x R block, kg.
    pub w_eff: SMatrix<T, N, N>,
    /// The joint torques of (4) with z for the given force, N m.
    pub torque: SVector<T, N>,
    /// Jrᵀ fr: what the joints do without the feed-forward, N m.
    pub torque_without_feed_forward: SVector<T, N>,
    /// fa of (4) in its first N - R entries, N.
    pub f_a: SVector<T, N>,
}

impl<T: Real, const N: usize> Inertia<T, N> {
    /// Everything equation (4) says of a mechanism in `pose` at joint velocities `qd` (rad/s), against plane walls
    /// whose forces add up to `force` (N, a task vector).
    pub fn new<K: Math<T>, M: Mechanism<T, N>>(
        mechanism: &M,
        pose: &M::Pose,
        qd: &SVector<T, N>,
        walls: &[Pull<T, N>],
        force: &SVector<T, N>,
    ) -> Self {
        Self::holding::<K, M>(mechanism, pose, qd, walls, force, Admissible::Orientation)
    }

    /// As [`Inertia::new`], a redundant device holding `admissible` instead of φ. The basis then holds the null motion
    /// that goes with each tip direction.
    pub fn holding<K: Math<T>, M: Mechanism<T, N>>(
        mechanism: &M,
        pose: &M::Pose,
        qd: &SVector<T, N>,
        walls: &[Pull<T, N>],
        force: &SVector<T, N>,
        admissible: Admissible,
    ) -> Self {
        let split = Split::of::<K>(walls, M::SPEC.task);
        let rank = split.rendered;
        let tip = split.basis;
        let mut b = mechanism.velocity_torque(pose, qd);
        let mut split = split;
        if M::SPEC.task < N && admissible != Admissible::Orientation {
            let null = mechanism.shaping(pose, &tip.column(N - 1).into_owned());
            let bent = mechanism.inverse(pose, &(mechanism.jacobian_rate(pose, qd) * qd));
            b = admissible.hold_bias(&b, &bent, &null);
            for i in 0..M::SPEC.task {
                let along = mechanism.shaping(pose, &tip.column(i).into_owned());
                split.basis[(N - 1, i)] = admissible.added(&along, &null);
            }
            if let Some(moves) = admissible.joint().and_then(|joint| null.e.get(joint)) {
                split.basis[(N - 1, N - 1)] = T::one() / *moves;
            }
        }
        let b = b + mechanism.gravity(pose);
        let mut shapings = [Shaping { e: SVector::zeros(), me: SVector::zeros(), w_rr: T::zero() }; N];
        for (i, shaping) in shapings.iter_mut().enumerate() {
            *shaping = mechanism.shaping(pose, &split.basis.column(i).into_owned());
        }
        let w = in_basis(&mechanism.operational_inertia(pose), &split.basis);
        let z = SVector::from_fn(|i, _| shapings[i].e.dot(&b));

        let in_span = tip.tr_mul(force);
        let torque = match walls {
            [] => b,
            [_] => shaped_torque(&shapings[0], in_span[0], &b),
            several => {
                let principal = Principal::new::<K>(several, M::SPEC.task);
                let (shaped, plain) = principal.shaped(&shapings, force, T::one(), |_| Some((b, b)));
                shaped + mechanism.transpose(pose, &plain)
            }
        };
        let f_a = SVector::from_fn(|i, _| shapings.get(i + rank).map_or(T::zero(), |shaping| shaping.e.dot(&torque)));
        let (w_eff, without) = coupled(mechanism, pose, &tip, rank, &in_span);
        Self { split, w, z, w_eff, torque, torque_without_feed_forward: without, f_a }
    }
}

/// Bᵀ Λ B for a symmetric Λ.
#[inline(always)]
fn in_basis<T: Real, const N: usize>(inertia: &SMatrix<T, N, N>, basis: &SMatrix<T, N, N>) -> SMatrix<T, N, N> {
    let mut w = SMatrix::<T, N, N>::zeros();
    for j in 0..N {
        let moved: SVector<T, N> = inertia * basis.column(j);
        for i in 0..=j {
            let entry = basis.column(i).dot(&moved);
            w[(i, j)] = entry;
            w[(j, i)] = entry;
        }
    }
    w
}

/// What the device does without the feed-forward along the first `rank` columns of `tip`: Weff (kg) in its leading
/// block, and Jrᵀ fr (N m) of the force `in_span` (N) along them.
#[inline(always)]
fn coupled<T: Real, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    pose: &M::Pose,
    tip: &SMatrix<T, N, N>,
    rank: usize,
    in_span: &SVector<T, N>,
) -> (SMatrix<T, N, N>, SVector<T, N>) {
    let mut w_eff = SMatrix::<T, N, N>::zeros();
    let mut torque = SVector::<T, N>::zeros();
    if rank == 0 {
        return (w_eff, torque);
    }
    let mass = mechanism.mass(pose);
    let mut rows = [SVector::<T, N>::zeros(); N];
    for i in 0..rank {
        rows[i] = mechanism.transpose(pose, &tip.column(i).into_owned());
        torque += rows[i] * in_span[i];
    }
    let mut mobility = SMatrix::<T, N, N>::identity();
    for j in 0..rank {
        let accelerations = solve_symmetric(&mass, &rows[j]);
        for i in 0..rank {
            mobility[(i, j)] = rows[i].dot(&accelerations);
        }
    }
    if rank == 1 {
        w_eff[(0, 0)] = T::one() / mobility[(0, 0)];
        return (w_eff, torque);
    }
    for j in 0..rank {
        let mut unit = SVector::<T, N>::zeros();
        unit[j] = T::one();
        let column = solve_symmetric(&mobility, &unit);
        for i in 0..rank {
            w_eff[(i, j)] = column[i];
        }
    }
    (w_eff, torque)
}
