//! Limits of the chosen wall: the gains that each limit alone would allow, and the neighbouring walls.

use super::criteria::SearchContext;
use super::{STIFFNESS_RATIO, Settings, TunedWall, ripple, three_digits};
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_stability::analysis::error::AnalysisError;
use haptic_stability::analysis::range::stiffnesses;
use serde::Serialize;

/// Factor on a gain for the neighbouring walls.
pub(super) const RAISE_FACTOR: f64 = 1.15;

const RIPPLE_LIMIT: &str = "ripple";
const ON_BOARD_LIMIT: &str = "ripple on the simulated board";
const REBOUNDS_LIMIT: &str = "rebounds after a tap";
const MARGINS_LIMIT: &str = "all margins together";
const MOTORS_LIMIT: &str = "motors and encoder counts";
/// Factors on the wall's stiffness at which the simulated limits are checked.
const CHECKED_FACTORS: [f64; 7] = [STIFFNESS_RATIO, 1.06, RAISE_FACTOR, 1.25, 1.5, 2.0, 4.0];
/// Factors on the wall's stiffness at which the simulated board is checked; few because the board is slow.
const CHECKED_FACTORS_ON_BOARD: [f64; 2] = [STIFFNESS_RATIO, RAISE_FACTOR];
/// Name of a value that is listed for reference and is not a limit.
pub const RULE_OF_THUMB: &str = "rule of thumb, encoder steps";

/// Gains that one limit alone would allow at the damping of the wall.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Name of the limit.
    pub limit: &'static str,
    /// Largest stiffness, N/m; `None` if the limit sets no bound in the checked range.
    pub stiffness: Option<f64>,
    /// Stiffness that a hand feels at a wall of the largest stiffness, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
}

/// A wall with slightly different gains than the chosen wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NeighbourWall {
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
    /// True if the wall is stable within the margins and the motors can render it.
    pub allowed: bool,
    /// Ripple, N; `None` if the tip flies off.
    pub ripple_n: Option<f64>,
    /// True if a tip that taps the wall rebounds too often.
    pub rebounds: bool,
}

/// Computes the limits of the wall, each without the others, and the neighbouring walls.
pub(super) fn limits(
    context: &SearchContext<'_>,
    best: &TunedWall,
) -> Result<(&'static str, Vec<Limit>, Vec<NeighbourWall>), Failure> {
    let settings = &best.settings;
    let Some(around) = settings.loop_settings() else { return Ok(("", Vec::new(), Vec::new())) };
    let shaped = settings.feed_forward != FeedForward::Off;
    let question = context.question;
    let mut limits = Vec::new();
    let mut push = |limit, stiffness: Option<f64>| {
        let felt = stiffness.and_then(|stiffness| context.felt_stiffness(&Settings { stiffness, ..*settings }));
        limits.push(Limit { limit, stiffness, felt });
    };
    for (limit, margins) in question.margins.named_margins() {
        let corners =
            margins.corners(&question.file.description, &question.q, &question.normal, question.admissible, shaped)?;
        let mut least = f64::INFINITY;
        for corner in corners {
            let around = corner.adjusted_loop(&around);
            let result = stiffnesses(&corner.device, &corner.model, &around, settings.mode(), &[settings.damping]);
            match result {
                Err(AnalysisError::Unbounded) => {}
                result => least = least.min(result?[0]),
            }
        }
        push(limit, least.is_finite().then_some(least));
    }
    push(MOTORS_LIMIT, Some(context.motor_limits.0));
    let passes_ripple = |wall: &Settings| Ok(context.slide_ripple(wall)?.is_some());
    push(RIPPLE_LIMIT, largest_passing(settings, &CHECKED_FACTORS, &passes_ripple)?);
    let passes_tap = |wall: &Settings| context.passes_tap(wall);
    push(REBOUNDS_LIMIT, largest_passing(settings, &CHECKED_FACTORS, &passes_tap)?);
    if let Some(bound) = question.board_ripple_n {
        let passes_on_board = |wall: &Settings| Ok(context.board_ripple(wall, bound)?.is_some());
        push(ON_BOARD_LIMIT, largest_passing(settings, &CHECKED_FACTORS_ON_BOARD, &passes_on_board)?);
    }
    push(RULE_OF_THUMB, Some(context.rule_of_thumb_stiffness));
    let active = first_limit(&limits, settings, context.motor_limits.1);

    let mut beside = Vec::new();
    for (stiffer, more) in [(RAISE_FACTOR, 1.0), (1.0, RAISE_FACTOR), (1.0, 1.0 / RAISE_FACTOR)] {
        let stiffness = three_digits(settings.stiffness * stiffer, false);
        let damping = three_digits(settings.damping * more, false);
        let wall = Settings { stiffness, damping, ..*settings };
        let allowed = context.largest_stiffness(&wall)? >= stiffness;
        let ripple_n = ripple(question, &wall)?.ripple_n;
        beside.push(NeighbourWall { stiffness, damping, allowed, ripple_n, rebounds: !context.passes_tap(&wall)? });
    }
    Ok((active, limits, beside))
}

/// Returns the name of the limit that a stiffer wall exceeds first.
fn first_limit(limits: &[Limit], settings: &Settings, damped: f64) -> &'static str {
    let binding = [RIPPLE_LIMIT, ON_BOARD_LIMIT, REBOUNDS_LIMIT, MARGINS_LIMIT, MOTORS_LIMIT];
    let among = limits.iter().filter(|limit| binding.contains(&limit.limit));
    let least = among.min_by(|a, b| {
        let stiffness = |limit: &Limit| limit.stiffness.unwrap_or(f64::INFINITY);
        stiffness(a).total_cmp(&stiffness(b))
    });
    let limit = least.map_or("", |limit| limit.limit);
    // More damping would allow a stiffer wall, but the motors lack the torque for it.
    if limit == MARGINS_LIMIT && settings.damping * STIFFNESS_RATIO > damped { "motors and damping" } else { limit }
}

/// Returns the largest stiffness that passes a check; `None` if the wall passes at the last of `factors`.
fn largest_passing(
    settings: &Settings,
    factors: &[f64],
    passes: &dyn Fn(&Settings) -> Result<bool, Failure>,
) -> Result<Option<f64>, Failure> {
    let at = |stiffness: f64| passes(&Settings { stiffness, ..*settings });
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
