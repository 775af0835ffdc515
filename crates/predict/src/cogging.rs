//! Learns the cogging of a board's motors: moves a joint slowly both ways ([`Sweep`]), and fits the potential of the
//! motor's magnets to the torques that this takes ([`fit`]).

mod series;
mod sweep;

use haptic_bridge::model::cogging::{Harmonic, MAX_HARMONICS, Potential};
use haptic_bridge::safety::fault::FaultRecord;
use haptic_host::link::{BoardError, LinkError};
use haptic_host::words::fault_and_remedy;
use series::{Fitted, fitted, rms};
pub use sweep::Sweep;
use thiserror::Error;

/// Half of the time over which torques and accelerations are averaged, s.
const WINDOW_SECONDS: f64 = 8e-3;
/// Smallest mean speed of a sample, as a share of the speed of the motion: below, the joint sticks or has turned round.
const MIN_SPEED_SHARE: f64 = 0.3;
/// Largest number of bins of an arc, and smallest width of a bin, counts.
const MAX_BINS: f64 = 600.0;
const MIN_BIN_COUNTS: f64 = 3.0;
/// Fewest bins and counts in a period of a harmonic.
const BINS_PER_PERIOD: f64 = 6.0;
const COUNTS_PER_PERIOD: f64 = 8.0;
/// Fewest periods in the arc: weight, cables and other loads vary more slowly.
const MIN_PERIODS: f64 = 2.0;
/// Smallest distance of two orders, in periods over the arc. An arc does not resolve a smaller distance.
const MIN_SEPARATION: f64 = 0.5;
/// Ratio of the held-out errors with and without a harmonic below which the harmonic is kept.
const WORTHWHILE: f64 = 0.97;
/// Ratio of the residuals after and before an order moves to a neighbour below which it moves, and most such moves.
const MIN_IMPROVEMENT: f64 = 0.995;
const MAX_MOVES: usize = 20;
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
    let (Some((low, ..)), Some((high, ..))) = (bins.first(), bins.last()) else {
        return Err(CoggingError::Short(0.0));
    };
    let arc = high - low;
    let angles: Vec<f64> = bins.iter().map(|(q, ..)| *q).collect();
    let torques: Vec<f64> = bins.iter().map(|(_, torque, _)| *torque).collect();
    let periods_per_order = arc * motion.ratio / std::f64::consts::TAU;
    let densest = (bins.len() as f64 / BINS_PER_PERIOD).min(arc / motion.count.abs() / COUNTS_PER_PERIOD);
    let (first, last) = ((MIN_PERIODS / periods_per_order).ceil(), (densest / periods_per_order).floor());
    if !(first >= 1.0 && last > first && bins.len() > 50) {
        return Err(CoggingError::Short(arc));
    }
    let (last, apart_by) = (last.min(f64::from(u16::MAX)), MIN_SEPARATION / periods_per_order);
    let mut orders: Vec<f64> = Vec::new();
    let mut best = fitted(&angles, &torques, &orders, motion.ratio);
    let trend = best.values.clone();
    let before = rms(&best.residuals);
    while orders.len() < MAX_HARMONICS {
        let apart = |order: f64| orders.iter().all(|other| (order - other).abs() >= apart_by);
        let candidates = (first as u32..=last as u32).map(f64::from).filter(|order| apart(*order));
        let scored = candidates.map(|order| (order, series::score(&angles, &best.residuals, order * motion.ratio)));
        let Some((order, _)) = scored.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        let more = [&orders[..], &[order]].concat();
        let next = fitted(&angles, &torques, &more, motion.ratio);
        if !(next.held_out < WORTHWHILE * best.held_out) {
            break;
        }
        (orders, best) = (more, next);
        refine(&mut orders, &mut best, (first, last), apart_by, |orders| {
            fitted(&angles, &torques, orders, motion.ratio)
        });
    }
    let Fitted { held_out, ref residuals, ref waves, .. } = best;
    if !(held_out < MAX_HELD_OUT_SHARE * before) {
        return Err(CoggingError::Nothing { before, held_out });
    }
    let harmonic = |(order, (cosine, sine)): (&f64, &(f64, f64))| Harmonic {
        order: *order as u16,
        energy: (cosine.hypot(*sine) / (order * motion.ratio).abs()) as f32,
        // d/dq of E cos(n θ + φ) is -E n ratio (cos φ sin nθ + sin φ cos nθ).
        phase: (-cosine * motion.ratio.signum()).atan2(-sine * motion.ratio.signum()) as f32,
    };
    let points = (0..bins.len()).map(|i| (angles[i], torques[i] - trend[i], torques[i] - trend[i] - residuals[i]));
    Ok(Learnt {
        potential: orders.iter().zip(waves).map(harmonic).collect(),
        before,
        after: rms(residuals),
        held_out,
        friction: bins.iter().map(|(.., friction)| friction).sum::<f64>() / bins.len() as f64,
        points: points.collect(),
    })
}

/// Moves each order to a neighbour while that leaves smaller residuals: an order that was found before the others may
/// have taken a part of theirs.
fn refine(
    orders: &mut Vec<f64>,
    best: &mut Fitted,
    (first, last): (f64, f64),
    apart_by: f64,
    fitted: impl Fn(&[f64]) -> Fitted,
) {
    for _ in 0..MAX_MOVES {
        let neighbours = (0..orders.len()).flat_map(|i| [-1.0, 1.0].map(|by| (i, orders[i] + by)));
        let apart = |i: usize, order: f64| {
            orders.iter().enumerate().all(|(j, other)| i == j || (order - other).abs() >= apart_by)
        };
        let allowed = neighbours.filter(|(i, order)| (first..=last).contains(order) && apart(*i, *order));
        let moved = allowed.map(|(i, order)| {
            let mut moved = orders.clone();
            moved[i] = order;
            let fitted = fitted(&moved);
            (moved, fitted)
        });
        let Some((moved, next)) = moved.min_by(|a, b| rms(&a.1.residuals).total_cmp(&rms(&b.1.residuals))) else {
            return;
        };
        if rms(&next.residuals) >= MIN_IMPROVEMENT * rms(&best.residuals) {
            return;
        }
        (*orders, *best) = (moved, next);
    }
}

/// Returns angle, mean torque of both directions, and half the difference of the directions in every bin that both
/// directions have passed. Friction that depends on the angle cancels in the mean.
fn bins(passes: &[Pass], motion: &Motion) -> Vec<(f64, f64, f64)> {
    let all = || passes.iter().flat_map(|pass| &pass.samples).map(|sample| sample.q);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if !(high > low) {
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
