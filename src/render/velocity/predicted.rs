//! An observer that predicts by the model from the motors' torques, and corrects by counts.
//!
//! The acceleration of a joint by the motors' torques, M⁻¹τ, is known. All other effects (hand, friction, weight, model
//! errors) are treated as one unknown, slowly changing acceleration. An α-β-γ filter tracks position, velocity and the
//! unknown acceleration, with the known acceleration as input (E. Brookner 1998, *Tracking and Kalman Filtering Made
//! Easy*, chapter 1, with all three poles at p: α = 1 - p³, β = 3/2 (1 - p)² (1 + p), γ = (1 - p)³; the input as in
//! Luenberger 1971, "An introduction to observers", IEEE Trans. Automatic Control 16:596).
//!
//! The wall's effect on the tip is therefore known without lag, and by the separation principle the loop around the
//! wall behaves as with an exact velocity. The cutoff is the bandwidth of the unknown acceleration and can be low. The
//! state contains the distance of the count from the estimate instead of the position.

use super::{Chosen, CutoffMeaning, EstimatorSpec, JointEstimator, JointSample};
use crate::math::{Math, Real};

/// The estimate of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Predicted<T> {
    /// Distance of the count from the estimated position, counts.
    count_offset: T,
    /// Velocity, counts per period.
    velocity: T,
    /// Acceleration that no motor torque explains, counts per period².
    unknown_acceleration: T,
}

/// 1 - α, β, γ, and the lag in periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<T> {
    remaining: T,
    beta: T,
    gamma: T,
    lag: T,
}

impl<T: Real> JointEstimator<T> for Predicted<T> {
    const SPEC: EstimatorSpec =
        EstimatorSpec { name: "predicted", cutoff: CutoffMeaning::Bandwidth, key: None, predicts: true };

    type Design = Gains<T>;

    fn design(_: &Chosen, warped: T) -> Gains<T> {
        let loss = (warped + warped) / (T::one() + warped);
        let pole = T::one() - loss;
        let square = loss * loss;
        Gains {
            remaining: pole * pole * pole,
            beta: T::from_f64(1.5) * square * (T::one() + pole),
            gamma: square * loss,
            lag: T::one() / loss,
        }
    }

    /// Returns the lag for an unknown force. A steady acceleration by the motors causes no lag.
    fn lag(gains: &Gains<T>) -> T {
        gains.lag
    }

    fn moving_at(velocity: T) -> Self {
        Self { count_offset: T::zero(), velocity, unknown_acceleration: T::zero() }
    }

    fn step<K: Math<T>>(&mut self, gains: &Gains<T>, seen: &JointSample<T>) -> T {
        let acceleration = self.unknown_acceleration + seen.pushed;
        let innovation = self.count_offset + (seen.moved - self.velocity - T::from_f64(0.5) * acceleration);
        self.count_offset = gains.remaining * innovation;
        self.velocity += acceleration + gains.beta * innovation;
        self.unknown_acceleration += gains.gamma * innovation;
        self.velocity
    }
}
