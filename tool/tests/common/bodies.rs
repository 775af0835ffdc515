//! A sampled loop with several walls, computed from M and J alone: the oracle for predicted ranges of sets of walls.

use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::pose::TaskPose;
use nalgebra::{DMatrix, DVector};

/// Control rate, Hz. The delay is one sample.
pub const RATE_HZ: f64 = 1_000.0;
/// Cutoff of the Butterworth low-pass, Hz.
pub const CUTOFF_HZ: f64 = 100.0;

/// Bodies on springs and dampers in a sampled loop with several walls: the links and, behind cables, the motors.
pub struct Bodies {
    mass: DMatrix<f64>,
    damping: DMatrix<f64>,
    stiffness: DMatrix<f64>,
    /// Displacement of the tip, computed from the encoders, per displacement of each body.
    seen: DMatrix<f64>,
    /// Torque on each body per joint torque.
    driven: DMatrix<f64>,
    /// Joint torques per displacement of the tip, for walls of 1 N/m in total.
    torques: DMatrix<f64>,
}

impl Bodies {
    pub fn new(file: &DeviceFile, q: &[f64], hand: Hand, torques: DMatrix<f64>) -> Self {
        let mechanism = AnyMechanism::new(&file.description).unwrap();
        let pose = TaskPose::of(&mechanism, q).unwrap();
        let (n, tip) = (q.len(), pose.jacobian.rows(0, pose.task).into_owned());
        let joints = &file.description.joints[..n];
        let cables = joints.iter().any(|joint| joint.transmission.is_some());
        let all = if cables { 2 * n } else { n };
        let square = tip.tr_mul(&tip);
        let mut bodies = Self {
            mass: DMatrix::zeros(all, all),
            damping: DMatrix::zeros(all, all),
            stiffness: DMatrix::zeros(all, all),
            seen: DMatrix::zeros(tip.nrows(), all),
            driven: DMatrix::zeros(all, n),
            torques,
        };
        let links = &pose.mass + &square * hand.mass;
        bodies.mass.view_mut((0, 0), (n, n)).copy_from(&links);
        bodies.damping.view_mut((0, 0), (n, n)).copy_from(&(&square * hand.damping));
        bodies.stiffness.view_mut((0, 0), (n, n)).copy_from(&(&square * hand.stiffness));
        for (j, joint) in joints.iter().enumerate() {
            let motor = if cables { n + j } else { j };
            if let Some(cable) = joint.transmission {
                bodies.mass[(j, j)] -= cable.motor_inertia;
                bodies.mass[(motor, motor)] = cable.motor_inertia;
                for (a, b, sign) in [(j, j, 1.0), (motor, motor, 1.0), (j, motor, -1.0), (motor, j, -1.0)] {
                    bodies.damping[(a, b)] += sign * cable.damping;
                    bodies.stiffness[(a, b)] += sign * cable.stiffness;
                }
            }
            bodies.damping[(motor, motor)] += joint.viscous;
            bodies.driven[(motor, j)] = 1.0;
            bodies.seen.set_column(motor, &tip.column(j));
        }
        bodies
    }

    /// Asserts that the loop at damping `kd` is stable just below the stiffness `kp` and unstable just above.
    pub fn assert_limit(&self, kp: f64, kd: f64, case: &str) {
        assert!(kp > 0.0, "{case}: nothing is stable at {kd} N s/m");
        let (below, above) = (self.spectral_radius(kp * 0.999, kd), self.spectral_radius(kp * 1.001, kd));
        assert!(below < 1.0 && above > 1.0, "{case}: {below} below {kp} N/m and {above} above");
    }

    /// Returns the largest |z| of the loop at this total stiffness and total damping of the walls.
    fn spectral_radius(&self, kp: f64, kd: f64) -> f64 {
        let t = 1.0 / RATE_HZ;
        let (d, n) = self.seen.shape();
        let joints = self.driven.ncols();
        let inverse = self.mass.clone().try_inverse().unwrap();
        let mut a = DMatrix::zeros(2 * n + joints, 2 * n + joints);
        a.view_mut((0, n), (n, n)).fill_with_identity();
        a.view_mut((n, 0), (n, n)).copy_from(&(-&inverse * &self.stiffness * (t * t)));
        a.view_mut((n, n), (n, n)).copy_from(&(-&inverse * &self.damping * t));
        a.view_mut((n, 2 * n), (n, joints)).copy_from(&(&inverse * &self.driven * (t * t)));
        let step = a.exp();
        let w = (std::f64::consts::PI * CUTOFF_HZ * t).tan();
        let scale = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
        let b = w * w * scale;
        let (a1, a2) = (2.0 * (w * w - 1.0) * scale, (1.0 - std::f64::consts::SQRT_2 * w + w * w) * scale);
        // States: bodies, last torque, and for each direction the last position and two filter states.
        let plant = 2 * n + joints;
        let size = plant + 3 * d;
        let mut matrix = DMatrix::zeros(size, size);
        for column in 0..size {
            let s = DVector::from_fn(size, |i, _| f64::from(u8::from(i == column)));
            let x = &self.seen * s.rows(0, n);
            let (mut next, mut pull) = (DVector::zeros(size), DVector::zeros(d));
            for i in 0..d {
                let at = plant + 3 * i;
                let error = x[i] - s[at];
                let y = b * error + s[at + 1];
                next[at] = x[i];
                next[at + 1] = 2.0 * b * error - a1 * y + s[at + 2];
                next[at + 2] = b * error - a2 * y;
                pull[i] = -(kp * x[i] + kd / t * y);
            }
            let plant_step = &step * s.rows(0, plant);
            next.rows_mut(0, 2 * n).copy_from(&plant_step.rows(0, 2 * n));
            next.rows_mut(2 * n, joints).copy_from(&(&self.torques * pull));
            matrix.set_column(column, &next);
        }
        // Leave out z = 1, the motion on which no wall and no spring acts.
        let is_far_from_one = |z: &&nalgebra::Complex<f64>| (**z - 1.0).norm() > 1.0e-5;
        matrix.complex_eigenvalues().iter().filter(is_far_from_one).map(|z| z.norm()).fold(0.0, f64::max)
    }
}
