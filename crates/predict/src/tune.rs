//! The settings that render the stiffest wall on a device: rate, velocity estimator, cutoff, damping, stiffness,
//! washout and feed-forward, within margins, a ripple and what the motors have.
//!
//! Stability is that of the exact sampled loop ([`haptic_stability::analysis`]), for a device that is not quite the one
//! in the file ([`Margins`]). Ripple is what encoder steps make of a pressed wall, by simulation
//! ([`crate::bench::wall`]), on that device and on others a little off it: the analysis is linear and knows no steps.
//! One simulated hand is easily pleased, so the wall is pressed once more by another one, with everything that a board
//! has ([`measured`]). And a tip that taps it leaves it no more than [`MOST_REBOUNDS`] times. `criteria` has them all,
//! and `search` finds the stiffest wall that keeps them.

mod baseline;
mod criteria;
mod limits;
mod margins;
pub mod measured;
mod otherwise;
mod scene;
mod search;

pub use baseline::{Baseline, LEAST_RIPPLE_N, USUAL_RIPPLE_N, baseline, ripple_like};
pub use criteria::{MOST_REBOUNDS, keeps, ripple};
pub use limits::{Beside, Limit};
pub use margins::{Margins, vertex};
pub use otherwise::Otherwise;
pub use scene::to_toml;

use crate::bench::wall::Rendered;
use criteria::SearchContext;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::render::velocity::{CutoffMeans, Estimator};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Choice, Failure};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
use haptic_stability::sweep::Sweep;
use limits::limits;
use serde::Serialize;
use std::collections::BTreeSet;

/// The highest rate at which a board was seen to miss no period in contact, Hz (docs/results/timing.md): of the
/// emulated chip, with the shipped estimator.
pub const FASTEST_HZ: f64 = 30_000.0;
/// Rates that are searched where none are named, Hz.
pub const RATES_HZ: [f64; 4] = [1_000.0, 5_000.0, 10_000.0, 20_000.0];
/// Stiffness is found to this ratio, and of walls that differ by less the one without a feed-forward is taken.
const STIFFNESS_RATIO: f64 = 1.03;

/// The question to answer.
#[derive(Clone, Debug)]
pub struct Question<'a> {
    /// The device.
    pub file: &'a DeviceFile,
    /// Pose, rad.
    pub q: Vec<f64>,
    /// Unit normal of the wall.
    pub normal: Vec<f64>,
    /// The coordinate that a redundant device holds.
    pub admissible: Admissible,
    /// The deviations of the device from its file that are allowed for.
    pub margins: Margins,
    /// Largest root mean square of what the force of a wall has above 20 Hz under a hand that slides along it, N.
    pub ripple_n: f64,
    /// The same on the simulated board, under its hand, N; `None` leaves that press out.
    pub board_ripple_n: Option<f64>,
    /// Encoder counts into the wall at which the motors may give all that they have; more is finer.
    pub counts: f64,
    /// Speed at which the wall's damping alone may take all that the motors have, m/s.
    pub speed: f64,
    /// Control rates, Hz.
    pub rates_hz: Vec<f64>,
    /// Velocity estimators; their own values and cutoffs are sought.
    pub estimators: Vec<Estimator>,
    /// Which feed-forwards may be taken.
    pub feed_forwards: Vec<FeedForward>,
    /// Settings with stiffness and damping that are there already and keep the margins: no answer is softer.
    pub known: Option<Settings>,
}

/// Everything about a wall that is not where it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Velocity estimator, with its own value.
    #[serde(skip)]
    pub kind: Estimator,
    /// Its word.
    pub estimator: &'static str,
    /// Its own value, 0 where it takes none.
    pub value: u32,
    /// Hz.
    pub cutoff_hz: f64,
    /// The wall's feed-forward.
    pub feed_forward: FeedForward,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// True if the joints' own damping is compensated.
    pub damping_compensation: bool,
    /// N/m
    pub stiffness: f64,
    /// N s/m
    pub damping: f64,
}

impl Settings {
    /// Those of a wall in a scene.
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

    pub(crate) fn rendered(&self, admissible: Admissible) -> Rendered {
        Rendered {
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

    /// Returns true if its cutoff has an effect.
    #[must_use]
    pub fn has_cutoff(&self) -> bool {
        let filtered = self.kind.chosen().is_some_and(|chosen| chosen.filtered);
        match self.kind.spec() {
            Some(spec) => filtered || spec.cutoff == CutoffMeans::Bandwidth,
            None => self.kind != Estimator::BackwardDifference,
        }
    }

    /// The loop of the boards around it; none where the estimator has no linear one.
    fn around(&self) -> Option<Loop> {
        let estimator = LinearEstimator::of(self.kind, self.cutoff_hz)?;
        let around = Loop::through(&TorquePath::usual(self.rate_hz), self.rate_hz, estimator);
        Some(Loop { damping_compensation: self.damping_compensation, ..around })
    }
}

/// A wall that keeps everything that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The settings.
    #[serde(flatten)]
    pub settings: Settings,
    /// Root mean square of its force above 20 Hz under a hand that slides along it, N: the largest of the device in the
    /// file and those that are a little off it.
    pub ripple_n: f64,
    /// The same on the simulated board with the device in the file, under its hand, N; none where that was not looked
    /// at.
    pub board_ripple_n: Option<f64>,
    /// The stiffness that a hand at the tip feels of it at rest, N/m; `None` where no transmission gives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// The stiffest; of those within three hundredths of it the stiffest without a feed-forward.
    pub best: Found,
    /// The stiffest of all, where it is another.
    pub passed_over: Option<Found>,
    /// The limit that comes first when the wall is made stiffer.
    pub active: &'static str,
    /// The gains that every limit alone would allow.
    pub limits: Vec<Limit>,
    /// The walls beside it: stiffer, with more damping, with less.
    pub beside: Vec<Beside>,
    /// The best of each estimator that was found, the stiffest first.
    pub others: Vec<Found>,
    /// The results with the other feed-forwards.
    pub feed_forwards: Vec<Otherwise>,
    /// Number of combinations of rate, estimator, cutoff and feed-forward, and the number of those for which ripple was
    /// simulated.
    pub looked_at: (usize, usize),
}

/// `value` rounded to three digits, down where `down`.
pub(crate) fn three_digits(value: f64, down: bool) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return value;
    }
    let unit = 10_f64.powi(2 - value.log10().floor() as i32);
    let scaled = value * unit;
    (if down { (scaled + 1e-9).floor() } else { scaled.round() }) / unit
}

/// The velocity estimators that can be searched, each as it is where no more than its name is said.
#[must_use]
pub fn estimators() -> Vec<Estimator> {
    let all = Estimator::ALL.iter().map(|(_, kind)| *kind);
    all.filter(|kind| LinearEstimator::of(*kind, 1.0).is_some()).collect()
}

/// Refuses what no board does.
fn check(question: &Question<'_>) -> Result<(), Failure> {
    if let Some(rate) = question.rates_hz.iter().find(|rate| !(200.0..=FASTEST_HZ).contains(*rate)) {
        return Err(Failure::wrong(format!("no board was seen to hold {rate} Hz in contact"))
            .remedy(format!("write rates from 200 to {FASTEST_HZ} Hz")));
    }
    let sizes = [question.ripple_n, question.counts, question.speed];
    if sizes.iter().any(|size| !(size.is_finite() && *size > 0.0)) {
        return Err(Failure::wrong("ripple, counts and speed must be positive"));
    }
    question.margins.check()
}

/// Searches. The same in any order of work.
pub fn tune(question: &Question<'_>, sweep: &Sweep) -> Result<Answer, Failure> {
    let context = SearchContext::new(question, sweep)?;
    let (mut all, looked_at) = context.all()?;
    all.iter_mut().for_each(|found| found.felt = context.felt(&found.settings));
    let Some((best, passed_over)) = chosen(&all) else {
        return Err(Failure::impossible(format!(
            "no wall here keeps a ripple of {} N within the margins",
            question.ripple_n
        ))
        .remedy("ask at another pose or normal (`haptic design`), or allow more")
        .choose(Choice::Ripple));
    };
    let (active, limits, beside) = sweep.during("what limits it", || limits(&context, &best))?;
    let feed_forwards = sweep.during("other feed-forwards", || otherwise::otherwise(&context, &best, &all))?;
    Ok(Answer { best, passed_over, active, limits, beside, others: of_each_estimator(all), feed_forwards, looked_at })
}

/// The stiffest, the earlier of equals.
fn stiffest<'a>(found: impl IntoIterator<Item = &'a Found>) -> Option<Found> {
    let stiffer = |other: &Found, best: &Found| other.settings.stiffness > best.settings.stiffness;
    found.into_iter().copied().reduce(|best, other| if stiffer(&other, &best) { other } else { best })
}

/// The settings that are chosen, and the stiffest where they are others: a feed-forward asks for a model that is right
/// and pushes along the wall, so one that makes no difference is left out.
fn chosen(all: &[Found]) -> Option<(Found, Option<Found>)> {
    let top = stiffest(all)?;
    let plain = stiffest(all.iter().filter(|found| found.settings.feed_forward == FeedForward::Off));
    match plain {
        Some(plain) if plain.settings.stiffness * STIFFNESS_RATIO >= top.settings.stiffness => {
            Some((plain, (plain != top).then_some(top)))
        }
        _ => Some((top, None)),
    }
}

/// The stiffest of each estimator, the stiffest first; equals stay in their order.
fn of_each_estimator(mut all: Vec<Found>) -> Vec<Found> {
    all.sort_by(|a, b| b.settings.stiffness.total_cmp(&a.settings.stiffness));
    let mut seen = BTreeSet::new();
    all.retain(|found| seen.insert(found.settings.estimator));
    all
}
