//! Levant's robust exact differentiator (A. Levant 1998, "Robust exact differentiation via sliding mode technique",
//! Automatica 34(3):379): exact without noise as long as the acceleration stays within a known limit L.
//!
//! In continuous time, with e how far the position is ahead of the estimate, ė = ẋ - v - 1.5 √L |e|^½ sign e and
//! v̇ = 1.1 L sign e. Here by implicit Euler steps, which have a closed form and do not chatter where the explicit ones
//! do (Mojallizadeh, Brogliato and Acary 2021, "Time-discretizations of differentiators", Int. J. of Robust and
//! Nonlinear Control 31:7679): one square root a step. Not linear, so it has no transfer function.

use super::{Chosen, CutoffMeans, EstimatorKey, EstimatorSpec, JointEstimator, Seen};
use crate::math::{Math, Real};

/// The estimate of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Levant<T> {
    /// Distance of the count ahead of the estimated position, counts.
    ahead: T,
    /// Counts per period.
    velocity: T,
}

impl<T: Real> JointEstimator<T> for Levant<T> {
    const SPEC: EstimatorSpec = EstimatorSpec {
        name: "levant",
        cutoff: CutoffMeans::LowPassBehind,
        key: Some(EstimatorKey { name: "acceleration_limit", unit: "rad/s²", range: (1, 1_000_000), usual: 1_000 }),
        predicts: false,
    };

    /// Largest acceleration of the joint, rad/s².
    type Design = T;

    fn design(chosen: &Chosen, _: T) -> T {
        T::from_i32(chosen.value.min(1_000_000) as i32)
    }

    /// None while the acceleration stays within the limit.
    fn lag(_: &T) -> T {
        T::zero()
    }

    fn moving_at(velocity: T) -> Self {
        Self { ahead: T::zero(), velocity }
    }

    fn step<K: Math<T>>(&mut self, limit: &T, seen: &Seen<T>) -> T {
        let limit = *limit * seen.unit.abs();
        let most = T::from_f64(1.1) * limit;
        // The distance ahead after this period without a correction.
        let beyond = self.ahead + (seen.moved - self.velocity);
        let left = beyond.abs() - most;
        if left > T::zero() {
            // y² + c y = left, with y = √|e| after the step.
            let half = T::from_f64(0.75) * K::sqrt(limit);
            let root = left / (half + K::sqrt(half * half + left));
            let sign = if beyond < T::zero() { -T::one() } else { T::one() };
            self.ahead = sign * root * root;
            self.velocity += sign * most;
        } else {
            self.ahead = T::zero();
            self.velocity += beyond;
        }
        self.velocity
    }
}
