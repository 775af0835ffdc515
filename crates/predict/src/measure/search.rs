//! Search for a stability boundary: the gain rises by a factor until the loop oscillates, then bisection refines it.

use super::swing::Verdict;
use super::{MeasureError, PreparedBoard};
use haptic_bridge::render::scene::FeedForward;

/// Ratio of unstable to stable gain at which the search ends.
pub const GAIN_RESOLUTION: f64 = 1.005;
const RAISE_FACTOR: f64 = 1.3;
const MAX_RAISES: usize = 60;

/// Boundary of the stable walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary {
    /// Largest stable gain, N/m or N s/m.
    pub gain: f64,
    /// Motion of the tip just beyond the boundary: it grows, or continues as a vibration.
    pub verdict_beyond: Verdict,
}

/// Returns the largest gain for which `judge` returns [`Verdict::Decays`], or 0 if a thousandth of `start` oscillates.
/// The result `guess` of an earlier repeat shortens the search. Returns [`MeasureError::Open`] if a gain cannot be
/// judged.
fn find_boundary(
    start: f64,
    guess: Option<f64>,
    mut judge: impl FnMut(f64) -> Result<Verdict, MeasureError>,
) -> Result<Boundary, MeasureError> {
    let (mut stable, mut verdict_beyond) = (0.0_f64, Verdict::Grows);
    let mut oscillates = |gain: f64| match judge(gain) {
        Ok(Verdict::Decays) => {
            stable = stable.max(gain);
            Ok(false)
        }
        Ok(verdict) => {
            verdict_beyond = verdict;
            Ok(true)
        }
        Err(why) if why.is_local() => Err(MeasureError::Open { stable, why: Box::new(why) }),
        Err(error) => Err(error),
    };
    let raise = if guess.is_some() { 1.08 } else { RAISE_FACTOR };
    let mut low = guess.map_or(start, |g| g / 1.05);
    let mut step: f64 = raise;
    while oscillates(low)? {
        low /= step;
        step = (step * step).min(2.0);
        if low < start * 1e-3 {
            return Ok(Boundary { gain: 0.0, verdict_beyond });
        }
    }
    let mut high = low * raise;
    let mut raises = 0;
    while !oscillates(high)? {
        low = high;
        high *= raise;
        raises += 1;
        if raises > MAX_RAISES {
            return Err(MeasureError::Open { stable: low, why: Box::new(MeasureError::Unbounded) });
        }
    }
    while high > low * GAIN_RESOLUTION {
        let middle = (low * high).sqrt();
        if oscillates(middle)? { high = middle } else { low = middle }
    }
    Ok(Boundary { gain: (low * high).sqrt(), verdict_beyond })
}

impl PreparedBoard<'_> {
    /// Measures the largest stable stiffness (N/m) at damping `kd`. `strength` is the signed factor on the pull.
    pub fn boundary(
        &mut self,
        feed_forward: FeedForward,
        kd: f64,
        strength: f64,
        guess: Option<f64>,
    ) -> Result<Boundary, MeasureError> {
        let start = self.soft_hold_stiffness();
        find_boundary(start, guess.filter(|g| *g > 0.0), |kp| self.judge(feed_forward, kp, kd, strength))
    }

    /// Measures the damping at which even a soft wall oscillates, N s/m.
    pub fn damping_end(&mut self, feed_forward: FeedForward) -> Result<Boundary, MeasureError> {
        let (kp, start) = (0.02 * self.soft_hold_stiffness(), self.soft_hold_damping());
        find_boundary(start, None, |kd| self.judge(feed_forward, kp, kd, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a verdict function for a loop that vibrates above `edge`.
    fn vibrating(edge: f64) -> impl Fn(f64) -> Result<Verdict, MeasureError> {
        move |gain| Ok(if gain > edge { Verdict::Vibrates(1e-4) } else { Verdict::Decays })
    }

    #[test]
    fn the_search_ends_within_its_resolution() {
        for edge in [0.4, 1.0, 7.3, 900.0] {
            for guess in [None, Some(edge * 1.2), Some(edge * 0.9)] {
                let found = find_boundary(1.0, guess, vibrating(edge)).unwrap();
                assert!((found.gain / edge - 1.0).abs() < GAIN_RESOLUTION - 1.0, "{edge}: {found:?}");
                assert_eq!(found.verdict_beyond, Verdict::Vibrates(1e-4));
            }
        }
        assert_eq!(find_boundary(1.0, None, |_| Ok(Verdict::Grows)).unwrap().gain, 0.0);
    }

    #[test]
    fn a_search_that_ends_early_reports_the_largest_stable_gain() {
        let unbounded = find_boundary(1.0, None, |_| Ok(Verdict::Decays)).unwrap_err();
        assert!(matches!(&unbounded, MeasureError::Open { stable, why } if *stable > 1e6 && why.is_local()));
        let saturates = find_boundary(1.0, None, |gain| match gain {
            gain if gain < 10.0 => Ok(Verdict::Decays),
            stiffness => Err(MeasureError::Saturates { stiffness, of: "a wall", pull: 1e-4, force: 1.0 }),
        });
        let Err(MeasureError::Open { stable, .. }) = saturates else { panic!("{saturates:?}") };
        assert!(stable < 10.0 && stable * RAISE_FACTOR >= 10.0, "{stable}");
    }
}
