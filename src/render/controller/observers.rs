//! The joint estimators, one for each joint.

use crate::math::{Math, Real};
use crate::model::device::Device;
use crate::render::velocity::{Coefficients, JointSample, JointVelocity};
use nalgebra::SVector;

#[derive(Clone, Copy, Debug)]
struct Joint<T: Real> {
    velocity: JointVelocity<T>,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    /// Inverse of `speed_per_count`, s/rad; 0 without encoder.
    counts_per_speed: T,
    /// Counts per period² for 1 rad/s²; 0 without encoder.
    unit: T,
}

/// Estimators of N joints, with the counts of the last step.
#[derive(Clone, Debug)]
pub(super) struct Observers<T: Real, const N: usize> {
    joints: [Joint<T>; N],
    last: [i32; N],
    is_started: bool,
    /// Motor torques since the last step, N m.
    pub motor_torque: SVector<T, N>,
}

impl<T: Real, const N: usize> Observers<T, N> {
    #[inline(never)]
    pub fn new(device: &Device<T>, coefficients: &Coefficients<T>) -> Self {
        let rate = coefficients.rate();
        let joint = |i: usize| {
            let speed_per_count = device.joints[i].radians_per_count * rate;
            let scaled = speed_per_count != T::zero();
            let counts_per_speed = if scaled { T::one() / speed_per_count } else { T::zero() };
            Joint {
                velocity: JointVelocity::default(),
                speed_per_count,
                counts_per_speed,
                unit: counts_per_speed / rate,
            }
        };
        Self { joints: core::array::from_fn(joint), last: [0; N], is_started: false, motor_torque: SVector::zeros() }
    }

    /// Returns joint velocities (rad/s) after these counts. `pushed` is the acceleration by the motors, rad/s²;
    /// `before` is the initial velocity of a new estimator, rad/s.
    pub fn step<K: Math<T>>(
        &mut self,
        coefficients: &Coefficients<T>,
        counts: &[i32; N],
        pushed: &SVector<T, N>,
        before: &SVector<T, N>,
    ) -> SVector<T, N> {
        if !self.is_started {
            self.last = *counts;
            self.is_started = true;
        }
        let mut qd = SVector::zeros();
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let moved = T::from_i32(counts[i].wrapping_sub(self.last[i]));
            let push = pushed[i] * joint.unit;
            let pushed = if push.is_finite() { push } else { T::zero() };
            let seen = JointSample { moved, pushed, unit: joint.unit };
            let velocity = joint.velocity.step::<K>(coefficients, &seen, before[i] * joint.counts_per_speed);
            qd[i] = velocity * joint.speed_per_count;
        }
        self.last = *counts;
        qd
    }

    /// Restarts the estimators.
    pub fn forget(&mut self) {
        self.is_started = false;
        self.motor_torque = SVector::zeros();
        self.joints.iter_mut().for_each(|joint| joint.velocity = JointVelocity::default());
    }
}
