//! The sampled loop linearised about a motion: pose and speed are frozen at one instant, and each law's torque is
//! differentiated by joint angles and by the *estimated* joint velocities.

use super::unit_vector;
use haptic_bridge::math::Libm;
use haptic_bridge::model::mechanism::{FiveBar, Mechanism};
use haptic_bridge::render::scene::VelocityTerms;
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// A rendering law at a pose with the wall's normal; the law `None` renders Jᵀ f.
pub struct SlidingLoop {
    pub mechanism: FiveBar<f64>,
    pub q: [f64; 2],
    pub normal: f64,
    pub law: Option<VelocityTerms>,
}

impl SlidingLoop {
    fn torque(&self, q: &Vector2<f64>, qd: &Vector2<f64>, force: f64) -> Vector2<f64> {
        let (m, pose) = (&self.mechanism, self.mechanism.pose::<Libm>(q));
        let n = unit_vector(self.normal);
        let Some(terms) = self.law else { return m.transpose(&pose, &n) * force };
        let e = m.inverse(&pose, &n);
        let me = m.mass(&pose) * e;
        let b = match terms {
            VelocityTerms::Off => Vector2::zeros(),
            _ => m.velocity_torque(&pose, qd),
        };
        let rejected_force = if terms == VelocityTerms::Paper { e.dot(&b) } else { 0.0 };
        me * ((force - rejected_force) / e.dot(&me)) + b
    }

    /// Returns the loop's matrix over one sample at a speed along the wall (m/s). States: joint angles and speeds,
    /// last angles, and two filter states each for the wall's and the joints' velocities.
    fn loop_matrix(&self, speed: f64, kp: f64, kd: f64, rate: f64, cutoff: f64) -> DMatrix<f64> {
        const DIFFERENCE_STEP: f64 = 1.0e-5;
        let m = &self.mechanism;
        let (q0, n, t) = (Vector2::from(self.q), unit_vector(self.normal), unit_vector(self.normal + 90.0));
        let pose = m.pose::<Libm>(&q0);
        let qd0 = m.inverse(&pose, &(t * speed));
        let by = |f: &dyn Fn(&Vector2<f64>) -> Vector2<f64>, at: &Vector2<f64>| {
            let column = |i: usize| {
                let mut h = Vector2::zeros();
                h[i] = DIFFERENCE_STEP;
                (f(&(at + h)) - f(&(at - h))) / (2.0 * DIFFERENCE_STEP)
            };
            Matrix2::from_columns(&[column(0), column(1)])
        };
        let nominal = self.torque(&q0, &qd0, 0.0);
        let inverse = |pose: &_| m.mass(pose).try_inverse().expect("positive definite");
        let acceleration = |q: &Vector2<f64>, qd: &Vector2<f64>| {
            let pose = m.pose::<Libm>(q);
            inverse(&pose) * (nominal - m.coriolis(&pose, qd))
        };
        let (by_q, by_qd) = (by(&|q| acceleration(q, &qd0), &q0), by(&|qd| acceleration(&q0, qd), &qd0));
        let law_q = by(&|q| self.torque(q, &qd0, 0.0), &q0);
        let law_qd = by(&|qd| self.torque(&q0, qd, 0.0), &qd0);
        let newton = self.torque(&q0, &qd0, 1.0) - nominal;
        // The zero-order hold is computed by the series of the matrix exponential.
        let mut augmented = DMatrix::zeros(6, 6);
        augmented.view_mut((0, 2), (2, 2)).copy_from(&Matrix2::identity());
        augmented.view_mut((2, 0), (2, 2)).copy_from(&by_q);
        augmented.view_mut((2, 2), (2, 2)).copy_from(&by_qd);
        augmented.view_mut((2, 4), (2, 2)).copy_from(&inverse(&pose));
        let transition = (augmented / rate).exp();
        let g = (std::f64::consts::PI * cutoff / rate).tan();
        let a0 = 1.0 + std::f64::consts::SQRT_2 * g + g * g;
        let (b0, b1) = (g * g / a0, 2.0 * g * g / a0);
        let (a1, a2) = (2.0 * (g * g - 1.0) / a0, (1.0 - std::f64::consts::SQRT_2 * g + g * g) / a0);
        let row = |entries: &[(usize, f64)]| {
            let mut row = DVector::zeros(12);
            entries.iter().for_each(|(i, value)| row[*i] += value);
            row
        };
        let mut transition_matrix = DMatrix::zeros(12, 12);
        let jacobian_row = m.transpose(&pose, &n);
        let difference = [0, 1].map(|i| row(&[(i, rate), (4 + i, -rate)]));
        let along = &difference[0] * jacobian_row[0] + &difference[1] * jacobian_row[1];
        // The filter is in transposed direct form II.
        let mut filtered = |input: &DVector<f64>, first: usize| {
            let output = input * b0 + row(&[(first, 1.0)]);
            transition_matrix.set_row(first, &(input * b1 - &output * a1 + row(&[(first + 1, 1.0)])).transpose());
            transition_matrix.set_row(first + 1, &(input * b0 - &output * a2).transpose());
            output
        };
        let velocity = filtered(&along, 6);
        let joints = [filtered(&difference[0], 8), filtered(&difference[1], 10)];
        let force = row(&[(0, -kp * jacobian_row[0]), (1, -kp * jacobian_row[1])]) - velocity * kd;
        let torque = [0, 1].map(|i| {
            row(&[(0, law_q[(i, 0)]), (1, law_q[(i, 1)])])
                + &joints[0] * law_qd[(i, 0)]
                + &joints[1] * law_qd[(i, 1)]
                + &force * newton[i]
        });
        for state in 0..4 {
            let mut change = row(&[0, 1, 2, 3].map(|i| (i, transition[(state, i)])));
            change += &torque[0] * transition[(state, 4)] + &torque[1] * transition[(state, 5)];
            transition_matrix.set_row(state, &change.transpose());
        }
        transition_matrix.set_row(4, &row(&[(0, 1.0)]).transpose());
        transition_matrix.set_row(5, &row(&[(1, 1.0)]).transpose());
        transition_matrix
    }

    /// Returns true if an oscillation faster than 8 Hz grows. Slower modes describe the turning direction of motion.
    fn has_growing_mode(&self, speed: f64, kp: f64, kd: f64, rate: f64, cutoff: f64) -> bool {
        let fast = 8.0 * std::f64::consts::TAU / rate;
        let modes = self.loop_matrix(speed, kp, kd, rate, cutoff).complex_eigenvalues();
        modes.iter().any(|z| z.arg().abs() > fast && z.norm() > 1.0)
    }

    /// Returns the stiffness at which an oscillation begins to grow, N/m. `low` must be stable and `high` must not.
    pub fn stability_limit(&self, speed: f64, kd: f64, (low, high): (f64, f64), rate: f64, cutoff: f64) -> f64 {
        let grows = |kp| self.has_growing_mode(speed, kp, kd, rate, cutoff);
        assert!(!grows(low) && grows(high));
        let (mut low, mut high) = (low, high);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if grows(middle) { high = middle } else { low = middle }
        }
        low
    }
}
