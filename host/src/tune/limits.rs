//! What stops the wall that was found: what each limit alone would allow, and what lies beside it.

use super::{Found, STIFFNESS_RATIO, SearchContext, Settings, ripple, three_digits};
use crate::analysis::error::AnalysisError;
use crate::analysis::range::stiffnesses;
use crate::error::Failure;
use haptic_bridge::render::scene::FeedForward;
use serde::Serialize;

/// How much more and less is tried to say what stops it.
const MORE: f64 = 1.15;

/// What the second hand feels.
const ON_BOARD: &str = "ripple on the simulated board";
/// A limit that binds nothing, beside which the others are read.
pub const RULE_OF_THUMB: &str = "rule of thumb, encoder steps";

/// The gains that one limit alone would allow at the damping that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Which.
    pub limit: &'static str,
    /// Largest stiffness, N/m; none where it sets no bound as far as was looked.
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
    let keeps = |stiffness: f64| Ok(context.tried(settings, stiffness, settings.damping)?.is_some());
    limits.push(Limit { limit: "ripple", stiffness: rippling(settings, &[1.1, 1.2, 1.5, 2.0, 3.0, 4.0], &keeps)? });
    if question.board_ripple_n.is_some() {
        let keeps = |stiffness: f64| Ok(context.pressed_on_board(settings, stiffness)?.is_some());
        limits.push(Limit { limit: ON_BOARD, stiffness: rippling(settings, &[1.1, 1.5], &keeps)? });
    }
    let active = first(&limits, settings, context.most.1);
    limits.push(Limit { limit: RULE_OF_THUMB, stiffness: Some(context.steps) });

    let mut beside = Vec::new();
    for (stiffer, more) in [(MORE, 1.0), (1.0, MORE), (1.0, 1.0 / MORE)] {
        let stiffness = three_digits(settings.stiffness * stiffer, false);
        let damping = three_digits(settings.damping * more, false);
        let allowed = context.allowed(settings, &[damping]).is_some_and(|most| most[0] >= stiffness);
        let ripple_n = ripple(question, &Settings { stiffness, damping, ..*settings })?.ripple_n;
        beside.push(Beside { stiffness, damping, allowed, ripple_n });
    }
    Ok((active, limits, beside))
}

/// Which limit comes first when this wall is made stiffer.
fn first(limits: &[Limit], settings: &Settings, damped: f64) -> &'static str {
    let binding = ["ripple", ON_BOARD, "all margins together", "motors and encoder counts"];
    let among = limits.iter().filter(|limit| binding.contains(&limit.limit));
    let least = among.min_by(|a, b| {
        let stiffness = |limit: &Limit| limit.stiffness.unwrap_or(f64::INFINITY);
        stiffness(a).total_cmp(&stiffness(b))
    });
    let limit = least.map_or("", |limit| limit.limit);
    // More damping would let it be stiffer, and the motors do not have it.
    if limit == "all margins together" && settings.damping * STIFFNESS_RATIO > damped {
        "motors and damping"
    } else {
        limit
    }
}

/// The stiffness at which this wall first does not keep a ripple, as far as `factors` of its own are tried.
fn rippling(
    settings: &Settings,
    factors: &[f64],
    keeps: &dyn Fn(f64) -> Result<bool, Failure>,
) -> Result<Option<f64>, Failure> {
    let mut low = settings.stiffness;
    for factor in [STIFFNESS_RATIO].iter().chain(factors) {
        let mut high = factor * settings.stiffness;
        if keeps(high)? {
            low = high;
            continue;
        }
        while high / low > STIFFNESS_RATIO {
            let middle = (low * high).sqrt();
            if keeps(middle)? { low = middle } else { high = middle }
        }
        return Ok(Some(low));
    }
    Ok(None)
}
