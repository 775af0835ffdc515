//! A whole measurement: every feed-forward, every damping, every repeat, what is already there left out.

use haptic_bridge::render::scene::FeedForward;

use super::progress::{Mode, Progress};
use super::{Bench, MeasureError};

/// What is to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// With which feed-forward.
    pub modes: Vec<Mode>,
    /// At these dampings, N s/m; measured from where the range ends when `None`.
    pub kd: Option<Vec<f64>>,
    /// How many dampings when they are not given.
    pub points: usize,
    /// Repeats at each.
    pub repeats: usize,
}

impl Plan {
    /// Repeats in all.
    pub fn total(&self) -> usize {
        self.modes.len() * self.kd.as_ref().map_or(self.points, Vec::len) * self.repeats
    }
}

impl From<Mode> for FeedForward {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Off => Self::Off,
            Mode::Full => Self::Full,
            Mode::Washout => Self::Washout,
        }
    }
}

/// Measures what `progress` lacks. `saved` is called after every repeat, with how many of the plan are done.
pub fn run(
    bench: &mut Bench<'_>,
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
                        let end = bench.damping_end(mode.into())?;
                        progress.ends.push((mode, end));
                        saved(progress, done)?;
                        end
                    }
                };
                // Inside the range, none of them on its ends.
                (0..plan.points).map(|i| end * (i as f64 + 0.5) / plan.points as f64).collect()
            }
        };
        for kd in kds {
            for repeat in 0..plan.repeats {
                let earlier = progress.point(mode, kd);
                if earlier.repeats.len() <= repeat {
                    let guess = earlier.repeats.last().copied();
                    let found = bench.boundary(mode.into(), kd, repeat, guess)?;
                    progress.point(mode, kd).repeats.push(found);
                }
                done += 1;
                saved(progress, done)?;
            }
        }
    }
    Ok(())
}
