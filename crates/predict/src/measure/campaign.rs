//! A measurement campaign over feed-forwards, dampings and repeats.

use super::progress::{Point, Progress, UnfinishedSearch, median, same_damping};
use super::swing::Verdict;
use super::{MeasureError, PreparedBoard};
use haptic_bridge::render::scene::FeedForward;

/// The repeats of a campaign.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Feed-forwards that are measured.
    pub modes: Vec<FeedForward>,
    /// Dampings, N s/m. If `None`, the largest stable damping is measured and the dampings are spread below it.
    pub kd: Option<Vec<f64>>,
    /// Number of dampings if `kd` is `None`.
    pub points: usize,
    /// Repeats of each pull at each damping.
    pub repeats: usize,
    /// Pulls relative to the longest pull, with sign. Consecutive repeats use them in turn.
    pub pulls: Vec<f64>,
}

/// Pulls to both sides. With friction the two sides give different results.
pub const BOTH_SIDES: [f64; 2] = [1.0, -1.0];

impl Plan {
    /// Returns the number of repeats per damping over all pulls.
    #[must_use]
    pub fn repeats_per_damping(&self) -> usize {
        self.repeats * self.pulls.len()
    }

    /// Returns the total number of repeats.
    pub fn total(&self) -> usize {
        self.modes.len() * self.kd.as_ref().map_or(self.points, Vec::len) * self.repeats_per_damping()
    }

    /// Returns the repeats of a point by pull. Only repeats with the same pull are the same experiment.
    #[must_use]
    pub fn repeats_by_pull(&self, point: &Point) -> Vec<(f64, Vec<f64>)> {
        let of = |nth: usize| point.repeats.iter().copied().skip(nth).step_by(self.pulls.len()).collect::<Vec<_>>();
        let all = self.pulls.iter().enumerate().map(|(nth, pull)| (*pull, of(nth)));
        all.filter(|(_, repeats)| !repeats.is_empty()).collect()
    }

    /// Returns the stiffness that is stable at every pull, N/m: the lowest median over the pulls.
    #[must_use]
    pub fn stiffness_at_every_pull(&self, point: &Point) -> f64 {
        self.repeats_by_pull(point).iter().map(|(_, repeats)| median(repeats)).reduce(f64::min).unwrap_or(0.0)
    }

    /// Returns the points with a mode and, if the plan lists dampings, with a damping of this plan.
    #[must_use]
    pub fn points_of_plan<'a>(&self, points: impl IntoIterator<Item = &'a Point>) -> Vec<&'a Point> {
        let named = |kd: f64| self.kd.as_ref().is_none_or(|kds| kds.iter().any(|other| same_damping(kd, *other)));
        points.into_iter().filter(|point| self.modes.contains(&point.mode) && named(point.kd)).collect()
    }
}

impl Progress {
    /// Returns the number of repeats of `plan` that are already measured.
    #[must_use]
    pub fn measured_repeats(&self, plan: &Plan) -> usize {
        plan.points_of_plan(&self.points)
            .into_iter()
            .map(|point| {
                if point.open.is_some() {
                    plan.repeats_per_damping()
                } else {
                    point.repeats.len().min(plan.repeats_per_damping())
                }
            })
            .sum()
    }
}

/// Measures the repeats that `progress` lacks. After each repeat, calls `saved` with the number of repeats that are
/// done. If a damping cannot be measured, notes the reason and continues with the next damping.
pub fn run(
    prepared: &mut PreparedBoard<'_>,
    plan: &Plan,
    progress: &mut Progress,
    mut saved: impl FnMut(&Progress, usize) -> Result<(), MeasureError>,
) -> Result<(), MeasureError> {
    let mut done = 0;
    for &mode in &plan.modes {
        let kds = match &plan.kd {
            Some(kds) => kds.clone(),
            None => {
                let end = match progress.end(mode) {
                    Some(end) => end,
                    None => {
                        let end = damping_end(prepared, mode, progress)?;
                        saved(progress, done)?;
                        end
                    }
                };
                // Spreads the dampings inside the range, without its ends.
                (0..plan.points).map(|i| end * (i as f64 + 0.5) / plan.points as f64).collect()
            }
        };
        for kd in kds {
            for repeat in 0..plan.repeats_per_damping() {
                let earlier = progress.point(mode, kd);
                if earlier.repeats.len() <= repeat && earlier.open.is_none() {
                    let guess = earlier.repeats.last().copied();
                    let strength = plan.pulls[repeat % plan.pulls.len()];
                    let found = prepared.boundary(mode, kd, strength, guess);
                    progress.set_date();
                    let point = progress.point(mode, kd);
                    match found {
                        Ok(found) => {
                            point.repeats.push(found.gain);
                            if let Verdict::Vibrates(size) = found.verdict_beyond {
                                point.vibration_m = Some(point.vibration_m.map_or(size, |other| other.max(size)));
                            }
                        }
                        Err(MeasureError::Open { stable, why }) => {
                            point.open = Some(UnfinishedSearch { stable_up_to: stable, reason: why.to_string() });
                        }
                        Err(error) => return Err(error),
                    }
                }
                done += 1;
                saved(progress, done)?;
            }
        }
    }
    Ok(())
}

/// Measures the damping at which the range of a mode ends. If no end is found, returns the largest stable damping.
fn damping_end(
    prepared: &mut PreparedBoard<'_>,
    mode: FeedForward,
    progress: &mut Progress,
) -> Result<f64, MeasureError> {
    let end = match prepared.damping_end(mode) {
        Ok(found) => found.gain,
        Err(MeasureError::Open { stable, why }) if stable > 0.0 => {
            progress.open_ends.push((mode, why.to_string()));
            stable
        }
        Err(MeasureError::Open { why, .. }) => return Err(*why),
        Err(error) => return Err(error),
    };
    progress.ends.push((mode, end));
    progress.set_date();
    Ok(end)
}
