//! Difference over several samples: (x[n] - x[n-k])/(k T).
//!
//! The steps of the encoder weigh 1/k of what they weigh in the backward difference, and the velocity is k/2 samples
//! late: what sampling position fast and velocity slowly does (Koul, Khosa and Ahmad 2024, Int. J. of Mechanical System
//! Dynamics 4(2):171), without its jumps. Linear; nulls at every multiple of rate/k.

use super::{Chosen, CutoffMeans, EstimatorKey, EstimatorSpec, JointEstimator, LONGEST_WINDOW, Seen};
use crate::math::{Math, Real};

/// The last samples of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Difference<T> {
    /// Of each of the last periods, counts.
    moved: [T; LONGEST_WINDOW],
    next: usize,
    /// Over the window, counts.
    sum: T,
}

/// Samples that the difference goes over, and their inverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Over<T> {
    samples: usize,
    inverse: T,
}

impl<T: Real> JointEstimator<T> for Difference<T> {
    const SPEC: EstimatorSpec = EstimatorSpec {
        name: "difference",
        cutoff: CutoffMeans::LowPassBehind,
        key: Some(EstimatorKey {
            name: "difference_over",
            unit: "samples",
            range: (1, LONGEST_WINDOW as u32),
            usual: 10,
        }),
        predicts: false,
    };

    type Design = Over<T>;

    fn design(chosen: &Chosen, _: T) -> Over<T> {
        let samples = (chosen.value as usize).clamp(1, LONGEST_WINDOW);
        Over { samples, inverse: T::one() / T::from_i32(samples as i32) }
    }

    fn lag(over: &Over<T>) -> T {
        T::from_f64(0.5) / over.inverse
    }

    fn moving_at(velocity: T) -> Self {
        Self { moved: [velocity; LONGEST_WINDOW], next: LONGEST_WINDOW, sum: T::zero() }
    }

    fn step<K: Math<T>>(&mut self, over: &Over<T>, seen: &Seen<T>) -> T {
        if self.next >= over.samples {
            // The ring restarts at the beginning, after as many samples as it holds, and when it has become shorter.
            let ring = self.moved.iter().take(over.samples);
            self.sum = ring.fold(T::zero(), |sum, moved| sum + *moved);
            self.next = 0;
        }
        if let Some(oldest) = self.moved.get_mut(self.next) {
            self.sum += seen.moved - *oldest;
            *oldest = seen.moved;
        }
        self.next += 1;
        self.sum * over.inverse
    }
}
