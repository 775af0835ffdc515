//! First-order adaptive windowing, with end fit (Janabi-Sharifi, Hayward and Chen 2000, "Discrete-time adaptive windowing
//! for velocity estimation", IEEE Trans. Control Systems Technology 8(6):1003).
//!
//! The velocity is the slope from the last sample to the oldest of a window in which every sample lies within one count
//! of that line. At speed the window is short and so is the lag; near rest it is long and a step of the encoder weighs
//! little. The paper searches windows one by one and looks through each: as the line from x[n] to x[n-k] passes sample
//! n-j within a count exactly if its slope lies between (d[j] - 1)/j and (d[j] + 1)/j, with d[j] = x[n] - x[n-j], the
//! tightest of those bounds is all that has to be kept: one pass of at most 32 samples.

use super::{Chosen, CutoffMeans, EstimatorKey, EstimatorSpec, JointEstimator, LONGEST_WINDOW, Seen};
use crate::math::{Math, Real};

/// Largest distance of a sample from the line, counts: one, and a share of the 32nds in which such distances come, so
/// that rounding decides nothing.
const WITHIN: f64 = 1.01;

/// The last samples of one joint.
#[derive(Clone, Copy, Debug)]
pub struct AdaptiveWindow<T> {
    /// Of each of the last periods, counts.
    moved: [T; LONGEST_WINDOW],
    /// Index of the newest sample.
    newest: usize,
}

impl<T: Real> JointEstimator<T> for AdaptiveWindow<T> {
    const SPEC: EstimatorSpec = EstimatorSpec {
        name: "adaptive-window",
        cutoff: CutoffMeans::LowPassBehind,
        key: Some(EstimatorKey { name: "window", unit: "samples", range: (1, LONGEST_WINDOW as u32), usual: 16 }),
        predicts: false,
    };

    /// The longest window, samples.
    type Design = usize;

    fn design(chosen: &Chosen, _: T) -> usize {
        (chosen.value as usize).clamp(1, LONGEST_WINDOW)
    }

    /// That of the longest window: the most it can be.
    fn lag(window: &usize) -> T {
        T::from_f64(0.5) * T::from_i32(*window as i32)
    }

    fn moving_at(velocity: T) -> Self {
        Self { moved: [velocity; LONGEST_WINDOW], newest: 0 }
    }

    fn step<K: Math<T>>(&mut self, window: &usize, seen: &Seen<T>) -> T {
        self.newest = (self.newest + 1) % LONGEST_WINDOW;
        self.moved[self.newest] = seen.moved;
        let (mut distance, mut samples) = (seen.moved, T::one());
        let within = T::from_f64(WITHIN);
        let (mut slowest, mut fastest) = (distance - within, distance + within);
        let mut slope = distance;
        for back in 1..*window {
            let place = (self.newest + LONGEST_WINDOW - back % LONGEST_WINDOW) % LONGEST_WINDOW;
            distance += self.moved[place];
            samples += T::one();
            let share = T::one() / samples;
            let longer = distance * share;
            // Written so that NaN ends the window.
            if !(longer >= slowest && longer <= fastest) {
                break;
            }
            slope = longer;
            slowest = slowest.greater((distance - within) * share);
            fastest = fastest.lesser((distance + within) * share);
        }
        slope
    }
}
