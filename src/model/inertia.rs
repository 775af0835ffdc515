//! Rendered and admissible motion: what a wall meets, and the feed-forward that makes it meet more.
//!
//! Source: "Inertia Properties and Their Role in Haptic Rendering", equations (1) to (4), in the joint form of
//! docs/model.md section 2, which subtracts no nearly equal numbers and inverts no admissible-sized matrix:
//! with E = J⁻¹ Q (Q an orthonormal basis of the rendered directions) and b = c + g - M T⁻¹Ṫ q̇,
//! Wrr = Eᵀ M E, zr = Eᵀ b and **τ = M E Wrr⁻¹ (fr - Eᵀ b) + b**.
//!
//! [`Shaping::torque`] is that line for a wall ([`crate::model::principal`] for several); [`Split`]
//! and [`Inertia`] hold the paper's own quantities for the analysis.

use crate::math::{Math, Real};
use crate::model::admissible::Admissible;
use crate::model::mechanism::{Mechanism, Shaping, WallTerms, in_basis};
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
    #[inline(always)]
    pub fn new<K: Math<T>>(normal: &SVector<T, N>, task: usize) -> Self {
        let n = normal;
        let mut basis = SMatrix::<T, N, N>::identity();
        basis.set_column(0, n);
        if task == 2 && N >= 2 {
            basis[(0, 1)] = -n[1];
            basis[(1, 1)] = n[0];
        } else if task == 3 && N >= 3 {
            // e_k less its part along n, over its length s = √(n_i² + n_j²), and n x that; i and j follow k around.
            let mut complete = |k: usize, i: usize, j: usize| {
                let s = K::sqrt(n[i] * n[i] + n[j] * n[j]);
                let inverse = T::one() / s;
                let (n_i, n_j) = (n[i] * inverse, n[j] * inverse);
                (basis[(k, 1)], basis[(i, 1)], basis[(j, 1)]) = (s, -n[k] * n_i, -n[k] * n_j);
                (basis[(k, 2)], basis[(i, 2)], basis[(j, 2)]) = (T::zero(), n_j, -n_i);
            };
            let [x, y, z] = [n[0].abs(), n[1].abs(), n[2].abs()];
            if x <= y && x <= z {
                complete(0, 1, 2);
            } else if y <= z {
                complete(1, 2, 0);
            } else {
                complete(2, 0, 1);
            }
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

/// The turning of the task frame under curved walls: κ (m/s²) such that T⁻¹Ṫ q̇ = J⁻¹(J̇ q̇ + κ), for one rendered
/// direction `n` with rate `n_rate` and the tip moving at `velocity`: κ = n(ṅ·ṗ) - ṅ(n·ṗ). The admissible directions do
/// not spin about n. With several directions in space, pass the one admissible direction and its rate instead.
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
    #[inline(always)]
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
    #[inline(always)]
    pub fn holding<K: Math<T>, M: Mechanism<T, N>>(
        mechanism: &M,
        pose: &M::Pose,
        qd: &SVector<T, N>,
        walls: &[Pull<T, N>],
        force: &SVector<T, N>,
        admissible: Admissible,
    ) -> Self {
        match walls {
            [only] if M::SPEC.task == N || admissible == Admissible::Orientation => {
                Self::of_one::<K, M>(mechanism, pose, qd, only, force)
            }
            _ => Self::in_general::<K, M>(mechanism, pose, qd, walls, force, admissible),
        }
    }

    /// Of one wall, a redundant device holding φ: the usual case, from terms that the mechanisms have in closed form.
    #[inline(always)]
    fn of_one<K: Math<T>, M: Mechanism<T, N>>(
        mechanism: &M,
        pose: &M::Pose,
        qd: &SVector<T, N>,
        wall: &Pull<T, N>,
        force: &SVector<T, N>,
    ) -> Self {
        let split = Split::new::<K>(&wall.normal, M::SPEC.task);
        let WallTerms { e, me, w, b, row, w_eff } = mechanism.wall_terms(pose, &split.basis, qd);
        let along = split.basis.column(0).dot(force);
        let z = e.tr_mul(&b);
        let torque = me * ((along - z[0]) * (T::one() / w[(0, 0)])) + b;
        let f_a = SVector::from_fn(|i, _| if i + 1 < N { e.column(i + 1).dot(&torque) } else { T::zero() });
        Self {
            split,
            w,
            z,
            w_eff: SMatrix::from_fn(|i, j| if i == 0 && j == 0 { w_eff } else { T::zero() }),
            torque,
            torque_without_feed_forward: row * along,
            f_a,
        }
    }

    /// Of any walls, a redundant device holding anything.
    #[inline(never)]
    fn in_general<K: Math<T>, M: Mechanism<T, N>>(
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
            [_] => shapings[0].torque(in_span[0], &b, &b),
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

/// The device without the feed-forward along the first `rank` columns of `tip`: Weff (kg) in its leading block, and Jrᵀ
/// fr (N m) of the force `in_span` (N) along them.
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
