//! The α-β filter: tracks position and velocity, both corrected by what the count shows beyond the prediction; the steady
//! state of a Kalman filter for a joint pushed at random.
//!
//! With both poles at p, α = 1 - p² and β = (1 - p)² (the fading-memory filter: E. Brookner 1998, *Tracking and Kalman
//! Filtering Made Easy*, chapter 1). p is the bilinear image of a pole at the cutoff. Seen from the velocity it is a
//! critically damped low-pass of second order. It remembers only how far the count is ahead of the estimate, so it keeps
//! its digits wherever the joint is.

use super::{Chosen, CutoffMeans, EstimatorSpec, JointEstimator, Seen};
use crate::math::{Math, Real};

/// The estimate of one joint.
#[derive(Clone, Copy, Debug)]
pub struct AlphaBeta<T> {
    /// Distance of the count ahead of the estimated position, counts.
    ahead: T,
    /// Counts per period.
    velocity: T,
}

/// 1 - α, and β.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<T> {
    kept: T,
    beta: T,
}

impl<T: Real> JointEstimator<T> for AlphaBeta<T> {
    const SPEC: EstimatorSpec =
        EstimatorSpec { name: "alpha-beta", cutoff: CutoffMeans::Bandwidth, key: None, predicts: false };

    type Design = Gains<T>;

    fn design(_: &Chosen, warped: T) -> Gains<T> {
        // p = (1 - g)/(1 + g), and 1 - p without a difference of nearly equal numbers.
        let left = (warped + warped) / (T::one() + warped);
        let pole = T::one() - left;
        Gains { kept: pole * pole, beta: left * left }
    }

    /// At a steady acceleration a the estimate follows with β × (what it is corrected by) = a: (α/β - 1/2) periods.
    fn lag(gains: &Gains<T>) -> T {
        (T::one() - gains.kept) / gains.beta - T::from_f64(0.5)
    }

    fn moving_at(velocity: T) -> Self {
        Self { ahead: T::zero(), velocity }
    }

    fn step<K: Math<T>>(&mut self, gains: &Gains<T>, seen: &Seen<T>) -> T {
        let beyond = self.ahead + (seen.moved - self.velocity);
        self.ahead = gains.kept * beyond;
        self.velocity += gains.beta * beyond;
        self.velocity
    }
}
