//! Checks the wall of a scene against the criteria of the search.

use super::criteria::SearchContext;
use super::{Question, Settings, TunedWall, measured, ripple, three_digits};
use haptic_host::error::Failure;
use haptic_stability::sweep::Sweep;
use serde::Serialize;

/// The scene's wall with the largest stiffness that meets all criteria.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Baseline {
    /// Settings of the scene's wall, with the largest stiffness that meets all criteria; 0 without such a stiffness.
    #[serde(flatten)]
    pub settings: Settings,
    /// Stiffness that a hand feels at rest, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
    /// Ripple at this stiffness, N.
    pub ripple_n: Option<f64>,
    /// Largest stiffness within the margins, regardless of ripple, N/m.
    pub within_margins: f64,
    /// Stiffness in the scene, N/m.
    pub as_written: f64,
}

/// Default ripple limit of a wall, N. The estimators were designed to stay below it.
pub const USUAL_RIPPLE_N: f64 = 0.1;

/// Smallest ripple limit for a scene whose wall ripples less, N.
pub const LEAST_RIPPLE_N: f64 = 0.002;

/// Returns the ripple of the wall as written in the search and on the board, N, at least [`LEAST_RIPPLE_N`].
pub fn ripple_like(question: &Question<'_>, written: &Settings, sweep: &Sweep) -> Result<(f64, f64), Failure> {
    let bound = |ripple_n: Option<f64>| ripple_n.unwrap_or(USUAL_RIPPLE_N).max(LEAST_RIPPLE_N);
    Ok((bound(ripple(question, written)?.ripple_n), bound(measured::ripple(question, written, sweep)?)))
}

/// Returns the scene's wall with the largest stiffness that meets all criteria.
pub fn baseline(question: &Question<'_>, written: &Settings, sweep: &Sweep) -> Result<Baseline, Failure> {
    let context = SearchContext::new(question, sweep)?;
    if written.loop_settings().is_none() {
        return Err(Failure::wrong(format!(
            "`{}` has no linear analysis, so margins cannot be checked",
            written.estimator
        ))
        .remedy("compare with a scene that has another estimator"));
    }
    let most = three_digits(context.largest_stiffness(written)?, true);
    let at = |stiffness: f64| -> Result<Option<TunedWall>, Failure> {
        let settings = Settings { stiffness: three_digits(stiffness, true), ..*written };
        if stiffness > 0.0 { context.check_all(&settings) } else { Ok(None) }
    };
    let passes = Option::is_some;
    let mut best = at(most)?;
    if most > 0.0 && !passes(&best) {
        // Lowers the stiffness until the wall meets the criteria, but not below a scene's stiffness that is enough.
        let (mut low, mut high) = (0.0_f64, most);
        let mut step = most;
        best = None;
        let as_written = if written.stiffness <= most { at(written.stiffness)? } else { None };
        if passes(&as_written) {
            (low, best) = (written.stiffness, as_written);
        }
        while low == 0.0 && step > 1e-3 * most {
            step /= 2.0;
            let candidate = at(step)?;
            if passes(&candidate) { (low, best) = (step, candidate) } else { high = step }
        }
        while low > 0.0 && high / low > 1.03 {
            let middle = (low * high).sqrt();
            let candidate = at(middle)?;
            if passes(&candidate) { (low, best) = (middle, candidate) } else { high = middle }
        }
    }
    let nothing = Settings { stiffness: 0.0, ..*written };
    Ok(Baseline {
        settings: best.map_or(nothing, |best| best.settings),
        felt: best.and_then(|best| context.felt_stiffness(&best.settings)),
        ripple_n: best.map(|best| best.ripple_n),
        within_margins: most,
        as_written: written.stiffness,
    })
}
