//! All quantities of equation (4) in double precision, as the analysis computes them (`Inertia`).

use haptic_bridge::math::{Math, Real};
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::principal::Pull;
use nalgebra::{SMatrix, SVector};

/// Computes all quantities for one wall with the unit normal `n` and a force of 1 N, at the pose `q` and the joint
/// velocities `qd` (rad/s).
pub fn whole<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    m: &M,
    q: &SVector<T, N>,
    qd: &SVector<T, N>,
    n: &SVector<T, N>,
) -> Inertia<T, N> {
    let n = n / K::sqrt(n.dot(n));
    let wall = Pull { normal: n, across: false, stiffness: T::one(), feed_forward: true };
    Inertia::new::<K, M>(m, &m.pose::<K>(q), qd, &[wall], &n)
}

/// Largest errors as shares of the largest entry of each quantity.
#[derive(Clone, Copy, Debug, Default)]
pub struct WholeErrors {
    pub w: f64,
    pub w_eff: f64,
    pub z: f64,
    pub f_a: f64,
    pub torque: f64,
}

impl WholeErrors {
    /// Adds the errors of `found` against `exact`.
    pub fn grow<A: Real, B: Real, const N: usize>(&mut self, found: &Inertia<A, N>, exact: &Inertia<B, N>) {
        self.w = self.w.max(share(&found.w, &exact.w));
        self.w_eff = self.w_eff.max(share(&found.w_eff, &exact.w_eff));
        self.z = self.z.max(share(&found.z, &exact.z));
        self.f_a = self.f_a.max(share(&found.f_a, &exact.f_a));
        self.torque = self.torque.max(share(&found.torque, &exact.torque));
    }
}

fn share<A: Real, B: Real, const R: usize, const C: usize>(a: &SMatrix<A, R, C>, b: &SMatrix<B, R, C>) -> f64 {
    let (a, b) = (a.map(|x| x.to_f64()), b.map(|x| x.to_f64()));
    let error = (a - b).amax() / b.amax();
    if error.is_nan() { f64::INFINITY } else { error }
}
