//! The wall that a scene has already, held to what the search holds walls to.

use super::criteria::SearchContext;
use super::{Found, Question, Settings, measured, ripple, three_digits};
use haptic_host::error::Failure;
use haptic_stability::sweep::Sweep;
use serde::Serialize;

/// The wall's settings that came before, held to the same margins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Baseline {
    /// Rate, estimator, cutoff, damping and feed-forward of the scene, with the largest stiffness that keeps
    /// everything; 0 if no stiffness does.
    #[serde(flatten)]
    pub settings: Settings,
    /// The stiffness that a hand feels of that, N/m; `None` where no transmission gives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
    /// Ripple at that stiffness, N.
    pub ripple_n: Option<f64>,
    /// The largest stiffness within the margins, whatever it ripples, N/m.
    pub within_margins: f64,
    /// The stiffness that the scene has, N/m.
    pub as_written: f64,
}

/// The ripple that a wall may have where nothing else is said, N: what the estimators were made to come below.
pub const USUAL_RIPPLE_N: f64 = 0.1;

/// The least ripple that is asked for where a scene's wall has less, N.
pub const LEAST_RIPPLE_N: f64 = 0.002;

/// The ripple that settings like these may have, in the search and on the simulated board: as much as the wall as it is
/// written, and no less than the least.
pub fn ripple_like(question: &Question<'_>, written: &Settings, sweep: &Sweep) -> Result<(f64, f64), Failure> {
    let bound = |ripple_n: Option<f64>| ripple_n.unwrap_or(USUAL_RIPPLE_N).max(LEAST_RIPPLE_N);
    Ok((bound(ripple(question, written)?.ripple_n), bound(measured::ripple(question, written, sweep)?)))
}

/// The settings of a scene's wall, as stiff as they keep everything.
pub fn baseline(question: &Question<'_>, written: &Settings, sweep: &Sweep) -> Result<Baseline, Failure> {
    let context = SearchContext::new(question, sweep)?;
    if written.around().is_none() {
        return Err(Failure::wrong(format!("`{}` has no linear analysis to hold it to margins", written.estimator))
            .remedy("compare with a scene that has another estimator"));
    }
    let most = three_digits(context.most(written)?, true);
    let at = |stiffness: f64| -> Result<Option<Found>, Failure> {
        let settings = Settings { stiffness: three_digits(stiffness, true), ..*written };
        if stiffness > 0.0 { context.kept(&settings) } else { Ok(None) }
    };
    let keeps = Option::is_some;
    let mut best = at(most)?;
    if most > 0.0 && !keeps(&best) {
        // Go down from there until it keeps the limit, but not below the scene as written where that keeps it.
        let (mut low, mut high) = (0.0_f64, most);
        let mut step = most;
        best = None;
        let as_written = if written.stiffness <= most { at(written.stiffness)? } else { None };
        if keeps(&as_written) {
            (low, best) = (written.stiffness, as_written);
        }
        while low == 0.0 && step > 1e-3 * most {
            step /= 2.0;
            let found = at(step)?;
            if keeps(&found) { (low, best) = (step, found) } else { high = step }
        }
        while low > 0.0 && high / low > 1.03 {
            let middle = (low * high).sqrt();
            let found = at(middle)?;
            if keeps(&found) { (low, best) = (middle, found) } else { high = middle }
        }
    }
    let nothing = Settings { stiffness: 0.0, ..*written };
    Ok(Baseline {
        settings: best.map_or(nothing, |best| best.settings),
        felt: best.and_then(|best| context.felt(&best.settings)),
        ripple_n: best.map(|best| best.ripple_n),
        within_margins: most,
        as_written: written.stiffness,
    })
}
