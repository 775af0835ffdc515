//! The ways to compute the rendered and the effective inertia, in any precision.
//!
//! In exact arithmetic all are equal (docs/model.md section 2). In f32 they lose different digits.

use haptic_bridge::math::{Math, Real};
use haptic_bridge::model::inertia::Split;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Inertias along one normal by every route, kg, and the torques of the board.
#[derive(Clone, Copy, Debug)]
pub struct Routes<T: Real, const N: usize> {
    /// Wrr from W = T⁻ᵀ M T⁻¹ with T⁻¹ by elimination: the joint-space route.
    pub w_rr_joint: T,
    /// Wrr = nᵀ Λ n with Λ from the closed-form J⁻¹.
    pub w_rr_task: T,
    /// Wrr of the board's kernel, `Mechanism::shaping`.
    pub w_rr_kernel: T,
    /// Weff = Wrr - Wra Waa⁻¹ War: the Schur form.
    pub w_eff_schur: T,
    /// Weff = 1/(Jr M⁻¹ Jrᵀ).
    pub w_eff_joint: T,
    /// Weff = 1/(nᵀ Λ⁻¹ n).
    pub w_eff_task: T,
    /// Jᵀ n: a wall force of 1 N without the feed-forward, N m.
    pub plain: SVector<T, N>,
    /// (4) for a wall force of 1 N at rest, N m.
    pub torque: SVector<T, N>,
    /// (4) with z for a wall force of 1 N, in motion, N m.
    pub torque_moving: SVector<T, N>,
}

/// Computes A⁻¹ by Gauss-Jordan elimination with pivoting, as a general-purpose library does.
pub fn inverse<T: Real, const N: usize>(matrix: &SMatrix<T, N, N>) -> SMatrix<T, N, N> {
    let (mut a, mut inverse) = (*matrix, SMatrix::<T, N, N>::identity());
    for k in 0..N {
        let pivot = (k..N).fold(k, |best, i| if a[(i, k)].abs() > a[(best, k)].abs() { i } else { best });
        a.swap_rows(k, pivot);
        inverse.swap_rows(k, pivot);
        let reciprocal = T::one() / a[(k, k)];
        for j in 0..N {
            a[(k, j)] *= reciprocal;
            inverse[(k, j)] *= reciprocal;
        }
        for i in (0..N).filter(|i| *i != k) {
            let factor = a[(i, k)];
            for j in 0..N {
                let (above, left) = (a[(k, j)], inverse[(k, j)]);
                a[(i, j)] -= factor * above;
                inverse[(i, j)] -= factor * left;
            }
        }
    }
    inverse
}

/// Computes every route at the pose `q` for the unit normal `n`. `torque_moving` is at the joint velocities `qd`
/// (rad/s).
pub fn routes<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    m: &M,
    q: &SVector<T, N>,
    qd: &SVector<T, N>,
    n: &SVector<T, N>,
) -> Routes<T, N> {
    let pose = m.pose::<K>(q);
    let (mass, jacobian) = (m.mass(&pose), m.jacobian(&pose));
    // Normalised in this precision, the same for every route.
    let n = &(n / K::sqrt(n.dot(n)));
    let split = Split::new::<K>(n, M::SPEC.task);

    let t_inverse = inverse(&(split.basis.transpose() * jacobian));
    let w = t_inverse.transpose() * mass * t_inverse;
    // Waa in a separate matrix; the rendered row is decoupled, with 1 on the diagonal.
    let (mut w_aa, mut w_ar) = (w, SVector::<T, N>::zeros());
    for i in 1..N {
        w_ar[i] = w[(i, 0)];
        w_aa[(i, 0)] = T::zero();
        w_aa[(0, i)] = T::zero();
    }
    w_aa[(0, 0)] = T::one();
    let w_eff_schur = w[(0, 0)] - w_ar.dot(&solve_symmetric(&w_aa, &w_ar));

    let row = jacobian.tr_mul(n);
    let lambda = m.operational_inertia(&pose);
    let shaping = m.shaping(&pose, n);
    let weight = m.gravity(&pose);
    let b = m.velocity_torque(&pose, qd) + weight;
    Routes {
        w_rr_joint: w[(0, 0)],
        w_rr_task: n.dot(&(lambda * n)),
        w_rr_kernel: shaping.w_rr,
        w_eff_schur,
        w_eff_joint: T::one() / row.dot(&solve_symmetric(&mass, &row)),
        w_eff_task: T::one() / n.dot(&solve_symmetric(&lambda, n)),
        plain: m.transpose(&pose, n),
        torque: shaping.torque(T::one(), &weight, &weight),
        torque_moving: shaping.torque(T::one(), &b, &b),
    }
}

/// Relative errors of each route against a reference.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    pub w_rr_joint: f64,
    pub w_rr_task: f64,
    pub w_rr_kernel: f64,
    pub w_eff_schur: f64,
    pub w_eff_joint: f64,
    pub w_eff_task: f64,
    pub plain: f64,
    pub torque: f64,
    pub torque_moving: f64,
}

impl Errors {
    /// Computes the errors of `found` against `exact`, for torques as a share of the largest entry.
    pub fn new<A: Real, B: Real, const N: usize>(found: &Routes<A, N>, exact: &Routes<B, N>) -> Self {
        let relative = |a: A, b: B| worst((a.to_f64() - b.to_f64()).abs() / b.to_f64().abs());
        let share = |a: &SVector<A, N>, b: &SVector<B, N>| {
            let (a, b) = (a.map(|x| x.to_f64()), b.map(|x| x.to_f64()));
            worst((a - b).amax() / b.amax())
        };
        Self {
            w_rr_joint: relative(found.w_rr_joint, exact.w_rr_kernel),
            w_rr_task: relative(found.w_rr_task, exact.w_rr_kernel),
            w_rr_kernel: relative(found.w_rr_kernel, exact.w_rr_kernel),
            w_eff_schur: relative(found.w_eff_schur, exact.w_eff_joint),
            w_eff_joint: relative(found.w_eff_joint, exact.w_eff_joint),
            w_eff_task: relative(found.w_eff_task, exact.w_eff_joint),
            plain: share(&found.plain, &exact.plain),
            torque: share(&found.torque, &exact.torque),
            torque_moving: share(&found.torque_moving, &exact.torque_moving),
        }
    }

    /// Returns all errors in the order of the table's columns.
    pub fn all(&self) -> [f64; 9] {
        [
            self.w_eff_schur,
            self.w_eff_joint,
            self.w_eff_task,
            self.w_rr_joint,
            self.w_rr_task,
            self.w_rr_kernel,
            self.plain,
            self.torque,
            self.torque_moving,
        ]
    }

    /// Keeps the larger error of each entry.
    pub fn grow(&mut self, other: &Self) {
        let larger = |a: &mut f64, b: f64| *a = a.max(b);
        larger(&mut self.w_rr_joint, other.w_rr_joint);
        larger(&mut self.w_rr_task, other.w_rr_task);
        larger(&mut self.w_rr_kernel, other.w_rr_kernel);
        larger(&mut self.w_eff_schur, other.w_eff_schur);
        larger(&mut self.w_eff_joint, other.w_eff_joint);
        larger(&mut self.w_eff_task, other.w_eff_task);
        larger(&mut self.plain, other.plain);
        larger(&mut self.torque, other.torque);
        larger(&mut self.torque_moving, other.torque_moving);
    }
}

/// Replaces NaN with an infinite error.
fn worst(error: f64) -> f64 {
    if error.is_nan() { f64::INFINITY } else { error }
}
