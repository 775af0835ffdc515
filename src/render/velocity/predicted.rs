//! Prediction by the model, correction by counts: an observer that knows what the motors do.
//!
//! The acceleration that the motors' torques give a joint, M⁻¹τ, is known; everything else that acts on it (hand,
//! friction, weight, errors of the model) is one unknown acceleration that changes slowly. Position, velocity and
//! that acceleration are tracked by an α-β-γ filter with the known acceleration as its input (E. Brookner 1998,
//! *Tracking and Kalman Filtering Made Easy*, chapter 1, with all three poles at p: α = 1 - p³, β = 3/2 (1 - p)²
//! (1 + p), γ = (1 - p)³; the input as in Luenberger 1971, "An introduction to observers", IEEE Trans. Automatic
//! Control 16:596).
//!
//! The wall's effect on the tip is thus known without lag, and by the separation principle the loop around the wall is
//! that of an exact velocity; the cutoff is the speed at which the rest is learnt, and can be low. It remembers only
//! the distance of the count ahead of the estimate.

use super::{Chosen, CutoffMeans, EstimatorSpec, JointEstimator, Seen};
use crate::math::{Math, Real};

/// The estimate of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Predicted<T> {
    /// Distance of the count ahead of the estimated position, counts.
    ahead: T,
    /// Counts per period.
    velocity: T,
    /// The acceleration that no torque accounts for, counts per period².
    unknown: T,
}

/// 1 - α, β and γ, and the lag in periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<T> {
    kept: T,
    beta: T,
    gamma: T,
    lag: T,
}

impl<T: Real> JointEstimator<T> for Predicted<T> {
    const SPEC: EstimatorSpec =
        EstimatorSpec { name: "predicted", cutoff: CutoffMeans::Bandwidth, key: None, predicts: true };

    type Design = Gains<T>;

    fn design(_: &Chosen, warped: T) -> Gains<T> {
        let left = (warped + warped) / (T::one() + warped);
        let pole = T::one() - left;
        let square = left * left;
        Gains {
            kept: pole * pole * pole,
            beta: T::from_f64(1.5) * square * (T::one() + pole),
            gamma: square * left,
            lag: T::one() / left,
        }
    }

    /// A steady acceleration is known without any; an unknown push is after this long.
    fn lag(gains: &Gains<T>) -> T {
        gains.lag
    }

    fn moving_at(velocity: T) -> Self {
        Self { ahead: T::zero(), velocity, unknown: T::zero() }
    }

    fn step<K: Math<T>>(&mut self, gains: &Gains<T>, seen: &Seen<T>) -> T {
        let gained = self.unknown + seen.pushed;
        let beyond = self.ahead + (seen.moved - self.velocity - T::from_f64(0.5) * gained);
        self.ahead = gains.kept * beyond;
        self.velocity += gained + gains.beta * beyond;
        self.unknown += gains.gamma * beyond;
        self.velocity
    }
}
