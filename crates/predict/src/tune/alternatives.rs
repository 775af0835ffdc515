//! Results with the feed-forwards that were not chosen.

use super::criteria::SearchContext;
use super::{Settings, TunedWall, ripple, stiffest_wall};
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use serde::Serialize;

/// A feed-forward that was not chosen, compared with the chosen wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Alternative {
    /// The feed-forward.
    pub feed_forward: FeedForward,
    /// The stiffest wall with this feed-forward; `None` if that wall is much softer or breaks a limit.
    pub best: Option<TunedWall>,
    /// Largest stiffness within margins and motors with the chosen wall's rate, estimator, cutoff and damping, N/m.
    pub allowed: f64,
    /// Ripple of the chosen wall with this feed-forward, N; `None` if the tip flies off.
    pub ripple_n: Option<f64>,
}

/// Compares the other allowed feed-forwards. Returns none if the pose has no coupling.
pub(super) fn alternatives(
    context: &SearchContext<'_>,
    result: &TunedWall,
    all: &[TunedWall],
) -> Result<Vec<Alternative>, Failure> {
    if !context.is_coupled() {
        return Ok(Vec::new());
    }
    let others = context.question.feed_forwards.iter().filter(|other| **other != result.settings.feed_forward);
    others
        .map(|&feed_forward| {
            let off = feed_forward == FeedForward::Off;
            let settings = Settings {
                feed_forward,
                damping_compensation: result.settings.damping_compensation && !off,
                ..result.settings
            };
            let allowed = context.largest_stiffness(&settings)?;
            let best = stiffest_wall(all.iter().filter(|candidate| candidate.settings.feed_forward == feed_forward));
            Ok(Alternative { feed_forward, best, allowed, ripple_n: ripple(context.question, &settings)?.ripple_n })
        })
        .collect()
}
