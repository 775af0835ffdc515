//! Explains a stability boundary by removing one effect at a time from the loop.
//!
//! An effect's share is 1 - (limit with all effects)/(limit without it). Shares interact and do not add up to 1.

use super::flexible::Hand;
use super::plant::{Drive, Linearised};
use super::range::{Domain, domain};
use super::sampled::{AnalysisError, LONGEST_DELAY, LONGEST_DIFFERENCE, LinearEstimator, Loop, Mode};
use crate::sweep::Sweep;
use haptic_host::error::Failure;
use serde::{Deserialize, Serialize};

/// Ratio of control rates for the comparison without sampling.
pub const RATE_FACTOR: usize = 10;

/// Limits of a stable domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Largest stiffness over all dampings, N/m.
    pub kp_max: f64,
    /// Damping at the largest stiffness, N s/m.
    pub kd: f64,
    /// Largest stable damping, N s/m.
    pub kd_max: f64,
    /// Area of the domain, ∫ kp_max dkd, N² s/m².
    pub area: f64,
}

impl Limits {
    /// Returns the limits of a domain, or `None` if the stiffness is unbounded.
    fn of(result: Result<Domain, AnalysisError>) -> Result<Option<Self>, AnalysisError> {
        let domain = match result {
            Err(AnalysisError::Unbounded) => return Ok(None),
            result => result?,
        };
        let Domain { top, .. } = domain;
        Ok(Some(Self { kp_max: top.kp, kd: top.kd, kd_max: domain.kd_max, area: domain.area }))
    }
}

/// Limits without and with the feed-forward; `None` if the stiffness is unbounded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LimitPair {
    /// Limits without the feed-forward.
    pub off: Option<Limits>,
    /// Limits with the feed-forward of equation (4).
    pub full: Option<Limits>,
}

/// The limits of a control loop without one effect.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WithoutEffect {
    /// Name of the effect.
    pub effect: &'static str,
    /// Condition that replaces the effect.
    pub instead: &'static str,
    /// Limits without the effect.
    pub limits: LimitPair,
    /// Share of the largest stiffness that the effect costs; negative if it helps.
    pub takes: Shares,
    /// Share of the area that the effect costs; negative if it helps.
    pub takes_area: Shares,
}

/// Shares without and with the feed-forward; `None` if a limit is missing or zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shares {
    /// Share without the feed-forward.
    pub off: Option<f64>,
    /// Share with the feed-forward of equation (4).
    pub full: Option<f64>,
}

/// The result of `haptic range --why`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EffectShares {
    /// Limits with all effects.
    pub limits: LimitPair,
    /// Shares of the effects.
    pub effects: Vec<WithoutEffect>,
}

type Case = (Linearised, Loop);

/// Returns one case per effect that is present, without this effect.
fn cases(device: &Linearised, around: &Loop) -> Vec<(&'static str, &'static str, Case)> {
    let mut cases = Vec::new();
    let mut add = |effect, instead, device: Linearised, around: Loop| cases.push((effect, instead, (device, around)));
    let samples = around.estimator.samples();
    let delay_samples = around.delay_samples * RATE_FACTOR as f64;
    if delay_samples <= LONGEST_DELAY && (samples == 1 || samples * RATE_FACTOR <= LONGEST_DIFFERENCE) {
        // Delay, filter and window keep their lengths in seconds.
        let estimator =
            if samples > 1 { around.estimator.with_window(samples * RATE_FACTOR) } else { around.estimator };
        let faster = Loop { rate_hz: around.rate_hz * RATE_FACTOR as f64, delay_samples, estimator, ..around.clone() };
        add("sampling", "ten times the rate", device.clone(), faster);
    }
    if around.delay_samples > 0.0 {
        add("delay", "no delay", device.clone(), Loop { delay_samples: 0.0, ..around.clone() });
    }
    if around.drive != Drive::Ideal {
        add("drive", "torque at once", device.clone(), Loop { drive: Drive::Ideal, ..around.clone() });
    }
    if around.estimator.cutoff_hz().is_some() {
        let bare = LinearEstimator::BackwardDifference;
        let estimator = if samples > 1 { bare.with_window(samples) } else { bare };
        add("filter", "no filter", device.clone(), Loop { estimator, ..around.clone() });
    }
    if samples > 1 {
        let estimator = around.estimator.with_window(1);
        add("difference", "over one sample", device.clone(), Loop { estimator, ..around.clone() });
    }
    if device.flexible.transmissions.iter().any(Option::is_some) {
        let mut rigid = device.clone();
        rigid.flexible.transmissions.clear();
        add("compliance", "rigid transmissions", rigid, around.clone());
    }
    if !device.flexible.modes.is_empty() {
        let mut still = device.clone();
        still.flexible.modes.clear();
        add("structure", "no structural modes", still, around.clone());
    }
    if device.flexible.posture.is_some() {
        let mut free = device.clone();
        free.flexible.posture = None;
        add("posture", "no posture", free, around.clone());
    }
    if device.flexible.hand.is_there() {
        add("hand", "no hand", device.clone().with_hand(Hand::default()), around.clone());
    }
    if device.viscous.iter().any(|viscous| *viscous > 0.0) {
        add("joint damping", "no joint damping", device.clone().undamped(), around.clone());
    }
    cases
}

/// Name of an effect, the replacing condition, and the limits without the effect.
pub type LimitsWithout = (&'static str, &'static str, Option<Limits>);

/// Returns the limits for one feed-forward, with all effects and without each, in the order of [`explain_boundary`].
pub fn limits_without(
    device: &Linearised,
    around: &Loop,
    mode: Mode,
) -> Result<(Option<Limits>, Vec<LimitsWithout>), AnalysisError> {
    let limits = |device: &Linearised, around: &Loop| Limits::of(domain(device, around, mode, None));
    let without = cases(device, around)
        .into_iter()
        .map(|(effect, instead, (device, around))| Ok((effect, instead, limits(&device, &around)?)));
    Ok((limits(device, around)?, without.collect::<Result<_, AnalysisError>>()?))
}

/// Computes the share of each effect in the boundary of `device` in `around`, always in the same order.
pub fn explain_boundary(device: &Linearised, around: &Loop, sweep: &Sweep) -> Result<EffectShares, Failure> {
    let mut all = vec![("", "", (device.clone(), around.clone()))];
    all.extend(cases(device, around));
    let jobs: Vec<(&Case, Mode)> =
        all.iter().flat_map(|(_, _, case)| [Mode::Off, Mode::Full].map(|mode| (case, mode))).collect();
    let results = sweep.map("loops without one effect", &jobs, |((device, around), mode)| {
        Ok(Limits::of(domain(device, around, *mode, None))?)
    })?;
    let both = |at: usize| LimitPair { off: results[2 * at], full: results[2 * at + 1] };
    let limits = both(0);
    let share = |with: Option<Limits>, without: Option<Limits>, of: fn(&Limits) -> f64| {
        let (with, without) = (of(&with?), of(&without?));
        (without > 0.0).then(|| 1.0 - with / without)
    };
    let effects = all.iter().enumerate().skip(1).map(|(at, (effect, instead, _))| {
        let without = both(at);
        let shares = |of: fn(&Limits) -> f64| Shares {
            off: share(limits.off, without.off, of),
            full: share(limits.full, without.full, of),
        };
        WithoutEffect {
            effect,
            instead,
            limits: without,
            takes: shares(|limits| limits.kp_max),
            takes_area: shares(|limits| limits.area),
        }
    });
    Ok(EffectShares { limits, effects: effects.collect() })
}
