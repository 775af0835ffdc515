//! Rendered and admissible motion: the inertia that a wall meets, and the feed-forward that increases it.
//!
//! Source: "Inertia Properties and Their Role in Haptic Rendering", equations (1) to (4), in the joint form of
//! docs/model.md section 2, which subtracts no nearly equal numbers and inverts no matrix of admissible size. With E =
//! J⁻¹ Q (Q an orthonormal basis of the rendered directions) and b = c + g - M T⁻¹Ṫ q̇: Wrr = Eᵀ M E, zr = Eᵀ b and τ =
//! M E Wrr⁻¹ (fr - Eᵀ b) + b.
//!
//! [`Shaping::torque`] computes this torque for one wall, [`crate::model::principal`] for several walls. [`Split`] and
//! [`Inertia`] hold the paper's own quantities for the analysis.

use crate::math::{Math, Real};
use crate::model::admissible::Admissible;
use crate::model::mechanism::{Mechanism, Shaping, WallTerms, in_basis};
use crate::model::principal::{Principal, Pull};
use crate::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Share of the largest stiffness of any direction below which a direction does not count as rendered: a hundred times
/// the square of the angle by which f32 rounding separates two equal normals.
pub const MIN_STIFFNESS_SHARE: f64 = 1.0e-12;

/// An orthonormal basis of the task space whose first columns span the rendered directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Split<T: Real, const N: usize> {
    /// Columns: R rendered directions, then N - R admissible directions.
    pub basis: SMatrix<T, N, N>,
    /// Number of rendered directions R.
    pub rendered: usize,
}

impl<T: Real, const N: usize> Split<T, N> {
    /// Returns the split for one wall with this unit normal (zeros beyond the task dimension `task`).
    ///
    /// The basis is completed in the plane by (-n_y, n_x), and in space by the normalised part of e_k across n (k has
    /// the smallest |n_k|) and its cross product with n. Coordinates beyond the task are admissible.
    #[inline(always)]
    pub fn new<K: Math<T>>(normal: &SVector<T, N>, task: usize) -> Self {
        let n = normal;
        let mut basis = SMatrix::<T, N, N>::identity();
        basis.set_column(0, n);
        if task == 2 && N >= 2 {
            basis[(0, 1)] = -n[1];
            basis[(1, 1)] = n[0];
        } else if task == 3 && N >= 3 {
            // Column 1 is the normalised part of e_k across n, column 2 the cross product with n; (k, i, j) is cyclic.
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

    /// Returns the split for these walls: one wall's normal, or the stiffness directions of several walls.
    fn for_walls<K: Math<T>>(walls: &[Pull<T, N>], task: usize) -> Self {
        match walls {
            [] => Self { basis: SMatrix::identity(), rendered: 0 },
            [only] => Self::new::<K>(&only.normal, task),
            several => {
                let principal = Principal::new::<K>(several, task);
                let least = principal.stiffness_along(0) * T::from_f64(MIN_STIFFNESS_SHARE);
                let rendered = principal.stiffness.iter().filter(|along| **along > least).count();
                Self { basis: principal.basis, rendered }
            }
        }
    }
}

/// Returns the rotation term κ (m/s²) of the task frame on a curved wall, such that T⁻¹Ṫ q̇ = J⁻¹(J̇ q̇ + κ). For one
/// rendered direction `n` with rate `n_rate` and the tip velocity `velocity`, κ = n(ṅ·ṗ) - ṅ(n·ṗ). The admissible
/// directions do not spin about n. For several rendered directions, pass the admissible direction and its rate.
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
    /// Rendered and admissible directions.
    pub split: Split<T, N>,
    /// W = T⁻ᵀ M T⁻¹ (1a), kg. The rendered block comes first.
    pub w: SMatrix<T, N, N>,
    /// z = T⁻ᵀ(c + g) - W Ṫ q̇ (1b), N. The rendered entries come first.
    pub z: SVector<T, N>,
    /// Weff = (Jr M⁻¹ Jrᵀ)⁻¹ in the leading R x R block, kg.
    pub w_eff: SMatrix<T, N, N>,
    /// Joint torques of (4) with z for the given force, N m.
    pub torque: SVector<T, N>,
    /// Joint torques without the feed-forward, Jᵀ fr, N m.
    pub torque_without_feed_forward: SVector<T, N>,
    /// fa of (4) in its first N - R entries, N.
    pub f_a: SVector<T, N>,
}

impl<T: Real, const N: usize> Inertia<T, N> {
    /// Computes all quantities of equation (4) for a mechanism in `pose` at joint velocities `qd` (rad/s), against
    /// plane walls whose forces add up to `force` (N, a task vector).
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

    /// Computes [`Inertia::new`] for a redundant device that holds `admissible` instead of φ. The basis then contains
    /// the null motion of each tip direction.
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
                Self::for_one_wall::<K, M>(mechanism, pose, qd, only, force)
            }
            _ => Self::for_any_walls::<K, M>(mechanism, pose, qd, walls, force, admissible),
        }
    }

    /// Computes the quantities in closed form for one wall, with φ held on a redundant device.
    #[inline(always)]
    fn for_one_wall<K: Math<T>, M: Mechanism<T, N>>(
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

    /// Computes the quantities for any number of walls and any held coordinate.
    #[inline(never)]
    fn for_any_walls<K: Math<T>, M: Mechanism<T, N>>(
        mechanism: &M,
        pose: &M::Pose,
        qd: &SVector<T, N>,
        walls: &[Pull<T, N>],
        force: &SVector<T, N>,
        admissible: Admissible,
    ) -> Self {
        let split = Split::for_walls::<K>(walls, M::SPEC.task);
        let rank = split.rendered;
        let tip = split.basis;
        let mut b = mechanism.velocity_torque(pose, qd);
        let mut split = split;
        if M::SPEC.task < N && admissible != Admissible::Orientation {
            let null = mechanism.shaping(pose, &tip.column(N - 1).into_owned());
            let qdd_bias = mechanism.inverse(pose, &(mechanism.jacobian_rate(pose, qd) * qd));
            b = admissible.hold_bias(&b, &qdd_bias, &null);
            for i in 0..M::SPEC.task {
                let along = mechanism.shaping(pose, &tip.column(i).into_owned());
                split.basis[(N - 1, i)] = admissible.added_null_motion(&along, &null);
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
                let (shaped, plain) = principal.feed_forward(&shapings, force, T::one(), |_| Some((b, b)));
                shaped + mechanism.transpose(pose, &plain)
            }
        };
        let f_a = SVector::from_fn(|i, _| shapings.get(i + rank).map_or(T::zero(), |shaping| shaping.e.dot(&torque)));
        let (w_eff, torque_without_feed_forward) = terms_without_feed_forward(mechanism, pose, &tip, rank, &in_span);
        Self { split, w, z, w_eff, torque, torque_without_feed_forward, f_a }
    }
}

/// Returns Weff (kg) in the leading block of a matrix, and the joint torques without feed-forward (N m), along the
/// first `rank` columns of `tip`. `in_span` is the force along the columns, N.
#[inline(always)]
fn terms_without_feed_forward<T: Real, M: Mechanism<T, N>, const N: usize>(
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
