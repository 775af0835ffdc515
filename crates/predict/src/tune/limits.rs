//! The limits of the wall that was found: what each alone would allow, and what lies beside the wall.

use super::criteria::SearchContext;
use super::{Found, STIFFNESS_RATIO, Settings, ripple, three_digits};
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_stability::analysis::error::AnalysisError;
use haptic_stability::analysis::range::stiffnesses;
use serde::Serialize;

/// Factor by which gains are raised and lowered to find the limits.
pub(super) const MORE: f64 = 1.15;

/// Limits that are looked for by simulation.
const RIPPLE: &str = "ripple";
const ON_BOARD: &str = "ripple on the simulated board";
const REBOUNDS: &str = "rebounds after a tap";
const MARGINS: &str = "all margins together";
const MOTORS: &str = "motors and encoder counts";
/// The stiffnesses at which these limits are looked for, as shares of the wall's, and those for the last limit, which
/// takes longest.
const TRIED: [f64; 7] = [STIFFNESS_RATIO, 1.06, MORE, 1.25, 1.5, 2.0, 4.0];
const TRIED_ON_BOARD: [f64; 2] = [STIFFNESS_RATIO, MORE];
/// A limit that binds nothing, beside which the others are read.
pub const RULE_OF_THUMB: &str = "rule of thumb, encoder steps";

/// The gains that one limit alone would allow at the damping that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Which.
    pub limit: &'static str,
    /// Largest stiffness, N/m; none where it sets no bound as far as was looked.
    pub stiffness: Option<f64>,
    /// The stiffness that a hand feels of that, N/m; `None` where no transmission gives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
}

/// A wall a little beside the one that was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Beside {
    /// N/m
    pub stiffness: f64,
    /// N s/m
    pub damping: f64,
    /// True if the wall is stable within the margins and the motors can render it.
    pub allowed: bool,
    /// N; none where the tip flies off.
    pub ripple_n: Option<f64>,
    /// True if a tip that taps the wall leaves it too often.
    pub rebounds: bool,
}

/// The limits of the wall: each alone, and what more damping would bring.
pub(super) fn limits(
    context: &SearchContext<'_>,
    best: &Found,
) -> Result<(&'static str, Vec<Limit>, Vec<Beside>), Failure> {
    let settings = &best.settings;
    let Some(around) = settings.around() else { return Ok(("", Vec::new(), Vec::new())) };
    let shaped = settings.feed_forward != FeedForward::Off;
    let question = context.question;
    let mut limits = Vec::new();
    let mut push = |limit, stiffness: Option<f64>| {
        let felt = stiffness.and_then(|stiffness| context.felt(&Settings { stiffness, ..*settings }));
        limits.push(Limit { limit, stiffness, felt });
    };
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
        push(limit, least.is_finite().then_some(least));
    }
    push(MOTORS, Some(context.motors.0));
    let slid = |wall: &Settings| Ok(context.slid_along(wall)?.is_some());
    push(RIPPLE, up_to(settings, &TRIED, &slid)?);
    let tapped = |wall: &Settings| context.tapped(wall);
    push(REBOUNDS, up_to(settings, &TRIED, &tapped)?);
    if let Some(bound) = question.board_ripple_n {
        let pressed = |wall: &Settings| Ok(context.on_board(wall, bound)?.is_some());
        push(ON_BOARD, up_to(settings, &TRIED_ON_BOARD, &pressed)?);
    }
    push(RULE_OF_THUMB, Some(context.steps));
    let active = first(&limits, settings, context.motors.1);

    let mut beside = Vec::new();
    for (stiffer, more) in [(MORE, 1.0), (1.0, MORE), (1.0, 1.0 / MORE)] {
        let stiffness = three_digits(settings.stiffness * stiffer, false);
        let damping = three_digits(settings.damping * more, false);
        let wall = Settings { stiffness, damping, ..*settings };
        let allowed = context.most(&wall)? >= stiffness;
        let ripple_n = ripple(question, &wall)?.ripple_n;
        beside.push(Beside { stiffness, damping, allowed, ripple_n, rebounds: !context.tapped(&wall)? });
    }
    Ok((active, limits, beside))
}

/// Which limit comes first when this wall is made stiffer.
fn first(limits: &[Limit], settings: &Settings, damped: f64) -> &'static str {
    let binding = [RIPPLE, ON_BOARD, REBOUNDS, MARGINS, MOTORS];
    let among = limits.iter().filter(|limit| binding.contains(&limit.limit));
    let least = among.min_by(|a, b| {
        let stiffness = |limit: &Limit| limit.stiffness.unwrap_or(f64::INFINITY);
        stiffness(a).total_cmp(&stiffness(b))
    });
    let limit = least.map_or("", |limit| limit.limit);
    // More damping would let it be stiffer, and the motors do not have it.
    if limit == MARGINS && settings.damping * STIFFNESS_RATIO > damped { "motors and damping" } else { limit }
}

/// The largest stiffness at which this wall still keeps something, as far as `factors` of its own are tried; none where
/// it keeps it at the last of them.
fn up_to(
    settings: &Settings,
    factors: &[f64],
    keeps: &dyn Fn(&Settings) -> Result<bool, Failure>,
) -> Result<Option<f64>, Failure> {
    let at = |stiffness: f64| keeps(&Settings { stiffness, ..*settings });
    let (mut low, mut high) = (settings.stiffness, None);
    for factor in factors {
        let stiffness = three_digits(factor * settings.stiffness, false);
        if at(stiffness)? {
            (low, high) = (stiffness, None);
        } else if high.is_none() {
            high = Some(stiffness);
        }
    }
    let Some(mut high) = high else { return Ok(None) };
    while high / low > STIFFNESS_RATIO {
        let middle = (low * high).sqrt();
        if at(middle)? { low = middle } else { high = middle }
    }
    Ok(Some(low))
}
