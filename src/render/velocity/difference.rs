//! Difference over several samples: (x[n] - x[n-k])/(k T).
//!
//! An encoder step changes the velocity k times less than in the backward difference, with a lag of k/2 samples. The
//! filter equals fast sampling of position and slow sampling of velocity without the jumps (Koul, Khosa and Ahmad 2024,
//! Int. J. of Mechanical System Dynamics 4(2):171). It has zeros at every multiple of rate/k.

use super::{Chosen, CutoffMeaning, EstimatorKey, EstimatorSpec, JointEstimator, JointSample, MAX_WINDOW};
use crate::math::{Math, Real};

/// The last samples of one joint.
#[derive(Clone, Copy, Debug)]
pub struct Difference<T> {
    /// Motion in each of the last periods, counts.
    moved: [T; MAX_WINDOW],
    next: usize,
    /// Motion over the window, counts.
    sum: T,
}

/// Number of samples of the window, and its inverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window<T> {
    samples: usize,
    inverse: T,
}

impl<T: Real> JointEstimator<T> for Difference<T> {
    const SPEC: EstimatorSpec = EstimatorSpec {
        name: "difference",
        cutoff: CutoffMeaning::LowPassAfter,
        key: Some(EstimatorKey { name: "difference_over", unit: "samples", range: (1, MAX_WINDOW as u32), usual: 10 }),
        predicts: false,
    };

    type Design = Window<T>;

    fn design(options: &Chosen, _: T) -> Window<T> {
        let samples = (options.value as usize).clamp(1, MAX_WINDOW);
        Window { samples, inverse: T::one() / T::from_i32(samples as i32) }
    }

    fn lag(window: &Window<T>) -> T {
        T::from_f64(0.5) / window.inverse
    }

    fn moving_at(velocity: T) -> Self {
        Self { moved: [velocity; MAX_WINDOW], next: MAX_WINDOW, sum: T::zero() }
    }

    fn step<K: Math<T>>(&mut self, window: &Window<T>, seen: &JointSample<T>) -> T {
        if self.next >= window.samples {
            // Sums up again at the start of each pass through the ring, and after a change to a shorter ring.
            let ring = self.moved.iter().take(window.samples);
            self.sum = ring.fold(T::zero(), |sum, moved| sum + *moved);
            self.next = 0;
        }
        if let Some(oldest) = self.moved.get_mut(self.next) {
            self.sum += seen.moved - *oldest;
            *oldest = seen.moved;
        }
        self.next += 1;
        self.sum * window.inverse
    }
}
