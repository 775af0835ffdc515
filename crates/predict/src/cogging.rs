//! Learns the cogging of a board's motors: moves a joint slowly both ways ([`Sweep`]), and fits the potential of the
//! motor's magnets to the torques that this takes ([`fit`]).

mod series;
mod sweep;

use haptic_bridge::model::cogging::{Harmonic, MAX_HARMONICS, Potential};
use haptic_bridge::safety::fault::FaultRecord;
use haptic_host::link::{BoardError, LinkError};
use haptic_host::words::fault_and_remedy;
use nalgebra::DVector;
use series::{Fitted, Series, rms};
use std::f64::consts::TAU;
pub use sweep::Sweep;
use thiserror::Error;

/// Half of the time over which torques and accelerations are averaged, s.
const WINDOW_SECONDS: f64 = 8e-3;
/// Smallest mean speed of a sample, as a share of the speed of the motion: below, the joint sticks or has turned round.
const MIN_SPEED_SHARE: f64 = 0.1;
/// Fewest and most bins of an arc, and smallest width of a bin, counts.
const MIN_BINS: usize = 50;
const MAX_BINS: f64 = 1_000.0;
const MIN_BIN_COUNTS: f64 = 1.5;
/// Fewest bins and counts in a period of a harmonic.
const BINS_PER_PERIOD: f64 = 4.0;
const COUNTS_PER_PERIOD: f64 = 6.0;
/// Fewest periods in the arc: weight, cables and other loads vary more slowly.
const MIN_PERIODS: f64 = 2.0;
/// Smallest distance of two orders, in periods over the arc. An arc does not resolve a smaller distance.
const MIN_SEPARATION: f64 = 0.5;
/// Ratio of the held-out errors with and without a harmonic below which the harmonic is kept.
const WORTHWHILE: f64 = 0.97;
/// Ratio of the residuals after and before an order moves to a neighbour below which it moves, and most such moves.
const MIN_IMPROVEMENT: f64 = 0.995;
const MAX_MOVES: usize = 8;
/// Share of the ripple above which the held-out error shows that a series explains nothing.
const MAX_HELD_OUT_SHARE: f64 = 0.7;

/// Reason why no cogging was learnt. The motors are then off, or go off without heartbeats.
#[derive(Debug, Error)]
#[allow(missing_docs)]
pub enum CoggingError {
    #[error(transparent)]
    Board(#[from] BoardError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("{}", fault_and_remedy(.0))]
    Fault(FaultRecord),
    #[error("another program turned the motors off")]
    Disarmed,
    #[error("joint {0} has no limits, motor or encoder in the device file")]
    Incomplete(usize),
    #[error("a redundant arm cannot hold its other joints during this motion")]
    Redundant,
    #[error("joint {0} is at the end of the arc that it can move through: move it to the middle")]
    NoArc(usize),
    #[error("joint {joint} does not follow at {q:.3}: a hand or friction holds it")]
    Stuck { joint: usize, q: f64 },
    #[error("the arc of {0:.3} is too short to tell cogging from a load")]
    Short(f64),
    #[error(
        "the joint's torque shows no cogging: its ripple is {before:.2e}, and a series leaves {held_out:.2e} of the torque \
         that was not used to fit it"
    )]
    Nothing { before: f64, held_out: f64 },
}

/// A sample of a pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time, s.
    pub time: f64,
    /// Joint angle, rad.
    pub q: f64,
    /// Torque of the motor less the torque that holds the device's weight, N m.
    pub torque: f64,
}

/// The samples of a motion in one direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pass {
    /// True if the angle grows.
    pub forward: bool,
    /// The samples in order of time.
    pub samples: Vec<Sample>,
}

/// The joint and its motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Inertia about the joint, kg m².
    pub inertia: f64,
    /// Viscous friction, N m s/rad.
    pub viscous: f64,
    /// Speed, rad/s.
    pub speed: f64,
    /// Angle of an encoder count, rad.
    pub count: f64,
    /// Turns of the motor's shaft per turn of the joint.
    pub ratio: f64,
}

/// The cogging of a joint's motor. Torques are those that compensate the magnets, N m.
#[derive(Clone, Debug, PartialEq)]
pub struct Learnt {
    /// Potential of the magnets.
    pub potential: Potential,
    /// Root mean square of the measured ripple.
    pub before: f64,
    /// Root mean square of the ripple that the potential leaves.
    pub after: f64,
    /// Root mean square of the error at angles that were not used for the fit.
    pub held_out: f64,
    /// Mean difference of the torques of both directions, half of it: the dry friction.
    pub friction: f64,
    /// Angle, measured ripple and fitted ripple in each bin.
    pub points: Vec<(f64, f64, f64)>,
}

/// Fits the potential of a motor's magnets to passes in both directions.
pub fn fit(passes: &[Pass], motion: &Motion) -> Result<Learnt, CoggingError> {
    let bins = bins(passes, motion);
    let arc = bins.last().zip(bins.first()).map_or(0.0, |(last, first)| last.0 - first.0);
    let angles: Vec<f64> = bins.iter().map(|(q, ..)| *q).collect();
    let torques = DVector::from_iterator(bins.len(), bins.iter().map(|(_, torque, _)| *torque));
    let series = Series { angles: &angles, torques, ratio: motion.ratio };
    let periods_per_order = arc * motion.ratio.abs() / TAU;
    let densest = (bins.len() as f64 / BINS_PER_PERIOD).min(arc / motion.count.abs() / COUNTS_PER_PERIOD);
    let first = (MIN_PERIODS / periods_per_order).ceil();
    let last = (densest / periods_per_order).floor().min(f64::from(u16::MAX));
    if !(first >= 1.0 && last > first && bins.len() >= MIN_BINS) {
        return Err(CoggingError::Short(arc));
    }
    let separation = MIN_SEPARATION / periods_per_order;
    let allowed = |orders: &[f64], order: f64| {
        (first..=last).contains(&order) && orders.iter().all(|other| (order - other).abs() >= separation)
    };
    let mut orders: Vec<f64> = Vec::new();
    let mut best = series.fit(&orders);
    let ripple = best.residuals.clone();
    let before = rms(&ripple);
    let mut held_out = series.held_out(&orders);
    while orders.len() < MAX_HARMONICS {
        let candidates = (first as u32..=last as u32).map(f64::from).filter(|order| allowed(&orders, *order));
        let scored = candidates.map(|order| (order, series.score(&best.residuals, order)));
        let Some((order, _)) = scored.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        let (more, next) = refined(&series, [&orders[..], &[order]].concat(), allowed);
        let error = series.held_out(&more);
        if error.is_nan() || error >= WORTHWHILE * held_out {
            break;
        }
        (orders, best, held_out) = (more, next, error);
    }
    if held_out.is_nan() || held_out >= MAX_HELD_OUT_SHARE * before {
        return Err(CoggingError::Nothing { before, held_out });
    }
    let harmonic = |(order, (cosine, sine)): (&f64, &(f64, f64))| {
        let per_angle = order * motion.ratio;
        // The windows have lowered a wave that passes in a time not much longer than theirs.
        let half = (0.5 * per_angle * motion.speed * WINDOW_SECONDS).abs();
        let kept = (half.sin() / half).powi(2);
        Harmonic {
            order: *order as u16,
            energy: (cosine.hypot(*sine) / (kept * per_angle).abs()) as f32,
            // d/dq of E cos(n q + φ) is -E n (cos φ sin n q + sin φ cos n q).
            phase: (-cosine * per_angle.signum()).atan2(-sine * per_angle.signum()) as f32,
        }
    };
    let points = angles.iter().zip(&ripple).zip(&best.residuals);
    Ok(Learnt {
        potential: orders.iter().zip(&best.waves).map(harmonic).collect(),
        before,
        after: rms(&best.residuals),
        held_out,
        friction: bins.iter().map(|(.., friction)| friction).sum::<f64>() / bins.len() as f64,
        points: points.map(|((q, ripple), residual)| (*q, *ripple, ripple - residual)).collect(),
    })
}

/// Fits these orders, and moves each to a neighbour while that leaves smaller residuals: an order that was found before
/// the others may have taken a part of theirs.
fn refined(series: &Series<'_>, mut orders: Vec<f64>, allowed: impl Fn(&[f64], f64) -> bool) -> (Vec<f64>, Fitted) {
    let mut best = series.fit(&orders);
    for _ in 0..MAX_MOVES {
        let neighbours = (0..orders.len()).flat_map(|i| [(i, -1.0), (i, 1.0)]);
        let moved = neighbours.filter_map(|(i, by)| {
            let mut moved = orders.clone();
            let order = moved.remove(i) + by;
            let free = allowed(&moved, order);
            moved.insert(i, order);
            free.then(|| (series.fit(&moved), moved))
        });
        let Some((next, moved)) = moved.min_by(|a, b| rms(&a.0.residuals).total_cmp(&rms(&b.0.residuals))) else {
            break;
        };
        if rms(&next.residuals) >= MIN_IMPROVEMENT * rms(&best.residuals) {
            break;
        }
        (orders, best) = (moved, next);
    }
    (orders, best)
}

/// Returns angle, mean torque of both directions, and half the difference of the directions in every bin that both
/// directions have passed. Friction that depends on the angle cancels in the mean.
fn bins(passes: &[Pass], motion: &Motion) -> Vec<(f64, f64, f64)> {
    let all = || passes.iter().flat_map(|pass| &pass.samples).map(|sample| sample.q);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if high <= low {
        return Vec::new();
    }
    let width = ((high - low) / MAX_BINS).max(MIN_BIN_COUNTS * motion.count.abs());
    let mut sums = vec![[(0.0, 0.0, 0.0); 2]; ((high - low) / width) as usize + 1];
    for pass in passes {
        for (q, torque) in quasistatic(pass, motion) {
            let (number, angle, sum) = &mut sums[((q - low) / width) as usize][usize::from(pass.forward)];
            (*number, *angle, *sum) = (*number + 1.0, *angle + q, *sum + torque);
        }
    }
    let both = sums.into_iter().filter(|[back, forth]| back.0 > 0.0 && forth.0 > 0.0);
    both.map(|[back, forth]| {
        let (back_torque, forth_torque) = (back.2 / back.0, forth.2 / forth.0);
        let q = 0.5 * (back.1 / back.0 + forth.1 / forth.0);
        (q, 0.5 * (forth_torque + back_torque), 0.5 * (forth_torque - back_torque))
    })
    .collect()
}

/// Returns angle and torque without inertia and viscous friction in windows of a pass. With triangular weights the mean
/// acceleration is the second difference of the angle.
fn quasistatic(pass: &Pass, motion: &Motion) -> Vec<(f64, f64)> {
    let samples = &pass.samples;
    let direction = if pass.forward { 1.0 } else { -1.0 };
    let (mut from, mut to) = (0, 0);
    let mut found = Vec::new();
    for (k, middle) in samples.iter().enumerate() {
        while middle.time - samples[from].time > WINDOW_SECONDS {
            from += 1;
        }
        while to + 1 < samples.len() && samples[to].time - middle.time < WINDOW_SECONDS {
            to += 1;
        }
        let (first, last) = (&samples[from], &samples[to]);
        let (before, after) = (middle.time - first.time, last.time - middle.time);
        if before < 0.5 * WINDOW_SECONDS || after < 0.5 * WINDOW_SECONDS || before + after > 4.0 * WINDOW_SECONDS {
            continue;
        }
        let speed = (last.q - first.q) / (before + after);
        if speed * direction < MIN_SPEED_SHARE * motion.speed {
            continue;
        }
        let acceleration = 2.0 * ((last.q - middle.q) / after - (middle.q - first.q) / before) / (before + after);
        let (mut weights, mut q, mut torque) = (0.0, 0.0, 0.0);
        for sample in &samples[from..=to] {
            let away = sample.time - middle.time;
            let weight = 1.0 - if away < 0.0 { -away / before } else { away / after };
            (weights, q, torque) = (weights + weight, q + weight * sample.q, torque + weight * sample.torque);
        }
        debug_assert!(from <= k && k <= to);
        found.push((q / weights, torque / weights - motion.inertia * acceleration - motion.viscous * speed));
    }
    found
}
