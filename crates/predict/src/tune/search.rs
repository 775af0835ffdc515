//! The search for the stiffest wall that keeps everything.
//!
//! For each estimator at each rate and cutoff the largest stiffness over damping is a curve. At each of its dampings a
//! wall that is near the best so far is tried, and one that keeps what is asked for is made stiffer. Candidates whose
//! curve lies below are not simulated. They are looked at in rounds of a fixed size, so the answer does not depend on
//! the number of cores. Around the best of each estimator the search goes on between the values of the grid. What it
//! finds is pressed on the simulated board, which takes longest, and made softer until it is quiet there as well; and
//! the best of all is made stiffer by steps until none keeps everything.

use super::criteria::{Curve, SearchContext};
use super::limits::MORE;
use super::{Found, STIFFNESS_RATIO, Settings, chosen, stiffest, three_digits};
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::{Chosen, CutoffMeans, Estimator};
use haptic_host::error::Failure;
use std::collections::BTreeSet;

/// Cutoffs of the low-passes, and of what has a bandwidth of its own, Hz.
const CUTOFFS_HZ: [f64; 8] = [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0];
const BANDWIDTHS_HZ: [f64; 8] = [10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 3000.0];
/// Samples of the differences.
const WINDOWS: [u32; 4] = [4, 8, 16, 32];
/// Candidates that are simulated at once.
const ROUND: usize = 8;
/// A candidate is looked at down to this share of the best so far: between the values of the grid it may be the better.
const NEAR: f64 = 0.85;
/// With another feed-forward, and on the board, the search goes down to this share of the stiffest wall so far, so that
/// there is a result to compare.
const COMPARED_SHARE: f64 = 0.7;
/// Without a result so far, walls from this share of the encoders' rule of thumb on are tried, in such steps.
const BEGIN: f64 = 0.1;
const STEP: f64 = 1.5;
/// The best of all is made stiffer by these factors until none keeps everything: friction or a limit cycle may make a
/// stiffer wall the quieter.
const HIGHER: [f64; 5] = [1.5, 1.25, MORE, 1.06, STIFFNESS_RATIO];
/// Around the best of how many estimators the search goes on, how often, and by which factors of cutoff or window, and
/// damping.
const REFINED: usize = 4;
const REFINEMENTS: usize = 5;
const CUTOFFS: [f64; 5] = [1.0, 0.7, 1.4, 0.5, 2.0];
const WIDTHS: [f64; 3] = [1.0, 0.75, 1.5];
const DAMPINGS: [f64; 7] = [1.0, 0.87, 1.15, 0.74, 1.35, 0.55, 1.8];
/// Number of walls that are pressed on the board at once and at most, and the ratio from one press to the next softer
/// one.
const PRESSED_AT_ONCE: usize = 4;
const MOST_PRESSED: usize = 12;
const SOFTER: f64 = 1.12;
/// Corners of the washout, Hz: the highest that keeps nearly all of the stiffness.
const WASHOUTS_HZ: [f64; 5] = [20.0, 10.0, 5.0, 2.0, 1.0];
const KEEPS: f64 = 0.98;

/// The results of a search beside the settings that it began with: stiffness, damping, and both ripples.
type Gains = ([f64; 3], Option<f64>);

fn gains(found: Found) -> Gains {
    ([found.settings.stiffness, found.settings.damping, found.ripple_n], found.board_ripple_n)
}

fn restored(settings: &Settings, ([stiffness, damping, ripple_n], board_ripple_n): Gains) -> Found {
    Found { settings: Settings { stiffness, damping, ..*settings }, ripple_n, board_ripple_n, felt: None }
}

impl SearchContext<'_> {
    /// Walls that keep everything, the best of all among them, and how many combinations there were and were simulated.
    pub fn all(&self) -> Result<(Vec<Found>, (usize, usize)), Failure> {
        let mut all: Vec<Found> = self.known()?.into_iter().collect();
        let mut looked_at = (0, 0);
        for &feed_forward in &self.question.feed_forwards {
            if feed_forward != FeedForward::Off && !self.is_coupled() {
                continue;
            }
            let name = feed_forward.name();
            let combinations = self.combinations(feed_forward);
            let stage = format!("walls, feed-forward {name}");
            let curves = self.sweep.map(&stage, &combinations, |settings| self.curve(settings))?;
            let mut candidates: Vec<(Settings, Curve)> =
                combinations.into_iter().zip(curves).filter_map(|(settings, curve)| Some((settings, curve?))).collect();
            looked_at.0 += candidates.len();
            // Of equal promise, the faster comes first, which has more in reserve. The sort is stable: equals stay in
            // their order.
            candidates.sort_by(|(one, a), (other, b)| {
                b.top().total_cmp(&a.top()).then_with(|| other.rate_hz.total_cmp(&one.rate_hz))
            });
            let floor = stiffest(&all).map_or(0.0, |found| found.settings.stiffness);
            let share = if feed_forward == FeedForward::Off { NEAR } else { COMPARED_SHARE };
            let mut found = self.simulated(&candidates, name, share * floor, &mut looked_at.1)?;
            for (place, one) in promising(&found).into_iter().enumerate() {
                found.push(self.refined(one, &format!("feed-forward {name}, {}", place + 1))?);
            }
            all.extend(found);
        }
        let mut all = self.on_board_too(all)?;
        if let Some((best, _)) = chosen(&all) {
            all.push(self.finished(best)?);
        }
        Ok((all, looked_at))
    }

    /// Of what was found the best of each estimator and feed-forward, as stiff as the board lets it be.
    fn on_board_too(&self, all: Vec<Found>) -> Result<Vec<Found>, Failure> {
        if self.question.board_ripple_n.is_none() {
            return Ok(all);
        }
        let (mut done, mut waiting): (Vec<Found>, Vec<Found>) =
            all.into_iter().partition(|found| found.board_ripple_n.is_some());
        waiting.sort_by(|a, b| b.settings.stiffness.total_cmp(&a.settings.stiffness));
        let mut seen = BTreeSet::new();
        waiting.retain(|found| seen.insert((found.settings.estimator, found.settings.feed_forward.name())));
        waiting.truncate(MOST_PRESSED);
        for (round, some) in waiting.chunks(PRESSED_AT_ONCE).enumerate() {
            // Results well below the stiffest so far need not be known exactly.
            let floor = COMPARED_SHARE * stiffest(&done).map_or(0.0, |found| found.settings.stiffness);
            let results = self.sweep.map(&format!("on the board, round {}", round + 1), some, |found| {
                let top = found.settings.stiffness;
                let softer = (0..24).map(|i| three_digits(top / SOFTER.powi(i), true));
                for stiffness in softer.take_while(|stiffness| *stiffness > floor) {
                    if let Some(kept) = self.kept(&Settings { stiffness, ..found.settings })? {
                        return Ok(Some(gains(kept)));
                    }
                }
                Ok(None)
            })?;
            let each = some.iter().zip(results);
            done.extend(each.filter_map(|(found, result)| Some(restored(&found.settings, result?))));
        }
        Ok(done)
    }

    /// The same wall, stiffer until it keeps everything at none of some steps.
    fn finished(&self, mut found: Found) -> Result<Found, Failure> {
        let most = self.most(&found.settings)?;
        let mut round = 0;
        loop {
            round += 1;
            let higher = HIGHER.map(|factor| three_digits(factor * found.settings.stiffness, false));
            let walls: Vec<f64> = higher.into_iter().filter(|stiffness| *stiffness <= most).collect();
            let settings = found.settings;
            let kept = self.sweep.map(&format!("stiffer, round {round}"), &walls, |stiffness| {
                Ok(self.kept(&Settings { stiffness: *stiffness, ..settings })?.map(gains))
            })?;
            match kept.into_iter().flatten().next() {
                Some(stiffer) => found = restored(&settings, stiffer),
                None => return Ok(found),
            }
        }
    }

    /// The known settings, if they keep everything.
    fn known(&self) -> Result<Option<Found>, Failure> {
        let Some(known) = self.question.known.filter(|known| known.stiffness > 0.0) else { return Ok(None) };
        self.sweep
            .map("the wall that is there", &[known], |known| Ok(self.kept(known)?.map(gains)))
            .map(|found| found.into_iter().flatten().next().map(|found| restored(&known, found)))
    }

    /// Every combination of rate, estimator and cutoff with one feed-forward.
    fn combinations(&self, feed_forward: FeedForward) -> Vec<Settings> {
        let description = &self.question.file.description;
        let viscous = description.joints.iter().any(|joint| joint.viscous > 0.0);
        let rigid = !description.is_flexible();
        let compensations: &[bool] =
            if feed_forward != FeedForward::Off && viscous && rigid { &[false, true] } else { &[false] };
        let mut found = Vec::new();
        for &rate_hz in &self.question.rates_hz {
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
            for &kind in &self.question.estimators {
                let below = |hz: &&f64| **hz <= 0.4 * rate_hz;
                match kind.spec() {
                    None if kind == Estimator::BackwardDifference => add(kind, usual_cutoff),
                    None => CUTOFFS_HZ.iter().filter(below).for_each(|hz| add(kind, *hz)),
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

    /// The stiffest wall of a candidate that is quiet and stiffer than `floor`, N/m.
    fn best_on(&self, settings: &Settings, curve: &Curve, floor: f64) -> Result<Option<Found>, Failure> {
        let mut best: Option<Found> = None;
        for &(damping, most) in curve.points.iter().filter(|point| point.1 > 0.0) {
            let floor = best.map_or(floor, |best| best.settings.stiffness);
            let known = floor > 0.0;
            let least = if known { STIFFNESS_RATIO * floor } else { BEGIN * self.steps.min(most) };
            let ladder = (0..if known { 1 } else { 40 }).map(|i| STEP.powi(i) * least);
            for stiffness in ladder.take_while(|stiffness| *stiffness <= most) {
                let wall = Settings { stiffness: three_digits(stiffness, true), damping, ..*settings };
                if let Some(found) = self.quiet(&wall)? {
                    best = Some(self.climbed(found, most)?);
                    break;
                }
            }
        }
        Ok(best)
    }

    /// A wall that is quiet, as stiff as it stays so, up to `most`, N/m.
    fn climbed(&self, mut found: Found, most: f64) -> Result<Found, Failure> {
        let mut high = None;
        loop {
            let low = found.settings.stiffness;
            // Ripple grows about as stiffness does.
            let ahead = (self.question.ripple_n / found.ripple_n).clamp(1.06, STEP);
            let factor = high.map_or(ahead, |high: f64| (high / low).sqrt());
            let stiffness = three_digits((factor * low).min(most), true);
            if stiffness <= low || high.is_some_and(|high| high / low < STIFFNESS_RATIO) {
                return Ok(found);
            }
            match self.quiet(&Settings { stiffness, ..found.settings })? {
                Some(stiffer) => found = stiffer,
                None => high = Some(stiffness),
            }
        }
    }

    /// Simulates candidates from the most promising on, until none can be near the best, or stiffer than `floor`, N/m.
    fn simulated(
        &self,
        candidates: &[(Settings, Curve)],
        feed_forward: &str,
        floor: f64,
        count: &mut usize,
    ) -> Result<Vec<Found>, Failure> {
        let mut found: Vec<Found> = Vec::new();
        for (round, some) in candidates.chunks(ROUND).enumerate() {
            let floor = stiffest(&found).map_or(floor, |best| floor.max(NEAR * best.settings.stiffness));
            if some[0].1.top() <= floor {
                break;
            }
            let stage = format!("ripple, feed-forward {feed_forward}, round {}", round + 1);
            found.extend(self.better(some, floor, &stage)?);
            *count += some.len();
        }
        Ok(found)
    }

    /// The best of each candidate that has one above `floor`, N/m.
    fn better(&self, candidates: &[(Settings, Curve)], floor: f64, stage: &str) -> Result<Vec<Found>, Failure> {
        let results = self
            .sweep
            .map(stage, candidates, |(settings, curve)| Ok(self.best_on(settings, curve, floor)?.map(gains)))?;
        let each = candidates.iter().zip(results);
        Ok(each.filter_map(|((settings, _), result)| Some(restored(settings, result?))).collect())
    }

    /// Cutoffs and dampings between those of the grid, then the highest corner of the washout that keeps the stiffness.
    fn refined(&self, found: Found, stage: &str) -> Result<Found, Failure> {
        let mut best = found;
        for round in 0..REFINEMENTS {
            let Settings { stiffness, damping, .. } = best.settings;
            let candidates = self.around_damping(neighbours(&best.settings), damping)?;
            let there = self.better(&candidates, stiffness, &format!("between, {stage}, {}", round + 1))?;
            best = stiffest([&best].into_iter().chain(&there)).unwrap_or(best);
            if best.settings.stiffness <= STIFFNESS_RATIO * stiffness {
                break;
            }
        }
        if best.settings.feed_forward == FeedForward::Washout {
            let corners = WASHOUTS_HZ.map(|washout_hz| Settings { washout_hz, ..best.settings });
            let candidates = self.around_damping(corners.to_vec(), best.settings.damping)?;
            let there = self.better(&candidates, 0.8 * best.settings.stiffness, &format!("washouts, {stage}"))?;
            let most = stiffest([&best].into_iter().chain(&there)).map_or(0.0, |found| found.settings.stiffness);
            best = there.into_iter().find(|found| found.settings.stiffness >= KEEPS * most).unwrap_or(best);
        }
        Ok(best)
    }

    /// These settings with their curves about a damping, N s/m.
    fn around_damping(&self, settings: Vec<Settings>, damping: f64) -> Result<Vec<(Settings, Curve)>, Failure> {
        let dampings = DAMPINGS.map(|factor| three_digits(damping * factor, false));
        let each = settings.into_iter().map(|settings| {
            let most = self.allowed(&settings, &dampings)?;
            Ok(most.map(|most| (settings, Curve { points: dampings.into_iter().zip(most).collect() })))
        });
        each.filter_map(Result::transpose).collect()
    }
}

/// The same settings and others with a cutoff or a window between those of the grid.
fn neighbours(settings: &Settings) -> Vec<Settings> {
    if settings.has_cutoff() {
        let near = CUTOFFS.iter().map(|factor| three_digits(settings.cutoff_hz * factor, false));
        let near = near.filter(|hz| *hz <= 0.4 * settings.rate_hz);
        return near.map(|cutoff_hz| Settings { cutoff_hz, ..*settings }).collect();
    }
    let Some(key) = settings.kind.spec().and_then(|spec| spec.key) else { return vec![*settings] };
    let near = WIDTHS.iter().map(|factor| (f64::from(settings.value) * factor).round() as u32);
    let near = near.filter(|value| (key.range.0..=key.range.1).contains(value));
    near.map(|value| {
        let kind = settings.kind.choosing(Chosen { value, filtered: false });
        Settings { kind, value, ..*settings }
    })
    .collect()
}

/// The best of each estimator that is near the best of all, the stiffest first.
fn promising(found: &[Found]) -> Vec<Found> {
    let best = stiffest(found).map_or(0.0, |best| best.settings.stiffness);
    let mut near = super::of_each_estimator(found.to_vec());
    near.retain(|found| found.settings.stiffness >= NEAR * best);
    near.truncate(REFINED);
    near
}
