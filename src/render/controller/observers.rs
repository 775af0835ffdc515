//! The estimators that watch joints, one for each.

use crate::math::{Math, Real};
use crate::model::device::Device;
use crate::render::velocity::{Coefficients, JointVelocity, Seen};
use nalgebra::SVector;

/// One joint.
#[derive(Clone, Copy, Debug)]
struct Joint<T: Real> {
    velocity: JointVelocity<T>,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    /// Its inverse, and counts per period² in 1 rad/s²; 0 for a joint without encoder.
    counts_per_speed: T,
    unit: T,
}

/// N joints and what their counts were.
#[derive(Clone, Debug)]
pub(super) struct Observers<T: Real, const N: usize> {
    joints: [Joint<T>; N],
    last: [i32; N],
    primed: bool,
    /// The motors' torques since the last step, N m.
    pub acting: SVector<T, N>,
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
        Self { joints: core::array::from_fn(joint), last: [0; N], primed: false, acting: SVector::zeros() }
    }

    /// Joint velocities (rad/s) after these counts. `pushed`: accelerations that the motors gave, rad/s². `before`: the
    /// velocities by what was at work when the estimator is new.
    pub fn step<K: Math<T>>(
        &mut self,
        coefficients: &Coefficients<T>,
        counts: &[i32; N],
        pushed: &SVector<T, N>,
        before: &SVector<T, N>,
    ) -> SVector<T, N> {
        if !self.primed {
            self.last = *counts;
            self.primed = true;
        }
        let mut qd = SVector::zeros();
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let moved = T::from_i32(counts[i].wrapping_sub(self.last[i]));
            let push = pushed[i] * joint.unit;
            let pushed = if push.is_finite() { push } else { T::zero() };
            let seen = Seen { moved, pushed, unit: joint.unit };
            let velocity = joint.velocity.step::<K>(coefficients, &seen, before[i] * joint.counts_per_speed);
            qd[i] = velocity * joint.speed_per_count;
        }
        self.last = *counts;
        qd
    }

    /// Restarts it.
    pub fn forget(&mut self) {
        self.primed = false;
        self.acting = SVector::zeros();
        self.joints.iter_mut().for_each(|joint| joint.velocity = JointVelocity::default());
    }
}
