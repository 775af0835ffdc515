//! What encoder steps make of a wall that is pressed: by simulation, because a quantiser is not linear.
//!
//! A hand presses the wall with a steady force. The device moves by its full equations with its friction, cogging,
//! transmissions and modes ([`Plant`]); around it is the loop of the prediction: its delay, drive, estimator and
//! feed-forward, linearised at the pose, with one thing more: each joint's angle comes in steps of its encoder. A
//! static wall is unilateral. Without friction there is no equilibrium between two counts, so there always is a limit
//! cycle; where friction holds more than a count's force there is none (Abbott and Okamura 2005). Its size depends on
//! where in a count the pose lies, so each wall is tried with several offsets of the counts, and the largest ripple is
//! taken. The board's own step, with estimators that are not linear, is simulated in [`crate::bench::estimators`].

use std::collections::VecDeque;

use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Description;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::flexible::Hand;
use super::plant::{Lags, Linearised};
use super::sampled::{Loop, Mode, OpenLoop};
use crate::error::Failure;
use crate::sim::{Load, Plant};
use crate::sweep::Sweep;
use crate::vectors::padded;

/// A light hand that is there where none is asked for; it presses with [`PUSH_N`].
pub const LIGHT_HAND: Hand = Hand { mass: 0.05, damping: 3.0, stiffness: 200.0 };
/// What the hand presses with, N.
pub const PUSH_N: f64 = 3.0;
/// The hand presses ever harder, N/s: what friction holds only where nothing moves is no wall at rest.
pub(crate) const RISE: f64 = 1.0;
/// Time in which the motion settles, and in which it is looked at, s.
pub(crate) const SETTLE_S: f64 = 0.5;
pub(crate) const LOOK_S: f64 = 0.3;
/// Longest steps of the simulation, s: of a rigid device, and of one that gives.
const STEP_S: (f64, f64) = (50e-6, 25e-6);
/// A tip this far from the wall's surface is lost, m.
const FAR_M: f64 = 0.02;
/// How many offsets of the counts are tried.
pub(crate) const OFFSETS: usize = 4;
/// Walls along a line: how far below the stiffest, and how many in a decade.
const DECADES: usize = 4;
const PER_DECADE: usize = 5;
/// Ratio to which the stiffness is found from which the ripple exceeds a bound.
const CLOSE: f64 = 1.05;

/// What a pressed wall does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ripple {
    /// N/m
    pub kp: f64,
    /// N s/m
    pub kd: f64,
    /// Root mean square of the wall's force about its mean, N; none where the tip flies off.
    pub rms_n: Option<f64>,
    /// Half of what lies between its largest and its smallest value, N.
    pub peak_n: Option<f64>,
    /// How far the tip moves along the normal, from one side to the other, m.
    pub motion_m: Option<f64>,
}

impl Ripple {
    /// Whether the root mean square stays within a bound, N.
    pub fn within(&self, bound_n: f64) -> bool {
        self.rms_n.is_some_and(|rms| rms <= bound_n)
    }
}

/// Which damping goes with a stiffness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DampingRule {
    /// This share of the critical damping of what the wall meets, kd = 2 ζ √(kp m).
    Ratio(f64),
    /// This damping, N s/m.
    Damping(f64),
}

/// Where the ripple of walls along a line exceeds a bound.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Along {
    /// The largest stiffness up to which every wall on the line is stable by linear theory, N/m.
    pub kp_stable: f64,
    /// The stiffness from which the ripple exceeds the bound, N/m; none where no wall tried does.
    pub kp_from: Option<f64>,
    /// What was tried, by stiffness.
    pub points: Vec<Ripple>,
}

/// What is pressed, and by whom.
#[derive(Clone, Debug)]
pub struct Pressed<'a> {
    /// The device as the wall sees it.
    pub device: &'a Linearised,
    /// The same with all that is not linear about it.
    pub description: Description,
    /// Pose, rad.
    pub q: Vec<f64>,
    /// Unit normal, d entries.
    pub normal: Vec<f64>,
    /// The loop.
    pub around: &'a Loop,
    /// Who presses.
    pub hand: Hand,
    /// How hard, N.
    pub push_n: f64,
}

impl Pressed<'_> {
    /// What one count of the coarsest joint moves along the normal, m; none where a joint has no encoder.
    pub fn count_m(&self) -> Option<f64> {
        let steps = self.resolutions()?;
        Some(steps.iter().zip(self.device.row.iter()).map(|(step, lever)| (step * lever).abs()).fold(0.0, f64::max))
    }

    /// The largest force that one count alone makes: what the wall's spring and its damper, through the estimator,
    /// answer to a step of the position, N.
    pub fn step_n(&self, kp: f64, kd: f64) -> Option<f64> {
        Some(self.count_m()? * (kp + kd * self.around.estimator.quickest(self.around.rate_hz)))
    }

    fn resolutions(&self) -> Option<Vec<f64>> {
        let joints = self.device.row.len();
        let counts =
            self.description.joints[..joints].iter().map(|joint| joint.encoder.map(|e| e.counts_per_turn.abs()));
        counts.map(|counts| counts.map(|counts| std::f64::consts::TAU / counts)).collect()
    }

    /// What a wall does under the hand; `None` where a joint has no encoder.
    pub fn ripple(&self, mode: Mode, kp: f64, kd: f64) -> Option<Ripple> {
        let steps = self.resolutions()?;
        let lost = Ripple { kp, kd, rms_n: None, peak_n: None, motion_m: None };
        let mut worst = Ripple { rms_n: Some(0.0), peak_n: Some(0.0), motion_m: Some(0.0), ..lost };
        for offset in 0..OFFSETS {
            let Some(found) = self.run(&steps, mode, kp, kd, offset as f64 / OFFSETS as f64) else { return Some(lost) };
            let most = |a: Option<f64>, b: f64| a.map(|a| a.max(b));
            worst = Ripple {
                rms_n: most(worst.rms_n, found[0]),
                peak_n: most(worst.peak_n, found[1]),
                motion_m: most(worst.motion_m, found[2]),
                ..lost
            };
        }
        Some(worst)
    }

    /// The walls along `line` and where their ripple exceeds `bound_n`. `None`
    /// where a joint has no encoder.
    pub fn along(&self, mode: Mode, line: DampingRule, bound_n: f64, sweep: &Sweep) -> Result<Option<Along>, Failure> {
        if self.resolutions().is_none() {
            return Ok(None);
        }
        let open = OpenLoop::new(self.device, self.around, mode)?;
        let mass = open.mass;
        let damping = |kp: f64| match line {
            DampingRule::Ratio(ratio) => 2.0 * ratio * (kp * mass).sqrt(),
            DampingRule::Damping(kd) => kd,
        };
        let t = open.sample_s;
        let stable = |kp: f64| open.is_stable(kp * t * t / mass, damping(kp) * t / mass);
        // The largest that any loop of this rate can hold is of the order of m/T².
        let (mut low, mut high) = (0.0, 4.0 * mass / (t * t));
        let fine = 64;
        for i in 0..=8 * fine {
            let kp = 4.0 * mass / (t * t) * 10_f64.powf(f64::from(i) / f64::from(fine) - 8.0);
            if !stable(kp) {
                high = kp;
                break;
            }
            low = kp;
        }
        while low > 0.0 && high / low > 1.0 + 1e-6 {
            let middle = (low * high).sqrt();
            if stable(middle) { low = middle } else { high = middle }
        }
        let tried: Vec<f64> = (0..=DECADES * PER_DECADE)
            .map(|i| low * 10_f64.powf(i as f64 / PER_DECADE as f64 - DECADES as f64))
            .filter(|kp| *kp > 0.0)
            .collect();
        let wall = |kp: &f64| self.ripple(mode, *kp, damping(*kp));
        let stage = format!("ripple of walls, {mode:?}, {line:?}");
        let mut points: Vec<Ripple> = sweep.map(&stage, &tried, |kp| Ok(wall(kp)))?.into_iter().flatten().collect();
        let over = points.iter().position(|point| !point.within(bound_n));
        let kp_from = over.map(|at| {
            let mut high = points[at].kp;
            let Some(before) = at.checked_sub(1) else { return high };
            let mut low = points[before].kp;
            while high / low > CLOSE {
                let middle = (low * high).sqrt();
                let Some(point) = wall(&middle) else { break };
                if point.within(bound_n) {
                    low = middle
                } else {
                    high = middle
                }
                points.push(point);
            }
            high
        });
        points.sort_by(|a, b| a.kp.total_cmp(&b.kp));
        Ok(Some(Along { kp_stable: low, kp_from, points }))
    }

    /// Simulates a wall: root mean square and peak of its force, N, and how far the tip moves, m. `None` where it flies
    /// off.
    fn run(&self, steps: &[f64], mode: Mode, kp: f64, kd: f64, offset: f64) -> Option<[f64; 3]> {
        let joints = steps.len();
        let mut held = self.description;
        held.handle_mass += self.hand.mass;
        let q0: [f64; MAX_JOINTS] = padded(&self.q);
        let mut plant = Plant::new(&held, q0, true, [(f64::NEG_INFINITY, f64::INFINITY); 3]).ok()?;
        let (tip0, weight) = (plant.tip(), plant.gravity());
        let period = 1.0 / self.around.rate_hz;
        let lags = Lags::new(&self.around.drive, joints, period);
        let estimator = self.around.estimator.matrix(self.around.rate_hz);
        let states = estimator.nrows() - 1;
        let mut memory = DVector::zeros(states + 2);
        let row = &self.device.row;
        let shaped = self.device.shaped_torque();
        let mobility = self.device.mass.clone().cholesky()?.inverse();
        let gives = row.dot(&(&mobility * row));
        let gives_shaped = row.dot(&(&mobility * &shaped));
        // Half a turn of each joint's count by itself, so that joints do not step together.
        let origin = |j: usize| (offset + 0.37 * j as f64).fract();
        let angle = |j: usize, q: f64| (((q - q0[j]) / steps[j] - origin(j)).round() + origin(j)) * steps[j];
        // At the start the wall holds the hand.
        let surface = if kp > 0.0 { -self.push_n / kp } else { 0.0 };
        let (mut before, mut low, mut asked) =
            ((0..joints).map(|j| row[j] * angle(j, q0[j])).sum::<f64>(), 0.0, [0.0; 2]);
        if let Mode::Washout(_) = mode {
            low = self.push_n;
        }
        let whole = self.around.delay_samples.floor();
        let fraction = self.around.delay_samples - whole;
        let at_rest = row * self.push_n;
        let mut waiting: VecDeque<DVector<f64>> = (0..whole as usize).map(|_| at_rest.clone()).collect();
        let (mut acting, mut torque) = (at_rest.clone(), at_rest);
        let against = self.against(mode, &mobility, &shaped)?;
        let longest = if self.description.is_flexible() { STEP_S.1 } else { STEP_S.0 };
        let total = ((SETTLE_S + LOOK_S) * self.around.rate_hz).round() as usize;
        let settle = (SETTLE_S * self.around.rate_hz).round() as usize;
        let (mut forces, mut tips) = (Vec::with_capacity(total - settle), Vec::with_capacity(total - settle));
        for n in 0..total {
            let measured = plant.measured();
            let x: f64 = (0..joints).map(|j| row[j] * angle(j, measured[j])).sum();
            memory[states] = x - before;
            // The velocity per sample that the last command gave.
            memory[states + 1] = period * period * (gives * asked[0] + gives_shaped * asked[1]);
            before = x;
            let change = &estimator * &memory;
            for state in 0..states {
                memory[state] += change[state];
            }
            let force = (-kp * (surface + x) - kd * change[states] / period).max(0.0);
            asked = match mode {
                Mode::Off => [force, 0.0],
                Mode::Full => [0.0, force],
                Mode::Washout(hz) => {
                    let g = (std::f64::consts::PI * hz * period).tan();
                    let step = (force - low) * g / (1.0 + g);
                    let washed = force - (low + step);
                    low += 2.0 * step;
                    [force - washed, washed]
                }
            };
            waiting.push_back(row * asked[0] + &shaped * asked[1]);
            let next = waiting.pop_front()?;
            let push = &against * (self.push_n + RISE * n as f64 * period);
            for (torques, time) in [(acting.clone(), fraction * period), (next.clone(), (1.0 - fraction) * period)] {
                self.advance(&mut plant, &torques, &mut torque, &lags, &weight, &tip0, &push, time, longest, period);
            }
            acting = next;
            let tip = plant.tip();
            let along: f64 = self.normal.iter().enumerate().map(|(i, n)| n * (tip[i] - tip0[i])).sum();
            if along.is_nan() || along.abs() >= FAR_M {
                return None;
            }
            if n >= settle {
                forces.push(force);
                tips.push(along);
            }
        }
        let (rms, force) = about_its_line(&forces);
        Some([rms, 0.5 * force, about_its_line(&tips).1])
    }

    /// What a hand presses with that keeps the tip where it is, per newton of wall, d entries: along the normal, and
    /// against the feed-forward's steady push sideways, Λ J M⁻¹ of its torques. If the hand let the tip be pushed
    /// aside, it would press another wall: its spring would give way by millimetres, too far for the linearised loop.
    fn against(&self, mode: Mode, mobility: &DMatrix<f64>, shaped: &DVector<f64>) -> Option<DVector<f64>> {
        let normal = DVector::from_column_slice(&self.normal);
        // A washout has no steady push.
        if mode != Mode::Full {
            return Some(normal);
        }
        let tip = &self.device.flexible.tip;
        Some((tip * mobility * tip.transpose()).cholesky()?.solve(&(tip * mobility * shaped)))
    }

    /// Lets `time` (s) pass under commanded `torques`, N m beside what carries the device; `torque` is what the drives
    /// give.
    #[allow(clippy::too_many_arguments)]
    fn advance(
        &self,
        plant: &mut Plant,
        torques: &DVector<f64>,
        torque: &mut DVector<f64>,
        lags: &Lags,
        weight: &[f64; 3],
        tip0: &[f64; 3],
        push: &DVector<f64>,
        time: f64,
        longest: f64,
        period: f64,
    ) {
        let pieces = (time / longest).ceil();
        if pieces == 0.0 {
            return;
        }
        let h = time / pieces;
        for _ in 0..pieces as usize {
            let (tip, speed, turning) = (plant.tip(), plant.tip_velocity(), plant.motor_velocity());
            let mut load = Load::default();
            for j in 0..torques.len() {
                let mean = match lags.rate[j] {
                    None => {
                        load.damping[j] = lags.emf[j];
                        torques[j]
                    }
                    Some(rate) => {
                        let passed = rate * h / period;
                        let settled = torques[j] - lags.emf[j] * turning[j];
                        let excess = torque[j] - settled;
                        torque[j] = settled + excess * (-passed).exp();
                        settled + excess * -(-passed).exp_m1() / passed
                    }
                };
                load.torque[j] = mean + weight[j];
            }
            for (i, push) in push.iter().enumerate() {
                load.force[i] = -push - self.hand.stiffness * (tip[i] - tip0[i]) - self.hand.damping * speed[i];
            }
            plant.step(&load, h);
        }
    }
}

/// What is left of evenly spaced values beside the straight line through them: root mean square, and from the smallest
/// to the largest.
pub(crate) fn about_its_line(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let middle = 0.5 * (count - 1.0);
    let mean = values.iter().sum::<f64>() / count;
    let moment: f64 = values.iter().enumerate().map(|(i, value)| (i as f64 - middle) * value).sum();
    let slope = moment / (count * (count * count - 1.0) / 12.0).max(f64::MIN_POSITIVE);
    let left = values.iter().enumerate().map(|(i, value)| value - mean - slope * (i as f64 - middle));
    let (square, low, high) = left.fold((0.0, f64::INFINITY, f64::NEG_INFINITY), |(square, low, high), left| {
        (square + left * left, left.min(low), left.max(high))
    });
    ((square / count).sqrt(), high - low)
}

impl super::sampled::LinearEstimator {
    /// The largest velocity that it says of a step of the position, for each metre of the step, 1/s.
    pub fn quickest(self, rate_hz: f64) -> f64 {
        let matrix: DMatrix<f64> = self.matrix(rate_hz);
        let states = matrix.nrows() - 1;
        let mut memory = DVector::zeros(states + 2);
        let mut most: f64 = 0.0;
        // The answer of a low-pass to a step ends before ten of its periods have passed.
        let cutoff = self.cutoff_hz().unwrap_or(rate_hz);
        let samples = (10.0 * rate_hz / cutoff).ceil() as usize + self.samples();
        for n in 0..samples {
            memory[states] = if n == 0 { 1.0 } else { 0.0 };
            let change = &matrix * &memory;
            for state in 0..states {
                memory[state] += change[state];
            }
            most = most.max(change[states].abs());
        }
        most * rate_hz
    }
}
