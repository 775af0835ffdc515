//! Why the boundary lies where it lies: the same loop with one effect taken away, each in turn.
//!
//! An effect's share is 1 - (limit with everything)/(limit without it): negative where it helps, as a hand does.
//! Effects do not add up: two lags that each take half leave a quarter or nothing.

use serde::{Deserialize, Serialize};

use super::flexible::Hand;
use super::plant::{Drive, Linearised};
use super::range::{Domain, domain};
use super::sampled::{AnalysisError, LONGEST_DELAY, LONGEST_DIFFERENCE, LinearEstimator, Loop, Mode};
use crate::sweep::Sweep;
use haptic_host::error::Failure;

/// Factor by which the loop that stands for one without sampling is faster.
pub const FASTER: usize = 10;

/// The limits of a boundary.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Largest stiffness of all dampings, N/m.
    pub kp_max: f64,
    /// The damping that it needs, N s/m.
    pub kd: f64,
    /// Largest damping, N s/m.
    pub kd_max: f64,
    /// ∫ kp_max dkd, N² s/m².
    pub area: f64,
}

impl Limits {
    /// Of a domain; `None` where no limit was found.
    fn of(found: Result<Domain, AnalysisError>) -> Result<Option<Self>, AnalysisError> {
        let domain = match found {
            Err(AnalysisError::Unbounded) => return Ok(None),
            found => found?,
        };
        let Domain { top, .. } = domain;
        Ok(Some(Self { kp_max: top.kp, kd: top.kd, kd_max: domain.kd_max, area: domain.area }))
    }
}

/// The limits without and with the feed-forward; none where there is no limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Both {
    /// Without the feed-forward.
    pub off: Option<Limits>,
    /// With equation (4).
    pub full: Option<Limits>,
}

/// The loop without one effect.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Without {
    /// Which effect.
    pub effect: &'static str,
    /// The condition that replaces the effect.
    pub instead: &'static str,
    /// The limits then.
    pub limits: Both,
    /// The share that the effect takes of the largest stiffness without the effect: negative where it helps.
    pub takes: Shares,
    /// The same of the area.
    pub takes_area: Shares,
}

/// A share without and with the feed-forward; `None` where either limit is missing or zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shares {
    /// Without the feed-forward.
    pub off: Option<f64>,
    /// With equation (4).
    pub full: Option<f64>,
}

/// The answer of `haptic range --why`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Why {
    /// The limits with everything.
    pub limits: Both,
    /// The share of each effect.
    pub effects: Vec<Without>,
}

/// A loop and a device.
type Case = (Linearised, Loop);

/// The cases without each effect that is there.
fn cases(device: &Linearised, around: &Loop) -> Vec<(&'static str, &'static str, Case)> {
    let mut cases = Vec::new();
    let mut add = |effect, instead, device: Linearised, around: Loop| cases.push((effect, instead, (device, around)));
    let samples = around.estimator.samples();
    let delay_samples = around.delay_samples * FASTER as f64;
    if delay_samples <= LONGEST_DELAY && (samples == 1 || samples * FASTER <= LONGEST_DIFFERENCE) {
        // Everything else stays in seconds: the delay, the filter, the difference.
        let estimator = if samples > 1 { around.estimator.over(samples * FASTER) } else { around.estimator };
        let faster = Loop { rate_hz: around.rate_hz * FASTER as f64, delay_samples, estimator, ..around.clone() };
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
        let estimator = if samples > 1 { bare.over(samples) } else { bare };
        add("filter", "no filter", device.clone(), Loop { estimator, ..around.clone() });
    }
    if samples > 1 {
        let estimator = around.estimator.over(1);
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
        add("hand", "no hand", device.clone().held(Hand::default()), around.clone());
    }
    if device.viscous.iter().any(|viscous| *viscous > 0.0) {
        add("joint damping", "no joint damping", device.clone().undamped(), around.clone());
    }
    cases
}

/// The name of an effect, the condition that replaces it, and the limits then.
pub type LimitsWithout = (&'static str, &'static str, Option<Limits>);

/// The limits for one kind of feed-forward with everything, and without each effect in turn, in the order of [`why`].
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

/// The share that each effect takes of the boundary of `device` in `around`; the order is always the same.
pub fn why(device: &Linearised, around: &Loop, sweep: &Sweep) -> Result<Why, Failure> {
    let mut all = vec![("", "", (device.clone(), around.clone()))];
    all.extend(cases(device, around));
    let jobs: Vec<(&Case, Mode)> =
        all.iter().flat_map(|(_, _, case)| [Mode::Off, Mode::Full].map(|mode| (case, mode))).collect();
    let found = sweep.map("loops without one effect", &jobs, |((device, around), mode)| {
        Ok(Limits::of(domain(device, around, *mode, None))?)
    })?;
    let both = |at: usize| Both { off: found[2 * at], full: found[2 * at + 1] };
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
        Without {
            effect,
            instead,
            limits: without,
            takes: shares(|limits| limits.kp_max),
            takes_area: shares(|limits| limits.area),
        }
    });
    Ok(Why { limits, effects: effects.collect() })
}
