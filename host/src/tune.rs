//! The settings that render the stiffest wall on a device: rate, velocity estimator, cutoff, damping, stiffness,
//! washout and feed-forward, within margins, a ripple and what the motors have.
//!
//! Stability is that of the exact sampled loop ([`crate::analysis`]), for a device that is not quite the one in the
//! file ([`Margins`]). Ripple is what encoder steps make of a pressed wall, by simulation ([`ripple`]): the analysis is
//! linear and knows no steps. Levant's differentiator has no linear loop, so it is not searched.
//!
//! For each estimator at each rate and cutoff the largest stiffness over damping is a curve; at each of its dampings
//! the wall is made softer until it keeps the ripple. Candidates whose curve lies below the best that was found are not
//! simulated. They are looked at in rounds of a fixed size, so the answer does not depend on the number of cores.
//! Around the best few the search goes on between the values of the grid.
//!
//! One simulated hand is easily pleased: a wall that is quiet under it may ripple five times as much under another. So
//! the best of each estimator is pressed once more, by another hand and with everything that a board has (`confirm`),
//! and made softer until it is quiet there as well.

mod baseline;
mod confirm;
mod limits;
mod margins;
pub mod measured;
mod otherwise;
mod scene;

pub use baseline::{Baseline, LEAST_RIPPLE_N, USUAL_RIPPLE_N, baseline, ripple_like};
pub use limits::{Beside, Limit};
pub use margins::{Margins, vertex};
pub use otherwise::Otherwise;
pub use scene::to_toml;

use crate::analysis::control_loop::{CURRENT_LOOP_HZ, usual_delay};
use crate::analysis::plant::{Drive, Linearised};
use crate::analysis::pose::TaskPose;
use crate::analysis::range::{boundary_of, stiffnesses};
use crate::analysis::sampled::{LinearEstimator, Loop, Mode};
use crate::bench::estimators::{Comparison, Pressed, Shaping, pressed};
use crate::device_file::DeviceFile;
use crate::error::{Choice, Failure};
use crate::plausible::device::force_along;
use crate::sweep::Sweep;
use crate::vectors::padded_to;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::render::velocity::{Chosen, CutoffMeans, Estimator};
use limits::limits;
use margins::Corner;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The highest rate at which a board was seen to miss no period in contact, Hz (docs/results/timing.md): of the
/// emulated chip, with the shipped estimator.
pub const FASTEST_HZ: f64 = 30_000.0;
/// Rates that are searched where none are named, Hz.
pub const RATES_HZ: [f64; 4] = [1_000.0, 5_000.0, 10_000.0, 20_000.0];
/// Cutoffs of the low-passes, and of what has a bandwidth of its own, Hz.
const CUTOFFS_HZ: [f64; 8] = [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0];
const BANDWIDTHS_HZ: [f64; 6] = [10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0];
/// Samples of the differences and of the adaptive windows.
const WINDOWS: [u32; 4] = [4, 8, 16, 32];
/// Dampings of a curve, as shares of where it ends.
const DAMPINGS: usize = 12;
const SHARES: (f64, f64) = (0.03, 0.9);
/// Stiffness is found to this ratio, and of walls that differ by less the one without a feed-forward is taken.
const STIFFNESS_RATIO: f64 = 1.03;
/// Candidates whose ripple is simulated at once.
const ROUND: usize = 8;
/// Corners of the washout, Hz: the highest that keeps nearly all of the stiffness.
const WASHOUTS_HZ: [f64; 5] = [20.0, 10.0, 5.0, 2.0, 1.0];
const KEEPS: f64 = 0.98;
/// From one trial at a damping to the next softer one: more softness than stiffness is lost where friction or a limit
/// cycle makes a stiffer wall the quieter.
const SOFTER: f64 = 1.5;
/// With another feed-forward the search goes down to this share of the stiffest wall so far, so that there is a result
/// to compare.
const COMPARED_SHARE: f64 = 0.7;
/// Around how many of the best settings the search goes on, and how often.
const REFINED: usize = 3;
const REFINEMENTS: usize = 4;

/// What is asked.
#[derive(Clone, Debug)]
pub struct Question<'a> {
    /// The device.
    pub file: &'a DeviceFile,
    /// Pose, rad.
    pub q: Vec<f64>,
    /// Unit normal of the wall.
    pub normal: Vec<f64>,
    /// What a redundant device holds.
    pub admissible: Admissible,
    /// How far the device may be from its file.
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
    /// How much feed-forward.
    pub feed_forward: FeedForward,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// Whether the joints' own damping is compensated.
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

    fn mode(&self) -> Mode {
        Mode::of(self.feed_forward, self.washout_hz)
    }

    /// Whether its cutoff does anything.
    #[must_use]
    pub fn has_cutoff(&self) -> bool {
        let filtered = self.kind.chosen().is_some_and(|chosen| chosen.filtered);
        match self.kind.spec() {
            Some(spec) => filtered || spec.cutoff == CutoffMeans::Bandwidth,
            None => self.kind != Estimator::BackwardDifference,
        }
    }

    fn around(&self) -> Option<Loop> {
        Some(Loop {
            rate_hz: self.rate_hz,
            delay_samples: usual_delay(self.rate_hz),
            estimator: LinearEstimator::of(self.kind, self.cutoff_hz)?,
            drive: Drive::Current { bandwidth_hz: CURRENT_LOOP_HZ },
            damping_compensation: self.damping_compensation,
        })
    }
}

/// A wall that keeps everything that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The settings.
    #[serde(flatten)]
    pub settings: Settings,
    /// Root mean square of its force above 20 Hz under a hand that slides along it, N.
    pub ripple_n: f64,
    /// The same on the simulated board, under its hand, N; none where that was not looked at.
    pub board_ripple_n: Option<f64>,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// The stiffest; of those within three hundredths of it the stiffest without a feed-forward.
    pub best: Found,
    /// The stiffest of all, where it is another.
    pub passed_over: Option<Found>,
    /// What stops it: the limit that comes first when it is made stiffer.
    pub active: &'static str,
    /// What every limit alone would allow.
    pub limits: Vec<Limit>,
    /// What is beside it: stiffer, with more damping, with less.
    pub beside: Vec<Beside>,
    /// The best of each estimator that was found, the stiffest first.
    pub others: Vec<Found>,
    /// What the other feed-forwards would bring.
    pub feed_forwards: Vec<Otherwise>,
    /// How many combinations of rate, estimator, cutoff and feed-forward there were, and of how many ripple was
    /// simulated.
    pub looked_at: (usize, usize),
}

/// Ripple of a wall with these settings. The one place where tuning asks for it: by simulation with the steps of the
/// encoders, a quarter of a second of computing.
pub fn ripple(question: &Question<'_>, settings: &Settings) -> Result<Pressed, Failure> {
    let comparison = Comparison {
        file: question.file,
        q: &question.q,
        normal: &question.normal,
        rate_hz: settings.rate_hz,
        cutoff_hz: settings.cutoff_hz,
        wall: (settings.stiffness, settings.damping),
    };
    let shaping = Shaping {
        feed_forward: settings.feed_forward,
        washout_hz: settings.washout_hz,
        damping_compensation: settings.damping_compensation,
        admissible: question.admissible,
    };
    pressed(&comparison, settings.kind, settings.cutoff_hz, shaping)
}

/// The question with what does not change between candidates.
struct SearchContext<'a> {
    question: &'a Question<'a>,
    nominal: Linearised,
    /// Corners of the margins without and with a feed-forward.
    corners: [Vec<Corner>; 2],
    /// Largest stiffness (N/m) and damping (N s/m) for the motors.
    most: (f64, f64),
    /// Stiffness (N/m) of which encoder steps alone make all of the ripple while the tip moves evenly through them: a
    /// step in each joint is an error evenly spread over itself, 1/√12 of it, and the joints' are independent. A rule
    /// of thumb: a tip that follows the steps, or that friction holds between two, ripples less.
    steps: f64,
}

/// What a candidate can have at most: kp within the margins and the motors over damping.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Curve {
    points: Vec<(f64, f64)>,
}

impl Curve {
    fn top(&self) -> f64 {
        self.points.iter().map(|point| point.1).fold(0.0, f64::max)
    }
}

/// `value` rounded to three digits, down where `down`.
fn three_digits(value: f64, down: bool) -> f64 {
    if value <= 0.0 || !value.is_finite() {
        return value;
    }
    let unit = 10_f64.powi(2 - value.log10().floor() as i32);
    let scaled = value * unit;
    (if down { (scaled + 1e-9).floor() } else { scaled.round() }) / unit
}

impl<'a> SearchContext<'a> {
    fn new(question: &'a Question<'a>) -> Result<Self, Failure> {
        let Question { file, q, normal, admissible, .. } = question;
        let nominal = Linearised::holding(&file.description, q, normal, *admissible)?;
        let device = file.device::<f64>().map_err(Failure::wrong)?;
        let pose = TaskPose::of(&device.mechanism, q)?.regular()?;
        let force = force_along(&device, &pose, normal).ok_or_else(|| {
            Failure::wrong(format!("{} has joints without [joint.motor]", file.path.display()))
                .remedy("a wall is as stiff as motors make it: add them")
        })?;
        let steps = pose.jacobian.tr_mul(&padded_to(q.len(), normal));
        let counts = || steps.iter().zip(&device.joints).map(|(lever, joint)| (lever * joint.radians_per_count).abs());
        let count = counts().fold(0.0, f64::max);
        let spread = counts().map(|count| count * count / 12.0).sum::<f64>().sqrt();
        let corners =
            [false, true].map(|shaped| question.margins.corners(&file.description, q, normal, *admissible, shaped));
        let [off, shaped] = corners;
        Ok(Self {
            question,
            nominal,
            corners: [off?, shaped?],
            most: (force / (question.counts * count), force / question.speed),
            steps: question.ripple_n / spread,
        })
    }

    /// Whether (4) differs from Jᵀ here.
    fn is_coupled(&self) -> bool {
        self.nominal.w_eff().is_some_and(|w_eff| self.nominal.w_rr() / w_eff > 1.0 + 1e-3)
    }

    /// What is there already, if it keeps the ripple.
    fn known(&self) -> Result<Option<Found>, Failure> {
        let Some(settings) = self.question.known.filter(|known| known.stiffness > 0.0) else { return Ok(None) };
        let ripple_n = ripple(self.question, &settings)?.ripple_n;
        self.kept_on_board(ripple_n.map(|ripple_n| Found { settings, ripple_n, board_ripple_n: None }))
    }

    /// A wall that keeps the ripple, if it does so on the board as well.
    fn kept_on_board(&self, found: Option<Found>) -> Result<Option<Found>, Failure> {
        let Some(found) = found.filter(|found| found.ripple_n <= self.question.ripple_n) else { return Ok(None) };
        let Some(bound) = self.question.board_ripple_n else { return Ok(Some(found)) };
        let board_ripple_n = measured::ripple(self.question, &found.settings)?;
        Ok(board_ripple_n.is_some_and(|ripple| ripple <= bound).then_some(Found { board_ripple_n, ..found }))
    }

    fn corners(&self, settings: &Settings) -> &[Corner] {
        &self.corners[usize::from(settings.feed_forward != FeedForward::Off)]
    }

    /// kp over damping within margins and motors. Nothing where some corner is unstable at every gain, or has no bound.
    fn curve(&self, settings: &Settings) -> Option<Curve> {
        let around = settings.around()?;
        let hard = self.corners(settings).first()?;
        let (low, high) = SHARES;
        let points = boundary_of(&hard.device, &hard.believed, &hard.around(&around), settings.mode(), |end| {
            let share = |i: usize| low * (high / low).powf(i as f64 / (DAMPINGS - 1) as f64);
            let dampings = (0..DAMPINGS).map(|i| three_digits((end * share(i)).min(self.most.1), false));
            let mut dampings: Vec<f64> = dampings.collect();
            dampings.dedup();
            dampings
        });
        let dampings: Vec<f64> = points.ok()?.iter().map(|point| point.kd).collect();
        let points = self.allowed(settings, &dampings)?;
        let curve = Curve { points: dampings.into_iter().zip(points).collect() };
        (curve.top() > 0.0).then_some(curve)
    }

    /// Largest stiffness at each damping within margins and motors.
    fn allowed(&self, settings: &Settings, dampings: &[f64]) -> Option<Vec<f64>> {
        let around = settings.around()?;
        let (most, damped) = self.most;
        let mut least: Vec<f64> = dampings.iter().map(|damping| if *damping > damped { 0.0 } else { most }).collect();
        for corner in self.corners(settings) {
            let found =
                stiffnesses(&corner.device, &corner.believed, &corner.around(&around), settings.mode(), dampings);
            least.iter_mut().zip(found.ok()?).for_each(|(least, found)| *least = least.min(found));
        }
        Some(least)
    }

    /// The wall with these gains, if it keeps the ripple.
    fn tried(&self, settings: &Settings, stiffness: f64, damping: f64) -> Result<Option<Found>, Failure> {
        let settings = Settings { stiffness: three_digits(stiffness, true), damping, ..*settings };
        let Pressed { ripple_n, holds } = ripple(self.question, &settings)?;
        let found = ripple_n.filter(|ripple| holds && *ripple <= self.question.ripple_n);
        Ok(found.map(|ripple_n| Found { settings, ripple_n, board_ripple_n: None }))
    }

    /// The stiffest wall of a candidate that keeps the ripple and is stiffer than `floor` (N/m): at each damping from
    /// as stiff as margins and motors let it be down to the first that keeps the ripple, and from there up again.
    fn best_on(&self, settings: &Settings, curve: &Curve, floor: f64) -> Result<Option<Found>, Failure> {
        let mut best: Option<Found> = None;
        for &(damping, most) in &curve.points {
            let floor = best.map_or(floor, |best| best.settings.stiffness);
            let least = if floor > 0.0 { STIFFNESS_RATIO * floor } else { most / 50.0 };
            let (mut high, mut next) = (most, most);
            let mut kept = None;
            while kept.is_none() && high >= least {
                let low = if next < least { least } else { next };
                kept = self.tried(settings, low, damping)?.map(|found| (low, found));
                if kept.is_some() || low <= least {
                    break;
                }
                (high, next) = (low, low / SOFTER);
            }
            let Some((mut low, mut found)) = kept else { continue };
            while high / low > STIFFNESS_RATIO {
                let middle = (low * high).sqrt();
                match self.tried(settings, middle, damping)? {
                    Some(stiffer) => (low, found) = (middle, stiffer),
                    None => high = middle,
                }
            }
            best = Some(found);
        }
        Ok(best)
    }
}

/// Every combination of rate, estimator and cutoff with one feed-forward.
fn combinations(question: &Question<'_>, feed_forward: FeedForward) -> Vec<Settings> {
    let viscous = question.file.description.joints.iter().any(|joint| joint.viscous > 0.0);
    let rigid = !question.file.description.is_flexible();
    let compensations: &[bool] =
        if feed_forward != FeedForward::Off && viscous && rigid { &[false, true] } else { &[false] };
    let mut found = Vec::new();
    for &rate_hz in &question.rates_hz {
        let usual_cutoff = (0.1 * rate_hz).min(500.0);
        let mut add = |kind: Estimator, cutoff_hz: f64| {
            found.extend(compensations.iter().map(|&damping_compensation| Settings {
                rate_hz,
                kind,
                estimator: kind.name(),
                value: kind.chosen().map_or(0, |chosen| chosen.value),
                cutoff_hz,
                feed_forward,
                washout_hz: 2.0,
                damping_compensation,
                stiffness: 0.0,
                damping: 0.0,
            }));
        };
        for (_, kind) in Estimator::ALL {
            let kind = *kind;
            let below = |hz: &&f64| **hz <= 0.4 * rate_hz;
            match kind.spec() {
                None if kind == Estimator::BackwardDifference => add(kind, usual_cutoff),
                None => CUTOFFS_HZ.iter().filter(below).for_each(|hz| add(kind, *hz)),
                Some(_) if LinearEstimator::of(kind, usual_cutoff).is_none() => {}
                Some(spec) if spec.cutoff == CutoffMeans::Bandwidth => {
                    BANDWIDTHS_HZ.iter().filter(below).for_each(|hz| add(kind, *hz));
                }
                Some(_) => WINDOWS
                    .iter()
                    .for_each(|value| add(kind.choosing(Chosen { value: *value, filtered: false }), usual_cutoff)),
            }
        }
    }
    found
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
    check(question)?;
    let context = SearchContext::new(question)?;
    let mut all: Vec<Found> = context.known()?.into_iter().collect();
    let mut looked_at = (0, 0);
    for &feed_forward in &question.feed_forwards {
        if feed_forward != FeedForward::Off && !context.is_coupled() {
            continue;
        }
        let name = feed_forward.name();
        let combinations = combinations(question, feed_forward);
        let stage = format!("walls, feed-forward {name}");
        let curves = sweep.map(&stage, &combinations, |settings| Ok(context.curve(settings)))?;
        let mut candidates: Vec<(Settings, Curve)> =
            combinations.into_iter().zip(curves).filter_map(|(settings, curve)| Some((settings, curve?))).collect();
        looked_at.0 += candidates.len();
        // Where they promise as much the faster first, which has more in reserve. Stable: equals stay in their order.
        candidates.sort_by(|(one, a), (other, b)| {
            b.top().total_cmp(&a.top()).then_with(|| other.rate_hz.total_cmp(&one.rate_hz))
        });
        let floor = COMPARED_SHARE * stiffest(&all).map_or(0.0, |found| found.settings.stiffness);
        let mut found = simulated(&context, &candidates, feed_forward, floor, sweep, &mut looked_at.1)?;
        by_stiffness(&mut found);
        for (place, one) in found.clone().into_iter().take(REFINED).enumerate() {
            found.push(refined(&context, one, &format!("feed-forward {name}, {}", place + 1), sweep)?);
        }
        all.extend(found);
    }
    let all = confirm::confirmed(&context, all, sweep)?;
    let Some((best, passed_over)) = chosen(&all) else {
        return Err(Failure::impossible(format!(
            "no wall here keeps a ripple of {} N within the margins",
            question.ripple_n
        ))
        .remedy("ask at another pose or normal (`haptic design`), or allow more")
        .choose(Choice::Ripple));
    };
    let (active, limits, beside) = limits(&context, &best)?;
    let feed_forwards = otherwise::otherwise(&context, &best, &all)?;
    Ok(Answer { best, passed_over, active, limits, beside, others: of_each_estimator(all), feed_forwards, looked_at })
}

/// The stiffest, the earlier of equals.
fn stiffest<'a>(found: impl IntoIterator<Item = &'a Found>) -> Option<Found> {
    let stiffer = |other: &Found, best: &Found| other.settings.stiffness > best.settings.stiffness;
    found.into_iter().copied().reduce(|best, other| if stiffer(&other, &best) { other } else { best })
}

/// The stiffest first; equals stay in their order.
fn by_stiffness(found: &mut [Found]) {
    found.sort_by(|a, b| b.settings.stiffness.total_cmp(&a.settings.stiffness));
}

/// What is taken, and the stiffest where it is another: a feed-forward asks for a model that is right and pushes along
/// the wall, so one that makes no difference is left out.
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

/// Simulates candidates from the most promising on, until none can be better than the best, or than `floor`, N/m.
fn simulated(
    context: &SearchContext<'_>,
    candidates: &[(Settings, Curve)],
    feed_forward: FeedForward,
    floor: f64,
    sweep: &Sweep,
    count: &mut usize,
) -> Result<Vec<Found>, Failure> {
    let mut found: Vec<Found> = Vec::new();
    for (round, some) in candidates.chunks(ROUND).enumerate() {
        let best = stiffest(&found).map_or(floor, |found| found.settings.stiffness.max(floor));
        if some[0].1.top() <= best {
            break;
        }
        let stage = format!("ripple, feed-forward {}, round {}", feed_forward.name(), round + 1);
        let results =
            sweep.map(&stage, some, |(settings, curve)| Ok(context.best_on(settings, curve, best)?.map(kept)))?;
        *count += some.len();
        let each = some.iter().zip(results);
        found.extend(each.filter_map(|((settings, _), result)| Some(restored(settings, result?))));
    }
    Ok(found)
}

/// The parts of a result that are not in the settings that were asked for.
fn kept(found: Found) -> [f64; 3] {
    [found.settings.stiffness, found.settings.damping, found.ripple_n]
}

fn restored(settings: &Settings, [stiffness, damping, ripple_n]: [f64; 3]) -> Found {
    Found { settings: Settings { stiffness, damping, ..*settings }, ripple_n, board_ripple_n: None }
}

/// Cutoffs and dampings between those of the grid, then the highest corner of the washout that keeps the stiffness.
fn refined(context: &SearchContext<'_>, found: Found, stage: &str, sweep: &Sweep) -> Result<Found, Failure> {
    let better = |candidates: Vec<Settings>, floor: f64, stage: &str| -> Result<Vec<Found>, Failure> {
        let results = sweep.map(stage, &candidates, |settings| {
            let Some(curve) = context.curve(settings) else { return Ok(None) };
            Ok(context.best_on(settings, &curve, floor)?.map(kept))
        })?;
        let each = candidates.iter().zip(results);
        Ok(each.filter_map(|(settings, result)| Some(restored(settings, result?))).collect())
    };
    let mut best = found;
    for round in 0..REFINEMENTS {
        let before = best.settings.stiffness;
        if best.settings.has_cutoff() {
            let near = [0.45, 0.67, 1.5, 2.2].map(|factor| three_digits(best.settings.cutoff_hz * factor, false));
            let near = near.into_iter().filter(|hz| *hz <= 0.4 * best.settings.rate_hz);
            let candidates = near.map(|cutoff_hz| Settings { cutoff_hz, ..best.settings }).collect();
            let there = better(candidates, before, &format!("cutoffs, {stage}, {round}"))?;
            best = stiffest([&best].into_iter().chain(&there)).unwrap_or(best);
        }
        let near = [0.76, 0.87, 1.15, 1.32].map(|factor| three_digits(best.settings.damping * factor, false));
        let results = sweep.map(&format!("dampings, {stage}, {round}"), &near, |damping| {
            let Some(most) = context.allowed(&best.settings, &[*damping]) else { return Ok(None) };
            let curve = Curve { points: vec![(*damping, most[0])] };
            Ok(context.best_on(&best.settings, &curve, best.settings.stiffness)?.map(kept))
        })?;
        let there: Vec<Found> = results.into_iter().flatten().map(|result| restored(&best.settings, result)).collect();
        best = stiffest([&best].into_iter().chain(&there)).unwrap_or(best);
        if best.settings.stiffness <= STIFFNESS_RATIO * before {
            break;
        }
    }
    if best.settings.feed_forward == FeedForward::Washout {
        let candidates = WASHOUTS_HZ.map(|washout_hz| Settings { washout_hz, ..best.settings }).to_vec();
        let there = better(candidates, 0.8 * best.settings.stiffness, &format!("washouts, {stage}"))?;
        let most = stiffest([&best].into_iter().chain(&there)).map_or(0.0, |found| found.settings.stiffness);
        best = there.into_iter().find(|found| found.settings.stiffness >= KEEPS * most).unwrap_or(best);
    }
    Ok(best)
}

fn of_each_estimator(mut all: Vec<Found>) -> Vec<Found> {
    by_stiffness(&mut all);
    let mut best: BTreeMap<&str, usize> = BTreeMap::new();
    for (index, found) in all.iter().enumerate() {
        best.entry(found.settings.estimator).or_insert(index);
    }
    let mut indices: Vec<usize> = best.into_values().collect();
    indices.sort_unstable();
    indices.into_iter().map(|index| all[index]).collect()
}
