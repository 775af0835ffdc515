//! The sampled loop of bodies on springs and dampers, written apart from the library: stable if all |z| are below 1.

use nalgebra::{Complex, DMatrix, DVector};

/// Control rate and cutoff of the velocity filter, Hz. Torques act one sample late.
pub const RATE: f64 = 1_000.0;
pub const CUTOFF: f64 = 100.0;

/// Links, then motors if there are cables.
pub struct Bodies {
    pub mass: DMatrix<f64>,
    pub damping: DMatrix<f64>,
    pub stiffness: DMatrix<f64>,
    /// Displacement of the tip as the encoders show it: rows are directions, columns are bodies.
    pub seen: DMatrix<f64>,
    /// Torques of the joints on the bodies.
    pub driven: DMatrix<f64>,
    /// Joint torques per newton along each direction, for walls of 1 N/m in total.
    pub torques: DMatrix<f64>,
}

impl Bodies {
    /// Returns the largest |z| at this total stiffness (N/m) and damping (N s/m).
    pub fn radius(&self, kp: f64, kd: f64) -> f64 {
        let t = 1.0 / RATE;
        let (d, n) = self.seen.shape();
        let joints = self.driven.ncols();
        let inverse = self.mass.clone().try_inverse().unwrap();
        let mut a = DMatrix::zeros(2 * n + joints, 2 * n + joints);
        a.view_mut((0, n), (n, n)).fill_with_identity();
        a.view_mut((n, 0), (n, n)).copy_from(&(-&inverse * &self.stiffness * (t * t)));
        a.view_mut((n, n), (n, n)).copy_from(&(-&inverse * &self.damping * t));
        a.view_mut((n, 2 * n), (n, joints)).copy_from(&(&inverse * &self.driven * (t * t)));
        let step = a.exp();
        let w = (std::f64::consts::PI * CUTOFF * t).tan();
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
        let b = w * w * scale;
        let (a1, a2) = (2.0 * (w * w - 1.0) * scale, (1.0 - std::f64::consts::SQRT_2 * w + w * w) * scale);
        // States: bodies, the last torque, then for each direction its last position and two states of the filter.
        let plant = 2 * n + joints;
        let size = plant + 3 * d;
        let mut matrix = DMatrix::zeros(size, size);
        for column in 0..size {
            let s = DVector::from_fn(size, |i, _| f64::from(u8::from(i == column)));
            let x = &self.seen * s.rows(0, n);
            let (mut next, mut pull) = (DVector::zeros(size), DVector::zeros(d));
            for i in 0..d {
                let at = plant + 3 * i;
                let moved = x[i] - s[at];
                let y = b * moved + s[at + 1];
                next[at] = x[i];
                next[at + 1] = 2.0 * b * moved - a1 * y + s[at + 2];
                next[at + 2] = b * moved - a2 * y;
                pull[i] = -(kp * x[i] + kd / t * y);
            }
            let moved = &step * s.rows(0, plant);
            next.rows_mut(0, 2 * n).copy_from(&moved.rows(0, 2 * n));
            next.rows_mut(2 * n, joints).copy_from(&(&self.torques * pull));
            matrix.set_column(column, &next);
        }
        // Bodies that no wall sees and no spring holds stay in place, z = 1.
        let far = |z: &&Complex<f64>| (**z - 1.0).norm() > 1.0e-5;
        matrix.complex_eigenvalues().iter().filter(far).map(|z| z.norm()).fold(0.0, f64::max)
    }
}
