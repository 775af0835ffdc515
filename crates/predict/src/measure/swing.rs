//! Judges a motion by its sampled positions: the motion decays, grows, or continues as a vibration of constant size.
//!
//! A high-pass below the velocity filter's cutoff filters the position, because a slow return to the wall would hide a
//! small fast oscillation. An oscillation of a rigid device is seldom far below the cutoff. The swing between two
//! turning points grows or shrinks by a constant factor per half cycle of the dominant mode. The verdict follows from
//! the slope of a straight line through the swing's logarithm, relative to the slope's uncertainty.
//!
//! **Several modes.** Compliant transmissions cause modes on both sides of the cutoff, and a washout causes one far
//! below. Two modes of similar size occasionally make a tiny swing, so a motion has decayed only when several swings in
//! a row are small.
//!
//! The beat of two modes hides the trend of single swings. The largest of a few swings, over at least three periods of
//! the slowest mode, shows the trend. If one mode decays faster than another, the trend bends as if the motion
//! approached a constant size. Such a motion is followed until it is constant or has decayed.
//!
//! A large slow mode that decays can hide a small fast mode that grows. Therefore the acceleration is judged too: it
//! shows the fast mode larger by the square of the ratio of their frequencies.
//!
//! **Encoder steps.** A quantiser in a stable loop can sustain a vibration. Its describing function, the gain for a
//! sine's first harmonic, is at most 1.0365 for a sine of six steps and falls from there (1.023 at eight). A vibration
//! of more than [`ENCODER_STEPS`] steps from peak to peak therefore continues only if 3.6 % more gain would make the
//! loop without steps unstable. Larger vibrations count as unstable, so a boundary may be up to 3.6 % too low; smaller
//! ones count as rest.

use std::f64::consts::TAU;

/// Largest vibration that encoder steps can cause, steps from peak to peak.
pub const ENCODER_STEPS: f64 = 6.0;

/// Corner of the high-pass, as a share of the velocity filter's cutoff.
const HIGH_PASS_SHARE: f64 = 0.125;
/// Number of turning points that are ignored at the start, while faster modes decay.
const IGNORED_TURNS: usize = 8;
const SWINGS_PER_CHECK: usize = 22;
/// Number of checks after which a motion of constant size is a vibration, for position and acceleration.
const CHECKS_BEFORE_VIBRATION: (usize, usize) = (4, 16);
/// Minimum number of swings in a stretch. A stretch is longer than the beat of two modes.
const MIN_STRETCH_SWINGS: usize = 6;
/// Minimum duration of a stretch, and of a check that judges a motion as decaying, in periods of the slowest mode.
const MIN_STRETCH_PERIODS: f64 = 3.0;
const MIN_STRETCHES: usize = 8;
/// Factor on the number of checks before a motion with a bending trend counts as a vibration.
const BENDING_TREND_FACTOR: usize = 16;
/// Share of the recent swings below which a swing is the ripple of a faster mode.
const RIPPLE_SHARE: f64 = 0.4;
/// Number of standard errors by which a slope must differ from zero; large because encoder steps disturb
/// neighbouring swings alike, which the standard error does not include.
const SIGNIFICANT_STANDARD_ERRORS: f64 = 4.0;
/// Largest slope per swing of a motion with constant size, 0.4 % over one check.
const FLAT_SLOPE: f64 = 2e-4;
/// Ratio of a swing to the first swings and the pull above which a motion counts as growing, whatever its trend.
const RUNAWAY_GROWTH: f64 = 4.0;
/// Distance from the wall at which a motion counts as growing, in pulls.
const FARTHEST_PULLS: f64 = 12.0;
/// Distance from the wall, beyond two pulls, at which a motion counts as growing, m; the nearer bound for long pulls.
const FARTHEST_OFFSET_M: f64 = 0.005;
/// Share of the largest swing below which a motion has decayed.
const DIED_OUT_SHARE: f64 = 0.02;
/// Shortest and longest time without a turning point after which a motion has ended, in periods of the cutoff.
const SILENT_PERIODS: (f64, f64) = (10.0, 200.0);

/// Result of watching a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// The motion decays at least to the size that encoder steps can cause.
    Decays,
    /// The motion grows, so the loop oscillates.
    Grows,
    /// The motion continues at this size, m from peak to peak, so the loop is unstable.
    Vibrates(f64),
}

/// Follows a motion until its verdict.
#[derive(Clone, Debug)]
pub struct Swing {
    position: Trace,
    /// Second difference of the position, m.
    acceleration: Trace,
    previous_positions: [Option<f64>; 2],
    /// Verdicts on the position and on the acceleration.
    verdicts: [Option<Verdict>; 2],
}

impl Swing {
    /// Starts to judge the motion after a pull of `pull` (m). A position follows every `row_seconds` and is a multiple
    /// of `quantum` (m). The velocity filter has the cutoff `cutoff_hz`. The slowest mode has a period of about
    /// `period` (s) and oscillates if `oscillates`.
    pub fn new(row_seconds: f64, cutoff_hz: f64, (period, oscillates): (f64, bool), quantum: f64, pull: f64) -> Self {
        let rows_a_period = 1.0 / (row_seconds * cutoff_hz);
        let slowest = period / row_seconds;
        let silent = slowest.clamp(SILENT_PERIODS.0 * rows_a_period, SILENT_PERIODS.1 * rows_a_period);
        // An overdamped motion does not swing.
        let slowest = if oscillates { slowest } else { 0.0 };
        Self {
            position: Trace::new(rows_a_period, (slowest, silent), quantum, pull, CHECKS_BEFORE_VIBRATION.0),
            // A second difference has the errors of four positions. The initial size of the acceleration is unknown.
            acceleration: Trace::new(
                rows_a_period,
                (slowest, silent),
                4.0 * quantum,
                f64::INFINITY,
                CHECKS_BEFORE_VIBRATION.1,
            ),
            previous_positions: [None; 2],
            verdicts: [None; 2],
        }
    }

    /// Returns true if the motion still has half of its largest size after the first swings.
    #[must_use]
    pub fn still_swings(&self) -> bool {
        let settled: Vec<f64> = self.position.spans.iter().skip(IGNORED_TURNS).map(|(low, high)| high - low).collect();
        let (_, latest) = settled.split_at(settled.len().saturating_sub(SWINGS_PER_CHECK / 4));
        settled.len() > SWINGS_PER_CHECK / 4 && largest(latest) > 0.5 * largest(&settled)
    }

    /// Adds the next position (m). Returns the verdict as soon as it is known.
    pub fn add_position(&mut self, position: f64) -> Option<Verdict> {
        if self.verdicts[0].is_none() {
            self.verdicts[0] = self.position.add_position(position);
        }
        // Follows both signals to the end, because a decaying mode of one signal may hide a growing mode.
        if let [Some(first), Some(second)] = self.previous_positions {
            self.verdicts[1] = self.acceleration.add_position(position - 2.0 * second + first).or(self.verdicts[1]);
        }
        self.previous_positions = [self.previous_positions[1], Some(position)];
        match self.verdicts {
            [Some(Verdict::Grows), _] | [_, Some(Verdict::Grows)] => Some(Verdict::Grows),
            // A vibration has the size of the position, not of the acceleration.
            [Some(verdict), Some(_)] => Some(verdict),
            _ => None,
        }
    }
}

/// The swings of one signal.
#[derive(Clone, Debug)]
struct Trace {
    /// Coefficient per row of the high-pass's two low-passes.
    share: f64,
    low_passes: Option<[f64; 2]>,
    /// Largest reversal that encoder steps can cause, m. A smaller reversal is no turning point.
    noise: f64,
    /// Largest motion from peak to peak that encoder steps can sustain, m.
    encoder_motion: f64,
    /// Initial size of the motion, m.
    pull: f64,
    /// Number of checks after which a motion with constant size is a vibration.
    checks: usize,
    /// Expected period of the slowest mode, rows; 0 if the mode does not oscillate.
    slowest: f64,
    /// Number of rows without a turning point after which the motion has ended.
    silent: f64,
    /// Extreme value since the last turning point, and true if the signal rises.
    extreme: Option<(f64, bool)>,
    last_turn: Option<f64>,
    swings: Vec<f64>,
    /// The row at the end of each swing.
    ends: Vec<usize>,
    /// Lowest and highest position since the last turning point, m.
    span: (f64, f64),
    spans: Vec<(f64, f64)>,
    /// Lowest and highest high-passed position since the last turning point, m.
    extent: (f64, f64),
    extents: Vec<(f64, f64)>,
    rows: usize,
    since_turn: usize,
}

impl Trace {
    fn new(rows_a_period: f64, (slowest, silent): (f64, f64), quantum: f64, pull: f64, checks: usize) -> Self {
        Self {
            checks,
            slowest,
            share: 1.0 - (-TAU * HIGH_PASS_SHARE / rows_a_period).exp(),
            low_passes: None,
            noise: 1.5 * quantum,
            encoder_motion: ENCODER_STEPS * quantum,
            pull,
            silent,
            extreme: None,
            last_turn: None,
            swings: Vec::new(),
            ends: Vec::new(),
            span: EMPTY_SPAN,
            spans: Vec::new(),
            extent: EMPTY_SPAN,
            extents: Vec::new(),
            rows: 0,
            since_turn: 0,
        }
    }

    fn add_position(&mut self, position: f64) -> Option<Verdict> {
        self.rows += 1;
        self.since_turn += 1;
        if position.abs() > (FARTHEST_PULLS * self.pull).min(2.0 * self.pull + FARTHEST_OFFSET_M) {
            return Some(Verdict::Grows);
        }
        let [first, second] = self.low_passes.get_or_insert([position, 0.0]);
        *first += self.share * (position - *first);
        let fast = position - *first;
        *second += self.share * (fast - *second);
        let fast = fast - *second;
        self.span = (self.span.0.min(position), self.span.1.max(position));
        self.extent = (self.extent.0.min(fast), self.extent.1.max(fast));
        if self.record_turn(fast)
            && let Some(verdict) = self.verdict_at_turn()
        {
            return Some(verdict);
        }
        // The motion has ended if it has no turning point for much longer than the average time between turns.
        (self.since_turn as f64 > self.silent.max(6.0 * self.rows_per_turn())).then_some(Verdict::Decays)
    }

    /// Records a turning point that exceeds noise. Returns true if there are enough swings for a verdict.
    fn record_turn(&mut self, fast: f64) -> bool {
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
        if let Some(before) = self.last_turn.replace(extreme) {
            self.swings.push((extreme - before).abs());
            self.ends.push(self.rows);
            self.spans.push(std::mem::replace(&mut self.span, EMPTY_SPAN));
            self.extents.push(std::mem::replace(&mut self.extent, EMPTY_SPAN));
        }
        self.extreme = Some((fast, !rising));
        self.since_turn = 0;
        self.swings.len() > 3
    }

    /// Returns the size below which a reversal is the ripple of a faster mode, m. The size falls over the time without
    /// a turning point, so that a small mode is found after a large mode has decayed.
    fn ripple(&self) -> f64 {
        let recent = largest(&self.swings[self.swings.len().saturating_sub(4)..]);
        RIPPLE_SHARE * recent * (-(self.since_turn as f64) / (2.0 * self.rows_per_turn())).exp2()
    }

    /// Returns the average number of rows between turning points.
    fn rows_per_turn(&self) -> f64 {
        (self.rows - self.since_turn) as f64 / (self.swings.len() + 1) as f64
    }

    fn verdict_at_turn(&self) -> Option<Verdict> {
        let count = self.swings.len();
        let latest = self.swings[count - 1];
        // The first swings may be only the ripple of a fast mode while a slow mode has not yet turned.
        if latest > RUNAWAY_GROWTH * largest(&self.swings[1..4]).max(self.encoder_motion).max(self.pull) {
            return Some(Verdict::Grows);
        }
        let small = |swings: &[f64]| largest(swings) < DIED_OUT_SHARE * largest(&self.swings) && trend(swings).0 <= 0.0;
        if count > SWINGS_PER_CHECK / 2 && small(&self.swings[count - SWINGS_PER_CHECK / 2..]) {
            return Some(Verdict::Decays);
        }
        // Checks the trend whenever half of its swings are new.
        let seen = count.checked_sub(IGNORED_TURNS + SWINGS_PER_CHECK)?;
        if !seen.is_multiple_of(SWINGS_PER_CHECK / 2) {
            return None;
        }
        // Compares extents, because swings also become longer when a fast ripple decays and no longer splits them.
        let (earlier, later) = self.extents[IGNORED_TURNS..].split_at(seen + SWINGS_PER_CHECK / 2);
        let larger = size_of(later) > size_of(earlier);
        let lasted = (self.ends[count - 1] - self.ends[count - 1 - SWINGS_PER_CHECK]) as f64;
        // A decaying motion may hide a growing slower mode for a few of its periods.
        let verdict = self
            .verdict_of_trend(&self.swings[count - SWINGS_PER_CHECK..], larger)
            .filter(|verdict| *verdict != Verdict::Decays || lasted > MIN_STRETCH_PERIODS * self.slowest);
        let checks = seen / (SWINGS_PER_CHECK / 2);
        if verdict.is_some() || checks < self.checks {
            return verdict;
        }
        let stretches = self.stretches();
        let latest = &stretches[stretches.len() / 2..];
        let enough = latest.len() >= MIN_STRETCHES;
        let patient = checks < BENDING_TREND_FACTOR * self.checks;
        if !enough && patient {
            return None;
        }
        let larger = largest(&latest[latest.len() / 2..]) >= largest(&stretches);
        // A motion whose trend bends, or that rises in a beat, has no constant size.
        self.verdict_of_trend(latest, larger)
            .or_else(|| (!patient || !is_significant(trend(latest))).then(|| self.verdict_of_size()))
    }

    /// Returns the size of the motion in each stretch, m. A stretch has at least [`MIN_STRETCH_SWINGS`] swings and
    /// lasts at least [`MIN_STRETCH_PERIODS`] of the slowest mode.
    fn stretches(&self) -> Vec<f64> {
        let (mut stretches, mut first) = (Vec::new(), IGNORED_TURNS);
        for at in IGNORED_TURNS..self.swings.len() {
            let rows = self.ends[at] - self.ends[first - 1];
            if at + 1 - first >= MIN_STRETCH_SWINGS && rows as f64 >= MIN_STRETCH_PERIODS * self.slowest {
                stretches.push(size_of(&self.extents[first..=at]));
                first = at + 1;
            }
        }
        stretches
    }

    /// Returns the verdict if the trend is clear. A rising trend counts as growth only if the motion is also `larger`
    /// than before, because the beat of two modes rises too.
    fn verdict_of_trend(&self, swings: &[f64], larger: bool) -> Option<Verdict> {
        let (slope, error) = trend(swings);
        let sure = is_significant((slope, error));
        let (earlier, later) = swings.split_at(swings.len() / 2);
        if sure && slope > 0.0 && larger && self.size() > self.encoder_motion {
            return Some(Verdict::Grows);
        }
        // A motion that shrinks ever more slowly may settle at a constant size.
        (sure && slope < 0.0 && trend(later).0 < 0.5 * trend(earlier).0).then_some(Verdict::Decays)
    }

    fn verdict_of_size(&self) -> Verdict {
        let size = self.size();
        if size > self.encoder_motion { Verdict::Vibrates(size) } else { Verdict::Decays }
    }

    /// Returns the size of the latest swings from peak to peak, m. The median of pairs ignores a stray swing.
    fn size(&self) -> f64 {
        let recent = &self.spans[self.spans.len().saturating_sub(SWINGS_PER_CHECK / 2)..];
        let mut sizes: Vec<f64> =
            recent.windows(2).map(|two| two[0].1.max(two[1].1) - two[0].0.min(two[1].0)).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
    }
}

const EMPTY_SPAN: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// Returns the distance from the lowest to the highest value of all spans; negative infinity without spans.
fn size_of(spans: &[(f64, f64)]) -> f64 {
    let (low, high) = spans.iter().fold(EMPTY_SPAN, |(low, high), span| (low.min(span.0), high.max(span.1)));
    high - low
}

fn largest(swings: &[f64]) -> f64 {
    swings.iter().copied().fold(0.0, f64::max)
}

/// Returns true if a slope with this standard error differs from zero.
fn is_significant((slope, error): (f64, f64)) -> bool {
    slope.abs() > FLAT_SLOPE.max(SIGNIFICANT_STANDARD_ERRORS * error)
}

/// Returns the slope of ln(swing) per swing, and its standard error.
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

    fn verdict_on(quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        verdict_at_cutoff(CUTOFF, quantum, motion)
    }

    fn verdict_at_cutoff(cutoff: f64, quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        verdict_of_samples(DT, cutoff, 0.0, quantum, motion)
    }

    fn verdict_of_samples(dt: f64, cutoff: f64, period: f64, quantum: f64, motion: impl Fn(f64) -> f64) -> Verdict {
        let mut swing = Swing::new(dt, cutoff, (period, true), quantum, 1e-3);
        for k in 0..60_000 {
            let x = motion(f64::from(k) * dt);
            let x = if quantum > 0.0 { (x / quantum).round() * quantum } else { x };
            if let Some(verdict) = swing.add_position(x) {
                return verdict;
            }
        }
        panic!("no verdict");
    }

    /// Returns a sum of modes after a pull of 1 mm. Each mode is (share, growth in 1/s, frequency in Hz).
    fn modes(all: &[(f64, f64, f64)]) -> impl Fn(f64) -> f64 {
        let all = all.to_vec();
        move |t| all.iter().map(|(share, grows, hz)| 1e-3 * share * (grows * t).exp() * (TAU * hz * t).cos()).sum()
    }

    #[test]
    fn one_small_swing_of_two_modes_is_no_decay() {
        // Modes of a wall at 1 kHz on a 120 Hz cable, a seventh, a third and a factor of 2 beyond its boundary.
        for [(slow, slow_hz), (fast, fast_hz)] in
            [[(2.0, 46.0), (3.8, 164.2)], [(5.3, 48.5), (8.2, 165.0)], [(18.0, 58.0), (32.0, 170.0)]]
        {
            for share in [0.2, 0.35, 0.5, 0.65] {
                for (sign, expected) in [(1.0, Verdict::Grows), (-1.0, Verdict::Decays)] {
                    let both = [(1.0 - share, sign * slow, slow_hz), (share, sign * fast, fast_hz)];
                    let found = verdict_of_samples(DT, 100.0, 1.0 / slow_hz, 1e-7, modes(&both));
                    assert_eq!(found, expected, "{slow_hz} and {fast_hz} Hz, {share} of it fast");
                }
            }
        }
    }

    #[test]
    fn a_growing_fast_mode_is_found_despite_a_decaying_slow_mode() {
        for (slow, fast) in [(-0.5, 1.0), (-4.0, 1.0), (-2.0, 5.0)] {
            let found =
                verdict_of_samples(DT, 100.0, 1.0 / 44.0, 1e-7, modes(&[(0.95, slow, 44.0), (0.05, fast, 163.0)]));
            assert_ne!(found, Verdict::Decays, "{slow} {fast}");
        }
        let found = verdict_of_samples(DT, 100.0, 1.0 / 44.0, 1e-7, modes(&[(0.95, -0.5, 44.0), (0.05, -1.0, 163.0)]));
        assert_eq!(found, Verdict::Decays);
    }

    #[test]
    fn a_slow_and_a_fast_decaying_mode_are_no_vibration() {
        // WoodenHaptics with 400 Hz cables at 20 kHz, a tenth below its limit: modes at 57 Hz and 472 Hz.
        let at = |quantum: f64, share: f64, phase: f64, slow: f64, fast: f64| {
            let motion = move |t: f64| {
                let ripple = share * (fast * t).exp() * (TAU * (472.0 * t + phase)).cos();
                1e-3 * ((slow * t).exp() * (TAU * 57.0 * t).cos() + ripple)
            };
            verdict_of_samples(1e-4, 500.0, 1.0 / 57.0, quantum, motion)
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
    fn an_initial_fast_ripple_is_no_growth_of_a_slow_mode() {
        // A wall of 2 kN/m on the shipped Phantom with 400 Hz cables at 5 kHz, stable up to 8.4 kN/m.
        let mut swing = Swing::new(2e-4, 200.0, (0.03, true), 3e-7, 1.4e-4);
        let position = |t: f64| {
            let slow = 7e-5 * (-25.0 * t).exp() * (TAU * 32.5 * t).cos();
            slow + 5e-6 * (-70.0 * t).exp() * (TAU * 433.0 * t).cos()
        };
        let verdict = (0..10_000).find_map(|k| swing.add_position(position(2e-4 * f64::from(k))));
        assert_eq!(verdict, Some(Verdict::Decays));
    }

    #[test]
    fn the_beat_of_two_fast_modes_is_not_growth() {
        for (a, b) in [(-3.0, -4.0), (-10.0, -20.0), (-20.0, -70.0)] {
            let all = [(0.5, -5.0, 40.0), (0.25, a, 170.0), (0.22, b, 164.0)];
            let found = verdict_of_samples(DT, 100.0, 1.0 / 40.0, 1e-7, modes(&all));
            assert_eq!(found, Verdict::Decays, "{a} {b}");
        }
    }

    #[test]
    fn a_mode_far_below_the_cutoff_is_judged() {
        // A washout of 2 Hz causes this mode; the cutoff is 100 Hz.
        for (grows, verdict) in [(-2.0, Verdict::Decays), (-0.5, Verdict::Decays), (0.3, Verdict::Grows)] {
            assert_eq!(verdict_at_cutoff(100.0, 1e-7, modes(&[(1.0, grows, 6.0)])), verdict, "{grows}");
        }
    }

    /// Returns a growing swing with a slow return to the wall.
    fn growing_swing(per_second: f64, drift: f64) -> impl Fn(f64) -> f64 {
        move |t| 1e-3 * (per_second * t).exp() * (70.0 * t).sin() + drift * (-2.0 * t).exp()
    }

    #[test]
    fn slow_growth_and_slow_decay_are_distinguished() {
        for drift in [0.0, 2e-3] {
            assert_eq!(verdict_on(0.0, growing_swing(0.1, drift)), Verdict::Grows);
            assert_eq!(verdict_on(0.0, growing_swing(-0.1, drift)), Verdict::Decays);
        }
    }

    #[test]
    fn quantisation_does_not_change_the_verdict() {
        for quantum in [1e-6, 3e-5] {
            assert_eq!(verdict_on(quantum, growing_swing(0.5, 0.0)), Verdict::Grows);
            assert_eq!(verdict_on(quantum, growing_swing(-0.5, 0.0)), Verdict::Decays);
            assert_eq!(verdict_on(quantum, growing_swing(-40.0, 0.0)), Verdict::Decays);
        }
    }

    #[test]
    fn a_swing_of_constant_size_is_a_vibration() {
        // The size is constant, falls from three times, or rises from nine tenths of its final value.
        for begin in [0.0, 2.0, -0.1] {
            let verdict = verdict_on(2e-5, |t| 3e-4 * (1.0 + begin * (-6.0 * t).exp()) * (70.0 * t).sin());
            let Verdict::Vibrates(size) = verdict else { panic!("{begin}: {verdict:?}") };
            assert!((size - 6e-4).abs() < 4e-5, "{begin}: {size} m from peak to peak");
        }
    }

    #[test]
    fn a_swing_that_encoder_steps_explain_is_no_vibration() {
        let chatter = |steps: f64| move |t: f64| (1e-3 * (-6.0 * t).exp() + 0.5 * steps * 1e-4) * (70.0 * t).sin();
        assert_eq!(verdict_on(1e-4, chatter(4.0)), Verdict::Decays);
        for steps in [8.0, 9.0, 10.0, 12.0] {
            let verdict = verdict_on(1e-4, chatter(steps));
            assert!(matches!(verdict, Verdict::Vibrates(_)), "{steps} steps: {verdict:?}");
        }
    }

    /// Returns the describing function of a quantiser, computed from the first harmonic of a quantised sine.
    fn describing_function(amplitude: f64) -> f64 {
        let parts = 20_000;
        let sum: f64 = (0..parts)
            .map(|i| TAU * (f64::from(i) + 0.5) / f64::from(parts))
            .map(|angle| (amplitude * angle.sin()).round() * angle.sin())
            .sum();
        2.0 * sum / f64::from(parts) / amplitude
    }

    #[test]
    fn encoder_steps_follow_from_the_describing_function() {
        // A quantised sine of n steps has an amplitude of more than (n - 1)/2 steps before quantisation.
        let largest =
            |from: f64| (0..4000).map(|i| describing_function(0.5 * from + f64::from(i) * 1e-3)).fold(0.0, f64::max);
        assert!((largest(ENCODER_STEPS - 1.0) - 1.0365).abs() < 1e-3);
        assert!((largest(ENCODER_STEPS + 1.0) - 1.023).abs() < 1e-3);
    }
}
