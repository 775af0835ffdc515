//! What stops the wall that was found: what each limit alone would allow, and what lies beside it.

use super::{Found, STEPS, SearchContext, Settings, ripple, three_digits};
use crate::analysis::error::AnalysisError;
use crate::analysis::range::stiffnesses;
use crate::bench::estimators::Pressed;
use crate::error::Failure;
use haptic_bridge::render::scene::FeedForward;
use serde::Serialize;

/// How much more and less is tried to say what stops it.
const MORE: f64 = 1.15;

/// The gains that one limit alone would allow at the damping that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Which.
    pub limit: &'static str,
    /// Largest stiffness, N/m; none where it sets no bound up to four times what was found.
    pub stiffness: Option<f64>,
}

/// A wall a little beside the one that was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Beside {
    /// N/m
    pub stiffness: f64,
    /// N s/m
    pub damping: f64,
    /// Whether it is stable within the margins, and the motors have it.
    pub allowed: bool,
    /// N; none where the tip flies off.
    pub ripple_n: Option<f64>,
}

/// What stops the wall: each limit alone, and what more damping would bring.
pub(super) fn limits(
    context: &SearchContext<'_>,
    best: &Found,
) -> Result<(&'static str, Vec<Limit>, Vec<Beside>), Failure> {
    let settings = &best.settings;
    let Some(around) = settings.around() else { return Ok(("", Vec::new(), Vec::new())) };
    let shaped = settings.feed_forward != FeedForward::Off;
    let question = context.question;
    let mut limits = Vec::new();
    for (limit, margins) in question.margins.alone() {
        let corners =
            margins.corners(&question.file.description, &question.q, &question.normal, question.admissible, shaped)?;
        let mut least = f64::INFINITY;
        for corner in corners {
            let around = corner.around(&around);
            let found = stiffnesses(&corner.device, &corner.believed, &around, settings.mode(), &[settings.damping]);
            match found {
                Err(AnalysisError::Unbounded) => {}
                found => least = least.min(found?[0]),
            }
        }
        limits.push(Limit { limit, stiffness: least.is_finite().then_some(least) });
    }
    limits.push(Limit { limit: "motors and encoder counts", stiffness: Some(context.most.0) });
    limits.push(Limit { limit: "ripple of encoder steps alone", stiffness: Some(context.steps) });
    limits.push(Limit { limit: "ripple", stiffness: rippling(context, settings)? });

    let mut beside = Vec::new();
    for (stiffer, more) in [(MORE, 1.0), (1.0, MORE), (1.0, 1.0 / MORE)] {
        let stiffness = three_digits(settings.stiffness * stiffer, false);
        let damping = three_digits(settings.damping * more, false);
        let allowed = context.allowed(settings, &[damping]).is_some_and(|most| most[0] >= stiffness);
        let ripple_n = ripple(question, &Settings { stiffness, damping, ..*settings })?.ripple_n;
        beside.push(Beside { stiffness, damping, allowed, ripple_n });
    }
    let most = context.allowed(settings, &[settings.damping]).map_or(0.0, |most| most[0]);
    let active = if settings.stiffness < 0.96 * most {
        "ripple"
    } else if settings.stiffness >= 0.96 * context.most.0 {
        "motors and encoder counts"
    } else if settings.stiffness >= 0.96 * STEPS * context.steps {
        "ripple of encoder steps alone"
    } else if settings.damping * MORE > context.most.1 {
        "motors and damping"
    } else {
        "all margins together"
    };
    Ok((active, limits, beside))
}

/// The stiffness at which ripple alone would end this wall: up to four times its own.
fn rippling(context: &SearchContext<'_>, settings: &Settings) -> Result<Option<f64>, Failure> {
    let keeps = |stiffness: f64| -> Result<bool, Failure> {
        let Pressed { ripple_n, holds } = ripple(context.question, &Settings { stiffness, ..*settings })?;
        Ok(holds && ripple_n.is_some_and(|ripple| ripple <= context.question.ripple_n))
    };
    let (mut low, mut high) = (settings.stiffness, 4.0 * settings.stiffness);
    if keeps(high)? {
        return Ok(None);
    }
    for _ in 0..5 {
        let middle = (low * high).sqrt();
        if keeps(middle)? { low = middle } else { high = middle }
    }
    Ok(Some(low))
}
