//! The gains and costs of the feed-forwards that were not chosen.

use super::criteria::SearchContext;
use super::{Found, Settings, ripple, stiffest};
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use serde::Serialize;

/// A feed-forward beside the answer's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Otherwise {
    /// Which.
    pub feed_forward: FeedForward,
    /// The stiffest wall with it; none where it is softer by a third than the answer, or does not keep margins or
    /// ripple.
    pub best: Option<Found>,
    /// The answer's rate, estimator, cutoff and damping with it: the largest stiffness within margins and motors, N/m.
    pub allowed: f64,
    /// The answer's wall with it: ripple, N; none where the tip flies off.
    pub ripple_n: Option<f64>,
}

/// Each of the question's other feed-forwards; none where nothing couples.
pub(super) fn otherwise(context: &SearchContext<'_>, answer: &Found, all: &[Found]) -> Result<Vec<Otherwise>, Failure> {
    if !context.is_coupled() {
        return Ok(Vec::new());
    }
    let others = context.question.feed_forwards.iter().filter(|other| **other != answer.settings.feed_forward);
    others
        .map(|&feed_forward| {
            let off = feed_forward == FeedForward::Off;
            let settings = Settings {
                feed_forward,
                damping_compensation: answer.settings.damping_compensation && !off,
                ..answer.settings
            };
            let allowed = context.most(&settings)?;
            let best = stiffest(all.iter().filter(|found| found.settings.feed_forward == feed_forward));
            Ok(Otherwise { feed_forward, best, allowed, ripple_n: ripple(context.question, &settings)?.ripple_n })
        })
        .collect()
}
