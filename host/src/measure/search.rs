//! The search for the boundary: raise by a factor until it oscillates, then bisect between the two last.

use haptic_bridge::render::scene::FeedForward;

use super::{Bench, MeasureError};

/// Ratio of the bracket at which the search ends.
pub const RESOLUTION: f64 = 1.005;
/// Factor by which gains are raised.
const RAISE: f64 = 1.3;
/// Times the gain is raised at most.
const RAISES: usize = 60;

/// Strengths and signs of the excitation of successive repeats.
const STRENGTHS: [f64; 6] = [1.0, -1.0, 0.7, -0.7, 0.85, -0.85];

/// The excitation of a repeat.
pub fn strength(repeat: usize) -> f64 {
    STRENGTHS[repeat % STRENGTHS.len()]
}

/// Finds where `oscillates` turns true, from `start` upward; zero when it is true already at a thousandth of it.
///
/// `guess` from an earlier repeat narrows the bracket; it is only a place to begin.
fn climb(
    start: f64,
    guess: Option<f64>,
    mut oscillates: impl FnMut(f64) -> Result<bool, MeasureError>,
) -> Result<f64, MeasureError> {
    let raise = if guess.is_some() { 1.08 } else { RAISE };
    let mut low = guess.map_or(start, |g| g / 1.05);
    let mut step: f64 = raise;
    while oscillates(low)? {
        low /= step;
        step = (step * step).min(2.0);
        if low < start * 1e-3 {
            return Ok(0.0);
        }
    }
    let mut high = low * raise;
    let mut raises = 0;
    while !oscillates(high)? {
        low = high;
        high *= raise;
        raises += 1;
        if raises > RAISES {
            return Err(MeasureError::Unbounded(high));
        }
    }
    while high > low * RESOLUTION {
        let middle = (low * high).sqrt();
        if oscillates(middle)? { high = middle } else { low = middle }
    }
    Ok((low * high).sqrt())
}

impl Bench<'_> {
    /// Measures the largest stable stiffness at one damping, N/m.
    pub fn boundary(
        &mut self,
        feed_forward: FeedForward,
        kd: f64,
        repeat: usize,
        guess: Option<f64>,
    ) -> Result<f64, MeasureError> {
        let start = self.gentle_stiffness();
        climb(start, guess.filter(|g| *g > 0.0), |kp| self.oscillates(feed_forward, kp, kd, strength(repeat)))
    }

    /// Measures the damping at which even a soft wall oscillates, N s/m: where the range ends.
    pub fn damping_end(&mut self, feed_forward: FeedForward) -> Result<f64, MeasureError> {
        let (kp, start) = (0.02 * self.gentle_stiffness(), self.gentle_damping());
        climb(start, None, |kd| self.oscillates(feed_forward, kp, kd, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_climb_ends_within_its_resolution() {
        for edge in [0.4, 1.0, 7.3, 900.0] {
            for guess in [None, Some(edge * 1.2), Some(edge * 0.9)] {
                let found = climb(1.0, guess, |kp| Ok(kp > edge)).unwrap();
                assert!((found / edge - 1.0).abs() < RESOLUTION - 1.0, "{edge}: {found}");
            }
        }
        assert_eq!(climb(1.0, None, |_| Ok(true)).unwrap(), 0.0);
        assert!(matches!(climb(1.0, None, |_| Ok(false)), Err(MeasureError::Unbounded(_))));
    }
}
