//! Finds the settings of the stiffest wall on a device (rate, velocity estimator, cutoff, damping, stiffness, washout
//! and feed-forward) within margins, a ripple limit and the motors' torque.
//!
//! The exact sampled loop ([`haptic_stability::analysis`]) decides stability, for devices that deviate from the file
//! ([`Margins`]). A simulation ([`crate::bench::wall`]) computes the ripple that encoder steps cause on a pressed wall,
//! because the analysis is linear, for the device in the file and for deviating ones.
//!
//! A single simulated hand may hide ripple, so a second hand presses the wall on a complete simulated board
//! ([`measured`]). A tip that taps the wall may rebound at most [`MAX_REBOUNDS`] times. `criteria` contains all
//! criteria, and `search` finds the stiffest wall that meets them.

mod alternatives;
mod baseline;
mod criteria;
mod limits;
mod margins;
pub mod measured;

mod scene;
mod search;

use crate::bench::wall::RenderedWall;
pub use alternatives::Alternative;
pub use baseline::{Baseline, LEAST_RIPPLE_N, USUAL_RIPPLE_N, baseline, ripple_like};
use criteria::SearchContext;
pub use criteria::{MAX_REBOUNDS, accepted_wall, ripple};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::render::velocity::{CutoffMeaning, Estimator};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Choice, Failure};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
use haptic_stability::sweep::Sweep;
use limits::limits;
pub use limits::{Limit, NeighbourWall};
pub use margins::{Margins, extreme_device};
pub use scene::to_toml;
use serde::Serialize;
use std::collections::BTreeSet;

/// Highest rate at which the emulated chip missed no period in contact, Hz (docs/results/timing.md).
pub const FASTEST_HZ: f64 = 30_000.0;
/// Rates that are searched by default, Hz.
pub const RATES_HZ: [f64; 4] = [1_000.0, 5_000.0, 10_000.0, 20_000.0];
/// Ratio below which two stiffnesses count as equal. Of equal walls the one without feed-forward is chosen.
const STIFFNESS_RATIO: f64 = 1.03;

/// Request to [`tune`].
#[derive(Clone, Debug)]
pub struct Question<'a> {
    /// Device file.
    pub file: &'a DeviceFile,
    /// Pose, rad.
    pub q: Vec<f64>,
    /// Unit normal of the wall.
    pub normal: Vec<f64>,
    /// The coordinate that the feed-forward of a redundant device holds.
    pub admissible: Admissible,
    /// Deviations of the device from its file that the wall must tolerate.
    pub margins: Margins,
    /// Largest root mean square of the force above 20 Hz while a hand slides along the wall, N.
    pub ripple_n: f64,
    /// Ripple limit on the simulated board with its hand, N; `None` skips that simulation.
    pub board_ripple_n: Option<f64>,
    /// Smallest penetration at which the wall may need all of the motors' torque, encoder counts.
    pub counts: f64,
    /// Speed at which the wall's damping alone may need all of the motors' torque, m/s.
    pub speed: f64,
    /// Control rates, Hz.
    pub rates_hz: Vec<f64>,
    /// Velocity estimators. The search chooses their parameters and cutoffs.
    pub estimators: Vec<Estimator>,
    /// Allowed feed-forwards.
    pub feed_forwards: Vec<FeedForward>,
    /// Known settings within the margins; the result is at least as stiff.
    pub known: Option<Settings>,
}

/// All settings of a wall except its position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Velocity estimator with its parameter.
    #[serde(skip)]
    pub kind: Estimator,
    /// Name of the estimator.
    pub estimator: &'static str,
    /// Parameter of the estimator; 0 without a parameter.
    pub value: u32,
    /// Cutoff of the estimator, Hz.
    pub cutoff_hz: f64,
    /// Feed-forward of the wall.
    pub feed_forward: FeedForward,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// True if the joints' own damping is compensated.
    pub damping_compensation: bool,
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
}

impl Settings {
    /// Returns the settings of a wall in a scene; `None` if there is no such wall.
    #[must_use]
    pub fn of(scene: &Scene<f64>, wall: usize) -> Option<Self> {
        let wall = scene.walls.get(wall)?;
        Some(Self {
            rate_hz: scene.rate_hz,
            kind: scene.estimator,
            estimator: scene.estimator.name(),
            value: scene.estimator.chosen().map_or(0, |chosen| chosen.value),
            cutoff_hz: scene.cutoff_hz,
            feed_forward: wall.feed_forward,
            washout_hz: wall.washout_hz,
            damping_compensation: wall.damping_compensation,
            stiffness: wall.stiffness,
            damping: wall.damping,
        })
    }

    pub(crate) fn rendered_wall(&self, admissible: Admissible) -> RenderedWall {
        RenderedWall {
            kind: self.kind,
            cutoff_hz: self.cutoff_hz,
            feed_forward: self.feed_forward,
            washout_hz: self.washout_hz,
            damping_compensation: self.damping_compensation,
            admissible,
            stiffness: self.stiffness,
            damping: self.damping,
        }
    }

    fn mode(&self) -> Mode {
        Mode::of(self.feed_forward, self.washout_hz)
    }

    /// Returns true if the estimator uses the cutoff.
    #[must_use]
    pub fn has_cutoff(&self) -> bool {
        let filtered = self.kind.chosen().is_some_and(|chosen| chosen.filtered);
        match self.kind.spec() {
            Some(spec) => filtered || spec.cutoff == CutoffMeaning::Bandwidth,
            None => self.kind != Estimator::BackwardDifference,
        }
    }

    /// Returns the control loop of a board with these settings; `None` if the estimator has no linear model.
    fn loop_settings(&self) -> Option<Loop> {
        let estimator = LinearEstimator::of(self.kind, self.cutoff_hz)?;
        let around = Loop::with_torque_path(&TorquePath::usual(self.rate_hz), self.rate_hz, estimator);
        Some(Loop { damping_compensation: self.damping_compensation, ..around })
    }
}

/// A wall that meets all criteria.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TunedWall {
    /// Settings of the wall.
    #[serde(flatten)]
    pub settings: Settings,
    /// Largest root mean square of the force above 20 Hz under a sliding hand over all tested devices, N.
    pub ripple_n: f64,
    /// Ripple on the simulated board with its hand, N; `None` if it was not simulated.
    pub board_ripple_n: Option<f64>,
    /// Stiffness that a hand feels at rest, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TuneResult {
    /// The stiffest wall, or the stiffest wall without feed-forward if that is within 3 %.
    pub best: TunedWall,
    /// The stiffest wall if `best` is another wall.
    pub passed_over: Option<TunedWall>,
    /// Name of the limit that a stiffer wall exceeds first.
    pub active: &'static str,
    /// Gains that each limit alone would allow.
    pub limits: Vec<Limit>,
    /// Neighbouring walls: stiffer, with more damping, and with less damping.
    pub beside: Vec<NeighbourWall>,
    /// The stiffest wall of each estimator, in descending order of stiffness.
    pub others: Vec<TunedWall>,
    /// Results with the other feed-forwards.
    pub feed_forwards: Vec<Alternative>,
    /// Number of combinations of rate, estimator, cutoff and feed-forward, and number of these that were simulated.
    pub looked_at: (usize, usize),
}

/// Rounds `value` to three digits; towards zero if `down`.
pub(crate) fn three_digits(value: f64, down: bool) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return value;
    }
    let unit = 10_f64.powi(2 - value.log10().floor() as i32);
    let scaled = value * unit;
    (if down { (scaled + 1e-9).floor() } else { scaled.round() }) / unit
}

/// Returns the velocity estimators that can be searched, with default parameters.
#[must_use]
pub fn estimators() -> Vec<Estimator> {
    let all = Estimator::ALL.iter().map(|(_, kind)| *kind);
    all.filter(|kind| LinearEstimator::of(*kind, 1.0).is_some()).collect()
}

/// Rejects requests that no board can meet.
fn check(question: &Question<'_>) -> Result<(), Failure> {
    if let Some(rate) = question.rates_hz.iter().find(|rate| !(200.0..=FASTEST_HZ).contains(*rate)) {
        return Err(Failure::wrong(format!("no board has kept up with {rate} Hz in contact"))
            .remedy(format!("write rates from 200 to {FASTEST_HZ} Hz")));
    }
    let sizes = [question.ripple_n, question.counts, question.speed];
    if sizes.iter().any(|size| !(size.is_finite() && *size > 0.0)) {
        return Err(Failure::wrong("ripple, counts and speed must be positive"));
    }
    question.margins.check()
}

/// Searches for the stiffest wall. The result does not depend on the number of cores.
pub fn tune(question: &Question<'_>, sweep: &Sweep) -> Result<TuneResult, Failure> {
    let context = SearchContext::new(question, sweep)?;
    let (mut all, looked_at) = context.search_all()?;
    all.iter_mut().for_each(|candidate| candidate.felt = context.felt_stiffness(&candidate.settings));
    let Some((best, passed_over)) = choose_wall(&all) else {
        return Err(Failure::impossible(format!(
            "no wall here is stable within the margins and ripples by at most {} N",
            question.ripple_n
        ))
        .remedy("choose another pose or normal (`haptic design`), or allow more ripple")
        .choose(Choice::Ripple));
    };
    let (active, limits, beside) = sweep.run_stage("limits of the wall", || limits(&context, &best))?;
    let feed_forwards = sweep.run_stage("other feed-forwards", || alternatives::alternatives(&context, &best, &all))?;
    Ok(TuneResult {
        best,
        passed_over,
        active,
        limits,
        beside,
        others: best_of_each_estimator(all),
        feed_forwards,
        looked_at,
    })
}

/// Returns the stiffest wall; the first of equally stiff walls.
fn stiffest_wall<'a>(walls: impl IntoIterator<Item = &'a TunedWall>) -> Option<TunedWall> {
    let stiffer = |other: &TunedWall, best: &TunedWall| other.settings.stiffness > best.settings.stiffness;
    walls.into_iter().copied().reduce(|best, other| if stiffer(&other, &best) { other } else { best })
}

/// Returns the chosen wall, and the stiffest wall if that is another wall. A feed-forward needs a correct model
/// and pushes along the wall, so a wall without feed-forward is chosen if it is equally stiff.
fn choose_wall(all: &[TunedWall]) -> Option<(TunedWall, Option<TunedWall>)> {
    let top = stiffest_wall(all)?;
    let plain = stiffest_wall(all.iter().filter(|candidate| candidate.settings.feed_forward == FeedForward::Off));
    match plain {
        Some(plain) if plain.settings.stiffness * STIFFNESS_RATIO >= top.settings.stiffness => {
            Some((plain, (plain != top).then_some(top)))
        }
        _ => Some((top, None)),
    }
}

/// Returns the stiffest wall of each estimator in descending order of stiffness; equally stiff walls keep their order.
fn best_of_each_estimator(mut all: Vec<TunedWall>) -> Vec<TunedWall> {
    all.sort_by(|a, b| b.settings.stiffness.total_cmp(&a.settings.stiffness));
    let mut seen = BTreeSet::new();
    all.retain(|candidate| seen.insert(candidate.settings.estimator));
    all
}
