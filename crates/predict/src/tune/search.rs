//! Searches for the stiffest wall that meets all criteria.
//!
//! For each estimator, rate and cutoff, a curve is the largest stable stiffness over damping. At each damping of a
//! curve the search simulates a wall near the best so far, and makes it stiffer if it meets the criteria. It skips
//! candidates whose curve is below the best. Candidates are simulated in rounds of fixed size, so the result does not
//! depend on the number of cores.
//!
//! Around the best wall of each estimator the search continues between the grid's values. The resulting walls are
//! pressed on the simulated board, which takes longest, and made softer until they pass there too. Finally the best
//! wall is made stiffer in steps until no step meets all criteria.

use super::criteria::{Curve, SearchContext};
use super::limits::RAISE_FACTOR;
use super::{STIFFNESS_RATIO, Settings, TunedWall, choose_wall, stiffest_wall, three_digits};
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::render::velocity::{Chosen, CutoffMeaning, Estimator};
use haptic_host::error::Failure;
use std::collections::BTreeSet;

/// Cutoffs of the low-passes, Hz.
const CUTOFFS_HZ: [f64; 8] = [20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0];
/// Bandwidths of the estimators with a bandwidth, Hz.
const BANDWIDTHS_HZ: [f64; 8] = [10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 3000.0];
/// Windows of the difference estimators, samples.
const WINDOWS: [u32; 4] = [4, 8, 16, 32];
const CANDIDATES_PER_ROUND: usize = 8;
/// Share of the best stiffness down to which candidates are simulated, because they may beat the best.
const NEAR_SHARE: f64 = 0.85;
/// Like [`NEAR_SHARE`], for other feed-forwards and on the board; lower, so that there is a result to compare.
const COMPARED_SHARE: f64 = 0.7;
/// Share of the encoders' rule of thumb at which stiffness starts without an earlier result.
const FIRST_SHARE: f64 = 0.1;
/// Ratio of successive stiffnesses without an earlier result.
const STIFFNESS_STEP: f64 = 1.5;
/// Factors by which the best wall is made stiffer until no stiffer wall meets all criteria. The steps also exceed the
/// limit found earlier, because friction or a limit cycle may make a stiffer wall quieter.
const STIFFER_FACTORS: [f64; 5] = [1.5, 1.25, RAISE_FACTOR, 1.06, STIFFNESS_RATIO];
/// Maximum number of estimators around whose best wall the search continues.
const REFINED_ESTIMATORS: usize = 4;
const REFINEMENT_ROUNDS: usize = 5;
const CUTOFF_FACTORS: [f64; 5] = [1.0, 0.7, 1.4, 0.5, 2.0];
const WINDOW_FACTORS: [f64; 3] = [1.0, 0.75, 1.5];
const DAMPING_FACTORS: [f64; 7] = [1.0, 0.87, 1.15, 0.74, 1.35, 0.55, 1.8];
/// Number of walls that are pressed on the board at once.
const PRESSED_AT_ONCE: usize = 4;
const MAX_WALLS_PRESSED: usize = 12;
/// Ratio of stiffness from one press on the board to the next.
const SOFTEN_FACTOR: f64 = 1.12;
/// Corners of the washout, Hz, in descending order.
const WASHOUTS_HZ: [f64; 5] = [20.0, 10.0, 5.0, 2.0, 1.0];
/// Share of the stiffness that the washout corner must keep. The highest such corner is chosen.
const KEPT_SHARE: f64 = 0.98;

/// Results without their settings: stiffness (N/m), damping (N s/m) and ripple (N), and ripple on the board (N).
type Gains = ([f64; 3], Option<f64>);

fn to_gains(tuned: TunedWall) -> Gains {
    ([tuned.settings.stiffness, tuned.settings.damping, tuned.ripple_n], tuned.board_ripple_n)
}

fn from_gains(settings: &Settings, ([stiffness, damping, ripple_n], board_ripple_n): Gains) -> TunedWall {
    TunedWall { settings: Settings { stiffness, damping, ..*settings }, ripple_n, board_ripple_n, felt: None }
}

impl SearchContext<'_> {
    /// Returns walls that meet all criteria, and the numbers of combinations and of simulated combinations.
    pub fn search_all(&self) -> Result<(Vec<TunedWall>, (usize, usize)), Failure> {
        let mut all: Vec<TunedWall> = self.known_wall()?.into_iter().collect();
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
            // Equal curves are sorted by rate, the fastest first, because it has more reserve. The sort is stable.
            candidates.sort_by(|(one, a), (other, b)| {
                b.largest_stiffness()
                    .total_cmp(&a.largest_stiffness())
                    .then_with(|| other.rate_hz.total_cmp(&one.rate_hz))
            });
            let floor = stiffest_wall(&all).map_or(0.0, |tuned| tuned.settings.stiffness);
            let share = if feed_forward == FeedForward::Off { NEAR_SHARE } else { COMPARED_SHARE };
            let mut tuned = self.simulate(&candidates, name, share * floor, &mut looked_at.1)?;
            for (place, one) in promising_walls(&tuned).into_iter().enumerate() {
                tuned.push(self.refine(one, &format!("feed-forward {name}, {}", place + 1))?);
            }
            all.extend(tuned);
        }
        let mut all = self.soften_for_board(all)?;
        if let Some((best, _)) = choose_wall(&all) {
            all.push(self.stiffen(best)?);
        }
        Ok((all, looked_at))
    }

    /// Reduces the stiffness of the best wall of each estimator and feed-forward until it passes on the board.
    fn soften_for_board(&self, all: Vec<TunedWall>) -> Result<Vec<TunedWall>, Failure> {
        if self.question.board_ripple_n.is_none() {
            return Ok(all);
        }
        let (mut done, mut waiting): (Vec<TunedWall>, Vec<TunedWall>) =
            all.into_iter().partition(|tuned| tuned.board_ripple_n.is_some());
        waiting.sort_by(|a, b| b.settings.stiffness.total_cmp(&a.settings.stiffness));
        let mut seen = BTreeSet::new();
        waiting.retain(|tuned| seen.insert((tuned.settings.estimator, tuned.settings.feed_forward.name())));
        waiting.truncate(MAX_WALLS_PRESSED);
        for (round, some) in waiting.chunks(PRESSED_AT_ONCE).enumerate() {
            // A result well below the stiffest wall so far need not be exact.
            let floor = COMPARED_SHARE * stiffest_wall(&done).map_or(0.0, |tuned| tuned.settings.stiffness);
            let results = self.sweep.map(&format!("on the board, round {}", round + 1), some, |tuned| {
                let top = tuned.settings.stiffness;
                let softer = (0..24).map(|i| three_digits(top / SOFTEN_FACTOR.powi(i), true));
                for stiffness in softer.take_while(|stiffness| *stiffness > floor) {
                    if let Some(kept) = self.check_all(&Settings { stiffness, ..tuned.settings })? {
                        return Ok(Some(to_gains(kept)));
                    }
                }
                Ok(None)
            })?;
            let each = some.iter().zip(results);
            done.extend(each.filter_map(|(tuned, result)| Some(from_gains(&tuned.settings, result?))));
        }
        Ok(done)
    }

    /// Makes a wall stiffer until no step meets all criteria.
    fn stiffen(&self, mut tuned: TunedWall) -> Result<TunedWall, Failure> {
        let most = self.largest_stiffness(&tuned.settings)?;
        let mut round = 0;
        loop {
            round += 1;
            let higher = STIFFER_FACTORS.map(|factor| three_digits(factor * tuned.settings.stiffness, false));
            let walls: Vec<f64> = higher.into_iter().filter(|stiffness| *stiffness <= most).collect();
            let settings = tuned.settings;
            let kept = self.sweep.map(&format!("stiffer, round {round}"), &walls, |stiffness| {
                Ok(self.check_all(&Settings { stiffness: *stiffness, ..settings })?.map(to_gains))
            })?;
            match kept.into_iter().flatten().next() {
                Some(stiffer) => tuned = from_gains(&settings, stiffer),
                None => return Ok(tuned),
            }
        }
    }

    /// Returns the known settings as a wall if they meet all criteria.
    fn known_wall(&self) -> Result<Option<TunedWall>, Failure> {
        let Some(known) = self.question.known.filter(|known| known.stiffness > 0.0) else { return Ok(None) };
        self.sweep
            .map("known wall", &[known], |known| Ok(self.check_all(known)?.map(to_gains)))
            .map(|tuned| tuned.into_iter().flatten().next().map(|tuned| from_gains(&known, tuned)))
    }

    /// Returns all combinations of rate, estimator and cutoff with this feed-forward.
    fn combinations(&self, feed_forward: FeedForward) -> Vec<Settings> {
        let description = &self.question.file.description;
        let viscous = description.joints.iter().any(|joint| joint.viscous > 0.0);
        let rigid = !description.is_flexible();
        let compensations: &[bool] =
            if feed_forward != FeedForward::Off && viscous && rigid { &[false, true] } else { &[false] };
        let mut combinations = Vec::new();
        for &rate_hz in &self.question.rates_hz {
            let usual_cutoff = (0.1 * rate_hz).min(500.0);
            let mut add = |kind: Estimator, cutoff_hz: f64| {
                combinations.extend(compensations.iter().map(|&damping_compensation| Settings {
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
                    Some(spec) if spec.cutoff == CutoffMeaning::Bandwidth => {
                        BANDWIDTHS_HZ.iter().filter(below).for_each(|hz| add(kind, *hz));
                    }
                    Some(_) => WINDOWS.iter().for_each(|value| {
                        add(kind.with_options(Chosen { value: *value, filtered: false }), usual_cutoff)
                    }),
                }
            }
        }
        combinations
    }

    /// Returns the stiffest wall of a candidate that passes the ripple check, if it is stiffer than `floor` (N/m).
    fn best_of_candidate(&self, settings: &Settings, curve: &Curve, floor: f64) -> Result<Option<TunedWall>, Failure> {
        let mut best: Option<TunedWall> = None;
        for &(damping, most) in curve.points.iter().filter(|point| point.1 > 0.0) {
            let floor = best.map_or(floor, |best| best.settings.stiffness);
            let known = floor > 0.0;
            let least =
                if known { STIFFNESS_RATIO * floor } else { FIRST_SHARE * self.rule_of_thumb_stiffness.min(most) };
            let ladder = (0..if known { 1 } else { 40 }).map(|i| STIFFNESS_STEP.powi(i) * least);
            for stiffness in ladder.take_while(|stiffness| *stiffness <= most) {
                let wall = Settings { stiffness: three_digits(stiffness, true), damping, ..*settings };
                if let Some(tuned) = self.check_ripple(&wall)? {
                    best = Some(self.raise_to_limit(tuned, most)?);
                    break;
                }
            }
        }
        Ok(best)
    }

    /// Makes a wall as stiff as the ripple check allows, up to `most` (N/m).
    fn raise_to_limit(&self, mut tuned: TunedWall, most: f64) -> Result<TunedWall, Failure> {
        let mut high = None;
        loop {
            let low = tuned.settings.stiffness;
            // Ripple grows roughly in proportion to stiffness.
            let ahead = (self.question.ripple_n / tuned.ripple_n).clamp(1.06, STIFFNESS_STEP);
            let factor = high.map_or(ahead, |high: f64| (high / low).sqrt());
            let stiffness = three_digits((factor * low).min(most), true);
            if stiffness <= low || high.is_some_and(|high| high / low < STIFFNESS_RATIO) {
                return Ok(tuned);
            }
            match self.check_ripple(&Settings { stiffness, ..tuned.settings })? {
                Some(stiffer) => tuned = stiffer,
                None => high = Some(stiffness),
            }
        }
    }

    /// Simulates the best candidates until no other can be near the best wall or stiffer than `floor` (N/m).
    fn simulate(
        &self,
        candidates: &[(Settings, Curve)],
        feed_forward: &str,
        floor: f64,
        count: &mut usize,
    ) -> Result<Vec<TunedWall>, Failure> {
        let mut tuned: Vec<TunedWall> = Vec::new();
        for (round, some) in candidates.chunks(CANDIDATES_PER_ROUND).enumerate() {
            let floor = stiffest_wall(&tuned).map_or(floor, |best| floor.max(NEAR_SHARE * best.settings.stiffness));
            if some[0].1.largest_stiffness() <= floor {
                break;
            }
            let stage = format!("ripple, feed-forward {feed_forward}, round {}", round + 1);
            tuned.extend(self.best_walls(some, floor, &stage)?);
            *count += some.len();
        }
        Ok(tuned)
    }

    /// Returns the best wall of each candidate that is stiffer than `floor` (N/m).
    fn best_walls(&self, candidates: &[(Settings, Curve)], floor: f64, stage: &str) -> Result<Vec<TunedWall>, Failure> {
        let results = self.sweep.map(stage, candidates, |(settings, curve)| {
            Ok(self.best_of_candidate(settings, curve, floor)?.map(to_gains))
        })?;
        let each = candidates.iter().zip(results);
        Ok(each.filter_map(|((settings, _), result)| Some(from_gains(settings, result?))).collect())
    }

    /// Refines cutoff and damping, then chooses the highest washout corner that keeps the stiffness.
    fn refine(&self, tuned: TunedWall, stage: &str) -> Result<TunedWall, Failure> {
        let mut best = tuned;
        for round in 0..REFINEMENT_ROUNDS {
            let Settings { stiffness, damping, .. } = best.settings;
            let candidates = self.curves_near_damping(neighbours(&best.settings), damping)?;
            let there =
                self.best_walls(&candidates, stiffness, &format!("between grid values, {stage}, {}", round + 1))?;
            best = stiffest_wall([&best].into_iter().chain(&there)).unwrap_or(best);
            if best.settings.stiffness <= STIFFNESS_RATIO * stiffness {
                break;
            }
        }
        if best.settings.feed_forward == FeedForward::Washout {
            let corners = WASHOUTS_HZ.map(|washout_hz| Settings { washout_hz, ..best.settings });
            let candidates = self.curves_near_damping(corners.to_vec(), best.settings.damping)?;
            let there = self.best_walls(&candidates, 0.8 * best.settings.stiffness, &format!("washouts, {stage}"))?;
            let most = stiffest_wall([&best].into_iter().chain(&there)).map_or(0.0, |tuned| tuned.settings.stiffness);
            best = there.into_iter().find(|tuned| tuned.settings.stiffness >= KEPT_SHARE * most).unwrap_or(best);
        }
        Ok(best)
    }

    /// Returns these settings with their curves near a damping (N s/m).
    fn curves_near_damping(&self, settings: Vec<Settings>, damping: f64) -> Result<Vec<(Settings, Curve)>, Failure> {
        let dampings = DAMPING_FACTORS.map(|factor| three_digits(damping * factor, false));
        let each = settings.into_iter().map(|settings| {
            let most = self.allowed_stiffnesses(&settings, &dampings)?;
            Ok(most.map(|most| (settings, Curve { points: dampings.into_iter().zip(most).collect() })))
        });
        each.filter_map(Result::transpose).collect()
    }
}

/// Returns these settings, and settings with cutoffs or windows between the grid's values.
fn neighbours(settings: &Settings) -> Vec<Settings> {
    if settings.has_cutoff() {
        let nearby = CUTOFF_FACTORS.iter().map(|factor| three_digits(settings.cutoff_hz * factor, false));
        let nearby = nearby.filter(|hz| *hz <= 0.4 * settings.rate_hz);
        return nearby.map(|cutoff_hz| Settings { cutoff_hz, ..*settings }).collect();
    }
    let Some(key) = settings.kind.spec().and_then(|spec| spec.key) else { return vec![*settings] };
    let nearby = WINDOW_FACTORS.iter().map(|factor| (f64::from(settings.value) * factor).round() as u32);
    let nearby = nearby.filter(|value| (key.range.0..=key.range.1).contains(value));
    nearby
        .map(|value| {
            let kind = settings.kind.with_options(Chosen { value, filtered: false });
            Settings { kind, value, ..*settings }
        })
        .collect()
}

/// Returns the best walls of the estimators that are near the best of all, in descending order of stiffness.
fn promising_walls(tuned: &[TunedWall]) -> Vec<TunedWall> {
    let best = stiffest_wall(tuned).map_or(0.0, |best| best.settings.stiffness);
    let mut nearby = super::best_of_each_estimator(tuned.to_vec());
    nearby.retain(|tuned| tuned.settings.stiffness >= NEAR_SHARE * best);
    nearby.truncate(REFINED_ESTIMATORS);
    nearby
}
