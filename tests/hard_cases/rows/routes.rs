//! The routes to the rendered and the effective inertia, in any precision. In exact arithmetic all routes are equal
//! (docs/model.md section 2), but in f32 they lose different digits.

use haptic_bridge::math::{Math, Real};
use haptic_bridge::model::inertia::{Inertia, Split};
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::principal::Pull;
use haptic_bridge::model::solve::solve_symmetric;
use nalgebra::{SMatrix, SVector};

/// Inertias along one normal by every route (kg), and the board's torques.
#[derive(Clone, Copy, Debug)]
pub struct Routes<T: Real, const N: usize> {
    /// Wrr from W = T⁻ᵀ M T⁻¹ with T⁻¹ by elimination (the joint-space route).
    pub w_rr_joint: T,
    /// Wrr = nᵀ Λ n, with Λ from the closed form of J⁻¹.
    pub w_rr_task: T,
    /// Wrr of the board's kernel (`Mechanism::shaping`).
    pub w_rr_kernel: T,
    /// Weff = Wrr - Wra Waa⁻¹ War (the Schur form).
    pub w_eff_schur: T,
    /// Weff = 1/(Jr M⁻¹ Jrᵀ).
    pub w_eff_joint: T,
    /// Weff = 1/(nᵀ Λ⁻¹ n).
    pub w_eff_task: T,
    /// Jᵀ n, the torques of a 1 N wall force without the feed-forward, N m.
    pub plain: SVector<T, N>,
    /// Torques of equation (4) for a 1 N wall force at rest, N m.
    pub torque: SVector<T, N>,
    /// Torques of equation (4) with z for a 1 N wall force in motion, N m.
    pub torque_moving: SVector<T, N>,
}

/// Computes A⁻¹ by Gauss-Jordan elimination with pivoting, like a general-purpose library.
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

/// Computes every route at the pose `q` for the unit normal `n`. Only `torque_moving` depends on the velocities `qd`.
pub fn routes<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    m: &M,
    q: &SVector<T, N>,
    qd: &SVector<T, N>,
    n: &SVector<T, N>,
) -> Routes<T, N> {
    let pose = m.pose::<K>(q);
    let (mass, jacobian) = (m.mass(&pose), m.jacobian(&pose));
    // The normal is normalised in this precision, so every route gets the same normal.
    let n = &(n / K::sqrt(n.dot(n)));
    let split = Split::new::<K>(n, M::SPEC.task);

    let t_inverse = inverse(&(split.basis.transpose() * jacobian));
    let w = t_inverse.transpose() * mass * t_inverse;
    // Waa in a matrix of full size. The rendered row is decoupled by 1 on the diagonal.
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

/// Defines a struct of errors in the order of the table's columns.
macro_rules! errors {
    ($doc:literal $Name:ident: $($field:ident)*) => {
        #[doc = $doc]
        #[derive(Clone, Copy, Debug, Default)]
        pub struct $Name {
            $(pub $field: f64,)*
        }

        impl $Name {
            pub fn all(&self) -> impl Iterator<Item = f64> {
                [$(self.$field),*].into_iter()
            }

            pub fn grow(&mut self, other: &Self) {
                $(self.$field = self.$field.max(other.$field);)*
            }
        }
    };
}
errors! {
    "Relative errors of each route against a reference."
    Errors: w_eff_schur w_eff_joint w_eff_task w_rr_joint w_rr_task w_rr_kernel plain torque torque_moving
}
errors! {
    "Errors of the analysis as shares of the largest entry of each quantity."
    QuantityErrors: w w_eff z f_a torque
}

impl Errors {
    /// Computes the errors of `found` against `exact`. The torque errors are shares of the largest entry.
    pub fn new<A: Real, B: Real, const N: usize>(found: &Routes<A, N>, exact: &Routes<B, N>) -> Self {
        let relative = |a: A, b: B| relative_error(&SVector::from([a]), &SVector::from([b]));
        Self {
            w_rr_joint: relative(found.w_rr_joint, exact.w_rr_kernel),
            w_rr_task: relative(found.w_rr_task, exact.w_rr_kernel),
            w_rr_kernel: relative(found.w_rr_kernel, exact.w_rr_kernel),
            w_eff_schur: relative(found.w_eff_schur, exact.w_eff_joint),
            w_eff_joint: relative(found.w_eff_joint, exact.w_eff_joint),
            w_eff_task: relative(found.w_eff_task, exact.w_eff_joint),
            plain: relative_error(&found.plain, &exact.plain),
            torque: relative_error(&found.torque, &exact.torque),
            torque_moving: relative_error(&found.torque_moving, &exact.torque_moving),
        }
    }
}

impl QuantityErrors {
    pub fn new<A: Real, B: Real, const N: usize>(found: &Inertia<A, N>, exact: &Inertia<B, N>) -> Self {
        Self {
            w: relative_error(&found.w, &exact.w),
            w_eff: relative_error(&found.w_eff, &exact.w_eff),
            z: relative_error(&found.z, &exact.z),
            f_a: relative_error(&found.f_a, &exact.f_a),
            torque: relative_error(&found.torque, &exact.torque),
        }
    }
}

/// Computes all quantities of equation (4) like the analysis, for one wall with the unit normal `n` and a force of 1 N,
/// at the pose `q` and the joint velocities `qd` (rad/s).
pub fn all_quantities<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    m: &M,
    q: &SVector<T, N>,
    qd: &SVector<T, N>,
    n: &SVector<T, N>,
) -> Inertia<T, N> {
    let n = n / K::sqrt(n.dot(n));
    let wall = Pull { normal: n, across: false, stiffness: T::one(), feed_forward: true };
    Inertia::new::<K, M>(m, &m.pose::<K>(q), qd, &[wall], &n)
}

/// Computes the largest error as a share of the largest entry. Returns infinity instead of NaN.
fn relative_error<A: Real, B: Real, const R: usize, const C: usize>(a: &SMatrix<A, R, C>, b: &SMatrix<B, R, C>) -> f64 {
    let (a, b) = (a.map(|x| x.to_f64()), b.map(|x| x.to_f64()));
    let error = (a - b).amax() / b.amax();
    if error.is_nan() { f64::INFINITY } else { error }
}
