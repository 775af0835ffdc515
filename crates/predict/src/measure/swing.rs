//! The verdict on a motion: it dies out, it builds up, or it goes on as a vibration of constant size. Judged from
//! sampled positions alone.
//!
//! The position is high-passed below the velocity filter's cutoff, because a slow return to the wall would hide a small
//! fast oscillation; an oscillation of a rigid device's loop lies below that cutoff and seldom far below it. The swing
//! between two turning points then grows or shrinks by a constant factor for every half cycle of the dominant mode, and
//! the slope of a straight line through its logarithm, against that slope's own uncertainty, tells which.
//!
//! **Several modes.** A device with a transmission that gives has modes on both sides of the cutoff, and a washout one
//! far below it. Two modes of like size make a tiny swing now and then, where the slow one turns and the fast one holds
//! against it: so a motion has died out when half a look of swings is small, not one. Their beat hides the trend of
//! single swings; the largest of every few, over at least three turns of the slowest, then shows it. If one of them
//! decays faster than the other, the trend bends as if the motion were settling at a constant size: such a motion is
//! followed until it settles or dies out. And a small fast mode that builds up hides behind a large slow one that dies
//! out: so the motion's acceleration, in which it is larger by the square of their frequencies' ratio, is judged beside
//! it.
//!
//! **What encoder steps explain.** A quantiser in a stable loop can sustain a vibration. Its describing function, the
//! share of a sine's first harmonic that it passes on, is at most 1.0365 for a sine that spans six steps and falls from
//! there (1.023 at eight): a vibration of more than [`ENCODER_STEPS`] steps from peak to peak can last only where 3.6 %
//! more gain would make the loop unstable without any steps. So what is larger counts as not stable, at the price of a
//! boundary that is found at most 3.6 % low; what is smaller is what any loop with these encoders does at rest.

use std::f64::consts::TAU;

/// Peak-to-peak size of the largest vibration that encoder steps explain, in steps.
pub const ENCODER_STEPS: f64 = 6.0;

/// Corner of the high-pass as a share of the velocity filter's cutoff.
const HIGH_PASS_SHARE: f64 = 0.125;
/// Turning points left out at the start, while faster modes die out.
const SETTLING: usize = 8;
/// Turning points of one look at the trend.
const LOOK: usize = 22;
/// Looks after which what neither grows nor shrinks is a vibration: of the place, and of the bend, whose swings are
/// quicker.
const LOOKS: (usize, usize) = (4, 16);
/// Swings of which the largest counts where two modes beat: more than the shares of a beat between two modes that lie
/// this far apart, which is farther than a wall's own mode and a cable's.
const BEAT: usize = 6;
/// Turns of the slowest mode that a look lasts at least which tells that a motion dies out, and that a stretch does.
const TURNS: f64 = 3.0;
/// The latest swings are judged in at least so many stretches.
const STRETCHES: usize = 8;
/// A motion whose trend bends is followed this many times as long as it takes to call a straight one a vibration.
const PATIENCE: usize = 16;
/// A swing of less than this share of those before it is a faster mode's ripple on them.
const RIPPLE_SHARE: f64 = 0.4;
/// Standard errors by which a slope must differ from zero to be one. Many, as encoder steps disturb neighbouring swings
/// alike, which the standard error does not know.
const SIGNIFICANT: f64 = 4.0;
/// Slope, in parts per swing, below which a motion goes on: 0.4 % over one look.
const FLAT_SLOPE: f64 = 2e-4;
/// Growth over the first swings, and over the pull, at which the verdict does not wait for the trend.
const RUNAWAY_GROWTH: f64 = 4.0;
/// Farthest distance from the wall that is still a trial, in pulls, and of long pulls beyond two of them, m: what has
/// left that far builds up, and is caught in its pose.
const FARTHEST_PULLS: f64 = 12.0;
const FARTHEST: f64 = 0.005;
/// Share of the largest swing below which a motion has died out.
const DIED_OUT_SHARE: f64 = 0.02;
/// Periods of the cutoff without a turning point after which a motion is over: at least, and at most where a slower
/// mode is expected.
const SILENT_PERIODS: (f64, f64) = (10.0, 200.0);

/// The course of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// It dies out, or what is left of it is no more than encoder steps explain.
    Decays,
    /// It builds up: the loop oscillates.
    Grows,
    /// It goes on at this size (m, from peak to peak), more than encoder steps explain: not stable either.
    Vibrates(f64),
}

/// A motion being followed.
#[derive(Clone, Debug)]
pub struct Swing {
    place: Trace,
    /// The change of the change of place from row to row, m.
    bend: Trace,
    /// The last two places.
    before: [Option<f64>; 2],
    /// The verdicts reached so far on place and bend.
    told: [Option<Verdict>; 2],
}

impl Swing {
    /// Follows positions every `row_seconds`, in steps of `quantum` (m), of a loop whose velocity filter cuts off at
    /// `cutoff_hz` and whose slowest mode is expected to take about `period` (s), if it swings at all, pulled aside by
    /// `pull` (m) at first.
    pub fn new(row_seconds: f64, cutoff_hz: f64, (period, oscillates): (f64, bool), quantum: f64, pull: f64) -> Self {
        let rows_a_period = 1.0 / (row_seconds * cutoff_hz);
        let slowest = period / row_seconds;
        let silent = slowest.clamp(SILENT_PERIODS.0 * rows_a_period, SILENT_PERIODS.1 * rows_a_period);
        // A motion that is damped beyond critical does not swing.
        let slowest = if oscillates { slowest } else { 0.0 };
        Self {
            place: Trace::new(rows_a_period, (slowest, silent), quantum, pull, LOOKS.0),
            // Errors of up to half a step in three places, one of them twice; of no size to be expected.
            bend: Trace::new(rows_a_period, (slowest, silent), 4.0 * quantum, f64::INFINITY, LOOKS.1),
            before: [None; 2],
            told: [None; 2],
        }
    }

    /// Returns true if the motion has not lost half of its size since it settled.
    #[must_use]
    pub fn goes_on(&self) -> bool {
        let settled: Vec<f64> = self.place.spans.iter().skip(SETTLING).map(|(low, high)| high - low).collect();
        let (_, latest) = settled.split_at(settled.len().saturating_sub(LOOK / 4));
        settled.len() > LOOK / 4 && largest(latest) > 0.5 * largest(&settled)
    }

    /// Takes the next position (m); says the verdict once there is one.
    pub fn take(&mut self, place: f64) -> Option<Verdict> {
        if self.told[0].is_none() {
            self.told[0] = self.place.take(place);
        }
        // A mode that dies out in the bend may have hidden one that builds up: the bend is followed for as long as the
        // place.
        if let [Some(first), Some(second)] = self.before {
            self.told[1] = self.bend.take(place - 2.0 * second + first).or(self.told[1]);
        }
        self.before = [self.before[1], Some(place)];
        match self.told {
            [Some(Verdict::Grows), _] | [_, Some(Verdict::Grows)] => Some(Verdict::Grows),
            // A vibration is judged by its size, which the place has.
            [Some(verdict), Some(_)] => Some(verdict),
            _ => None,
        }
    }
}

/// A signal whose swings are followed.
#[derive(Clone, Debug)]
struct Trace {
    /// Share of the way that the slow part takes in a row.
    share: f64,
    slow: Option<[f64; 2]>,
    /// Swings smaller than this are encoder steps, and so is what is smaller than this from peak to peak for good, m.
    noise: f64,
    explained: f64,
    /// Initial size of the motion, m.
    pull: f64,
    /// Looks after which a motion that goes on is a vibration.
    looks: usize,
    /// Rows that a turn of the slowest mode is expected to take.
    slowest: f64,
    /// Rows without a turning point after which a motion is judged.
    silent: f64,
    /// The extreme since the last turning point, and whether the motion rises.
    extreme: Option<(f64, bool)>,
    turned: Option<f64>,
    swings: Vec<f64>,
    /// The row in which each swing ended.
    ends: Vec<usize>,
    /// Lowest and highest position since the last turning point, and the span of each swing, m.
    reach: (f64, f64),
    spans: Vec<(f64, f64)>,
    /// The same without the slow part.
    extent: (f64, f64),
    extents: Vec<(f64, f64)>,
    rows: usize,
    since_turn: usize,
}

impl Trace {
    fn new(rows_a_period: f64, (slowest, silent): (f64, f64), quantum: f64, pull: f64, looks: usize) -> Self {
        Self {
            looks,
            slowest,
            share: 1.0 - (-TAU * HIGH_PASS_SHARE / rows_a_period).exp(),
            slow: None,
            noise: 1.5 * quantum,
            explained: ENCODER_STEPS * quantum,
            pull,
            silent,
            extreme: None,
            turned: None,
            swings: Vec::new(),
            ends: Vec::new(),
            reach: NOWHERE,
            spans: Vec::new(),
            extent: NOWHERE,
            extents: Vec::new(),
            rows: 0,
            since_turn: 0,
        }
    }

    fn take(&mut self, place: f64) -> Option<Verdict> {
        self.rows += 1;
        self.since_turn += 1;
        if place.abs() > (FARTHEST_PULLS * self.pull).min(2.0 * self.pull + FARTHEST) {
            return Some(Verdict::Grows);
        }
        let [first, second] = self.slow.get_or_insert([place, 0.0]);
        *first += self.share * (place - *first);
        let fast = place - *first;
        *second += self.share * (fast - *second);
        let fast = fast - *second;
        self.reach = (self.reach.0.min(place), self.reach.1.max(place));
        self.extent = (self.extent.0.min(fast), self.extent.1.max(fast));
        if self.turns(fast)
            && let Some(verdict) = self.at_turn()
        {
            return Some(verdict);
        }
        // Much longer than the turning points so far were apart.
        (self.since_turn as f64 > self.silent.max(6.0 * self.apart())).then_some(Verdict::Decays)
    }

    /// Notes a turning point when the motion has come back from its extreme by more than noise.
    fn turns(&mut self, fast: f64) -> bool {
        let Some((extreme, rising)) = self.extreme else {
            self.extreme = Some((fast, true));
            return false;
        };
        if if rising { fast > extreme } else { fast < extreme } {
            self.extreme = Some((fast, rising));
            return false;
        }
        if (fast - extreme).abs() <= self.noise.max(0.2 * DIED_OUT_SHARE * largest(&self.swings)).max(self.ripple()) {
            return false;
        }
        if let Some(before) = self.turned.replace(extreme) {
            self.swings.push((extreme - before).abs());
            self.ends.push(self.rows);
            self.spans.push(std::mem::replace(&mut self.reach, NOWHERE));
            self.extents.push(std::mem::replace(&mut self.extent, NOWHERE));
        }
        self.extreme = Some((fast, !rising));
        self.since_turn = 0;
        self.swings.len() > 3
    }

    /// A reversal smaller than this is a faster mode's ripple on the swing, m. It falls while nothing turns: after a
    /// large mode has died out a small one is seen.
    fn ripple(&self) -> f64 {
        let recent = largest(&self.swings[self.swings.len().saturating_sub(4)..]);
        RIPPLE_SHARE * recent * (-(self.since_turn as f64) / (2.0 * self.apart())).exp2()
    }

    /// Average distance of the turning points so far, rows.
    fn apart(&self) -> f64 {
        (self.rows - self.since_turn) as f64 / (self.swings.len() + 1) as f64
    }

    fn at_turn(&self) -> Option<Verdict> {
        let count = self.swings.len();
        let latest = self.swings[count - 1];
        // The first swings may be a fast mode's ripple alone, on a slow one that has yet to turn.
        if latest > RUNAWAY_GROWTH * largest(&self.swings[1..4]).max(self.explained).max(self.pull) {
            return Some(Verdict::Grows);
        }
        let small = |swings: &[f64]| largest(swings) < DIED_OUT_SHARE * largest(&self.swings) && trend(swings).0 <= 0.0;
        if count > LOOK / 2 && small(&self.swings[count - LOOK / 2..]) {
            return Some(Verdict::Decays);
        }
        // A look at the trend, and another whenever half of what it saw is new.
        let seen = count.checked_sub(SETTLING + LOOK)?;
        if !seen.is_multiple_of(LOOK / 2) {
            return None;
        }
        // Swings that a ripple no longer cuts in pieces are larger, and the motion is not.
        let (earlier, later) = self.extents[SETTLING..].split_at(seen + LOOK / 2);
        let larger = across(later) > across(earlier);
        let lasted = (self.ends[count - 1] - self.ends[count - 1 - LOOK]) as f64;
        // A slower mode may build up under what dies out within a turn of it.
        let told = self
            .told_by(&self.swings[count - LOOK..], larger)
            .filter(|told| *told != Verdict::Decays || lasted > TURNS * self.slowest);
        let looks = seen / (LOOK / 2);
        if told.is_some() || looks < self.looks {
            return told;
        }
        let stretches = self.stretches();
        let latest = &stretches[stretches.len() / 2..];
        let enough = latest.len() >= STRETCHES;
        let patient = looks < PATIENCE * self.looks;
        if !enough && patient {
            return None;
        }
        let larger = largest(&latest[latest.len() / 2..]) >= largest(&stretches);
        // A trend that has bent, or the rise of a beat, is no size at which a motion stays.
        self.told_by(latest, larger).or_else(|| (!patient || !is_sure(trend(latest))).then(|| self.lasting()))
    }

    /// The reach of the motion over every [`BEAT`] swings, or over as many more as [`TURNS`] of the slowest mode take,
    /// m.
    fn stretches(&self) -> Vec<f64> {
        let (mut stretches, mut first) = (Vec::new(), SETTLING);
        for at in SETTLING..self.swings.len() {
            let rows = self.ends[at] - self.ends[first - 1];
            if at + 1 - first >= BEAT && rows as f64 >= TURNS * self.slowest {
                stretches.push(across(&self.extents[first..=at]));
                first = at + 1;
            }
        }
        stretches
    }

    /// The verdict that the trend of swings allows, if any: growth only where the motion is `larger` than ever, because
    /// what grows without being so is the beat of two modes that lie close together.
    fn told_by(&self, swings: &[f64], larger: bool) -> Option<Verdict> {
        let (slope, error) = trend(swings);
        let sure = is_sure((slope, error));
        let (earlier, later) = swings.split_at(swings.len() / 2);
        if sure && slope > 0.0 && larger && self.size() > self.explained {
            return Some(Verdict::Grows);
        }
        // A motion that shrinks ever more slowly is about to stay.
        (sure && slope < 0.0 && trend(later).0 < 0.5 * trend(earlier).0).then_some(Verdict::Decays)
    }

    /// The verdict on a motion whose size neither grows nor shrinks.
    fn lasting(&self) -> Verdict {
        let size = self.size();
        if size > self.explained { Verdict::Vibrates(size) } else { Verdict::Decays }
    }

    /// The size of the latest swings from peak to peak, m: the median of pairs, which one stray swing does not move.
    fn size(&self) -> f64 {
        let recent = &self.spans[self.spans.len().saturating_sub(LOOK / 2)..];
        let mut sizes: Vec<f64> =
            recent.windows(2).map(|two| two[0].1.max(two[1].1) - two[0].0.min(two[1].0)).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
    }
}

const NOWHERE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// From the lowest to the highest of some spans; negative infinity for no spans.
fn across(spans: &[(f64, f64)]) -> f64 {
    let (low, high) = spans.iter().fold(NOWHERE, |(low, high), span| (low.min(span.0), high.max(span.1)));
    high - low
}

fn largest(swings: &[f64]) -> f64 {
    swings.iter().copied().fold(0.0, f64::max)
}

/// Returns true if a slope with this standard error differs from zero.
fn is_sure((slope, error): (f64, f64)) -> bool {
    slope.abs() > FLAT_SLOPE.max(SIGNIFICANT * error)
}

/// Slope of ln(swing) over the swings, and its standard error.
fn trend(swings: &[f64]) -> (f64, f64) {
    let logs: Vec<f64> = swings.iter().filter(|s| **s > 0.0).map(|s| s.ln()).collect();
    let n = logs.len() as f64;
    let middle = |i: usize| i as f64 - (n - 1.0) / 2.0;
    let mean = logs.iter().sum::<f64>() / n;
    let weight: f64 = (0..logs.len()).map(|i| middle(i).powi(2)).sum();
    let slope = logs.iter().enumerate().map(|(i, log)| middle(i) * (log - mean)).sum::<f64>() / weight;
    let rest: f64 = logs.iter().enumerate().map(|(i, log)| (log - mean - slope * middle(i)).powi(2)).sum();
    (slope, (rest / ((n - 2.0) * weight)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;
    const CUTOFF: f64 = 20.0;

    fn judged(quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        judged_below(CUTOFF, quantum, motion)
    }

    fn judged_below(cutoff: f64, quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        judged_every(DT, cutoff, 0.0, quantum, motion)
    }

    fn judged_every(dt: f64, cutoff: f64, period: f64, quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        let mut swing = Swing::new(dt, cutoff, (period, true), quantum, 1e-3);
        for k in 0..60_000 {
            let x = motion(f64::from(k) * dt);
            let x = if quantum > 0.0 { (x / quantum).round() * quantum } else { x };
            if let Some(verdict) = swing.take(x) {
                return verdict;
            }
        }
        panic!("no verdict");
    }

    /// Modes of given share, growth (1/s) and frequency (Hz), as a tip that was pulled aside by 1 mm shows them.
    fn modes(all: &[(f64, f64, f64)]) -> impl Fn(f64) -> f64 {
        let all = all.to_vec();
        move |t| all.iter().map(|(share, grows, hz)| 1e-3 * share * (grows * t).exp() * (TAU * hz * t).cos()).sum()
    }

    #[test]
    fn two_modes_that_meet_in_one_small_swing_have_not_died_out() {
        // A wall on a cable of 120 Hz at 1 kHz has modes like these a seventh, a third and twice beyond its boundary.
        for [(slow, slow_hz), (fast, fast_hz)] in
            [[(2.0, 46.0), (3.8, 164.2)], [(5.3, 48.5), (8.2, 165.0)], [(18.0, 58.0), (32.0, 170.0)]]
        {
            for share in [0.2, 0.35, 0.5, 0.65] {
                let found = judged_every(
                    DT,
                    100.0,
                    1.0 / slow_hz,
                    1e-7,
                    modes(&[(1.0 - share, slow, slow_hz), (share, fast, fast_hz)]),
                );
                assert_eq!(found, Verdict::Grows, "{slow_hz} and {fast_hz} Hz, {share} of it fast");
                let found = judged_every(
                    DT,
                    100.0,
                    1.0 / slow_hz,
                    1e-7,
                    modes(&[(1.0 - share, -slow, slow_hz), (share, -fast, fast_hz)]),
                );
                assert_eq!(found, Verdict::Decays, "{slow_hz} and {fast_hz} Hz, {share} of it fast");
            }
        }
    }

    #[test]
    fn a_fast_mode_that_builds_up_shows_beside_a_slow_one_that_dies_out() {
        for (slow, fast) in [(-0.5, 1.0), (-4.0, 1.0), (-2.0, 5.0)] {
            let found = judged_every(DT, 100.0, 1.0 / 44.0, 1e-7, modes(&[(0.95, slow, 44.0), (0.05, fast, 163.0)]));
            assert_ne!(found, Verdict::Decays, "{slow} {fast}");
        }
        let found = judged_every(DT, 100.0, 1.0 / 44.0, 1e-7, modes(&[(0.95, -0.5, 44.0), (0.05, -1.0, 163.0)]));
        assert_eq!(found, Verdict::Decays);
    }

    #[test]
    fn a_slow_swing_and_a_fast_one_on_it_that_both_die_out_are_no_vibration() {
        // The WoodenHaptics with cables of 400 Hz at 20 kHz, a tenth below its limit: 57 Hz of the wall and 472 Hz of
        // the cables, which die out at their own paces.
        let at = |quantum: f64, share: f64, phase: f64, slow: f64, fast: f64| {
            let motion = move |t: f64| {
                let ripple = share * (fast * t).exp() * (TAU * (472.0 * t + phase)).cos();
                1e-3 * ((slow * t).exp() * (TAU * 57.0 * t).cos() + ripple)
            };
            judged_every(1e-4, 500.0, 1.0 / 57.0, quantum, motion)
        };
        for eighths in 0..8 {
            let phase = f64::from(eighths) / 8.0;
            for share in [0.02, 0.05, 0.1, 0.2, 0.4, 0.8] {
                for (slow, fast) in [(-6.0, -18.0), (-8.0, -33.0), (-8.0, -3.0), (-1.0, -33.0)] {
                    let found = at(2e-6, share, phase, slow, fast);
                    assert_eq!(found, Verdict::Decays, "{share} of it fast, {phase} turns, {slow} and {fast} 1/s");
                }
                for (slow, fast) in [(-6.0, 4.0), (1.0, -18.0), (2.0, 2.0)] {
                    let found = at(1e-7, share, phase, slow, fast);
                    assert_ne!(found, Verdict::Decays, "{share} of it fast, {phase} turns, {slow} and {fast} 1/s");
                }
            }
        }
    }

    #[test]
    fn a_fast_ripple_at_first_is_not_a_slow_mode_s_growth() {
        // A wall of 2 kN/m on the shipped Phantom with cables of 400 Hz, sampled at 5 kHz: stable up to 8.4 kN/m.
        let mut swing = Swing::new(2e-4, 200.0, (0.03, true), 3e-7, 1.4e-4);
        let place = |t: f64| {
            let slow = 7e-5 * (-25.0 * t).exp() * (TAU * 32.5 * t).cos();
            slow + 5e-6 * (-70.0 * t).exp() * (TAU * 433.0 * t).cos()
        };
        let verdict = (0..10_000).find_map(|k| swing.take(place(2e-4 * f64::from(k))));
        assert_eq!(verdict, Some(Verdict::Decays));
    }

    #[test]
    fn the_beat_of_two_fast_modes_is_not_growth() {
        for (a, b) in [(-3.0, -4.0), (-10.0, -20.0), (-20.0, -70.0)] {
            let found = judged_every(
                DT,
                100.0,
                1.0 / 40.0,
                1e-7,
                modes(&[(0.5, -5.0, 40.0), (0.25, a, 170.0), (0.22, b, 164.0)]),
            );
            assert_eq!(found, Verdict::Decays, "{a} {b}");
        }
    }

    #[test]
    fn a_mode_far_below_the_cutoff_is_followed_for_as_long_as_it_takes() {
        // The effect of a washout of 2 Hz below a cutoff of 100 Hz.
        for (grows, verdict) in [(-2.0, Verdict::Decays), (-0.5, Verdict::Decays), (0.3, Verdict::Grows)] {
            assert_eq!(judged_below(100.0, 1e-7, modes(&[(1.0, grows, 6.0)])), verdict, "{grows}");
        }
    }

    /// A swing that grows, with a slow return to the wall besides.
    fn growing(per_second: f64, drift: f64) -> impl Fn(f64) -> f64 {
        move |t| 1e-3 * (per_second * t).exp() * (70.0 * t).sin() + drift * (-2.0 * t).exp()
    }

    #[test]
    fn slow_growth_is_told_from_slow_decay() {
        for drift in [0.0, 2e-3] {
            assert_eq!(judged(0.0, growing(0.1, drift)), Verdict::Grows);
            assert_eq!(judged(0.0, growing(-0.1, drift)), Verdict::Decays);
        }
    }

    #[test]
    fn quantisation_does_not_change_the_verdict() {
        for quantum in [1e-6, 3e-5] {
            assert_eq!(judged(quantum, growing(0.5, 0.0)), Verdict::Grows);
            assert_eq!(judged(quantum, growing(-0.5, 0.0)), Verdict::Decays);
            assert_eq!(judged(quantum, growing(-40.0, 0.0)), Verdict::Decays);
        }
    }

    #[test]
    fn a_swing_that_stays_is_a_vibration_wherever_it_began() {
        // At its size from the start, coming down from three times that, and up from nine tenths of it.
        for begin in [0.0, 2.0, -0.1] {
            let verdict = judged(2e-5, |t| 3e-4 * (1.0 + begin * (-6.0 * t).exp()) * (70.0 * t).sin());
            let Verdict::Vibrates(size) = verdict else { panic!("{begin}: {verdict:?}") };
            assert!((size - 6e-4).abs() < 4e-5, "{begin}: {size} m from peak to peak");
        }
    }

    #[test]
    fn a_swing_as_small_as_encoder_steps_explain_is_none() {
        let chatter = |steps: f64| move |t: f64| (1e-3 * (-6.0 * t).exp() + 0.5 * steps * 1e-4) * (70.0 * t).sin();
        assert_eq!(judged(1e-4, chatter(4.0)), Verdict::Decays);
        for steps in [8.0, 9.0, 10.0, 12.0] {
            let verdict = judged(1e-4, chatter(steps));
            assert!(matches!(verdict, Verdict::Vibrates(_)), "{steps} steps: {verdict:?}");
        }
    }

    /// The describing function of a quantiser, by its definition: the first harmonic of a quantised sine.
    fn passed_on(amplitude: f64) -> f64 {
        let parts = 20_000;
        let sum: f64 = (0..parts)
            .map(|i| TAU * (f64::from(i) + 0.5) / f64::from(parts))
            .map(|angle| (amplitude * angle.sin()).round() * angle.sin())
            .sum();
        2.0 * sum / f64::from(parts) / amplitude
    }

    #[test]
    fn what_encoder_steps_explain_is_derived() {
        // Sines of which a quantiser shows more than ENCODER_STEPS steps span more than one step less.
        let largest = |from: f64| (0..4000).map(|i| passed_on(0.5 * from + f64::from(i) * 1e-3)).fold(0.0, f64::max);
        assert!((largest(ENCODER_STEPS - 1.0) - 1.0365).abs() < 1e-3);
        assert!((largest(ENCODER_STEPS + 1.0) - 1.023).abs() < 1e-3);
    }
}
