//! A device in a hand against a rendered wall, simulated with the steps of its encoders.
//!
//! The device moves by its full equations with its friction, cogging, transmissions and modes ([`Plant`]). Around it
//! are the delay and the drives of a loop. A `Law` renders the wall: that of a prediction ([`crate::ripple`]), or the
//! board's own step ([`crate::bench::wall`]). All that is said of encoder steps by simulation comes from here.

use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_sim::{Load, Plant};
use haptic_stability::analysis::amplitudes::RIPPLE_HZ;
use haptic_stability::analysis::control_loop::Loop;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::plant::Lags;
use std::collections::VecDeque;

/// Longest steps of the simulation, s: of a rigid device, and of one that gives.
const STEP_S: (f64, f64) = (50e-6, 25e-6);
/// A tip this far from where it began, along the normal, is lost, m.
const FAR_M: f64 = 0.02;

/// A control law that renders a wall.
pub(crate) trait Law {
    /// The answer in one control period to the angles at the encoders, rad.
    fn answer(&mut self, measured: &[f64; MAX_JOINTS]) -> Answer;
}

/// The wall's force, N, and the torques that are commanded, N m.
pub(crate) struct Answer {
    pub force: f64,
    pub torque: [f64; MAX_JOINTS],
}

/// The position that a hand aims at, m, and the force with which it pushes besides, N.
pub(crate) struct Grip {
    pub goal: [f64; MAX_JOINTS],
    pub push: [f64; MAX_JOINTS],
}

/// Everything about a contact but the wall.
pub(crate) struct Contact<'a> {
    pub plant: Plant,
    /// Unit normal of the wall.
    pub normal: [f64; MAX_JOINTS],
    pub around: &'a Loop,
    /// The torques that were commanded before the first period, N m.
    pub before: [f64; MAX_JOINTS],
    /// The torques that the motors give besides, without delay, N m.
    pub carried: [f64; MAX_JOINTS],
    /// Its damping and its spring; its mass is the plant's.
    pub hand: Hand,
}

impl<'a> Contact<'a> {
    /// Of a plant at rest in a loop.
    pub fn new(plant: Plant, normal: [f64; MAX_JOINTS], around: &'a Loop, hand: Hand) -> Self {
        let none = [0.0; MAX_JOINTS];
        Self { plant, normal, around, before: none, carried: none, hand }
    }

    /// Runs so many seconds under a law and what `grip` holds at each time (s), until `seen` says false. It sees each
    /// period: the wall's force (N) and how far the tip is along the normal at the period's end (m). False where the
    /// tip flies off.
    pub fn run(
        mut self,
        law: &mut dyn Law,
        seconds: f64,
        grip: impl Fn(f64) -> Option<Grip>,
        mut seen: impl FnMut(f64, f64) -> bool,
    ) -> bool {
        let Loop { rate_hz, delay_samples, drive, .. } = self.around;
        let period = 1.0 / rate_hz;
        let lags = Lags::new(drive, self.plant.joints(), period);
        let tip0 = self.plant.tip();
        let whole = delay_samples.floor();
        let fraction = delay_samples - whole;
        let mut waiting: VecDeque<_> = (0..whole as usize).map(|_| self.before).collect();
        let (mut acting, mut torque) = (self.before, self.before);
        for n in 0..(seconds * rate_hz).round() as usize {
            let held = grip(n as f64 * period);
            let Answer { force, torque: asked } = law.answer(&self.plant.measured());
            waiting.push_back(asked);
            let next = waiting.pop_front().unwrap_or(asked);
            for (torques, time) in [(acting, fraction * period), (next, (1.0 - fraction) * period)] {
                self.advance(&torques, &mut torque, &lags, held.as_ref(), time, period);
            }
            acting = next;
            let tip = self.plant.tip();
            let along: f64 = self.normal.iter().enumerate().map(|(i, n)| n * (tip[i] - tip0[i])).sum();
            if along.is_nan() || along.abs() >= FAR_M {
                return false;
            }
            if !seen(force, along) {
                break;
            }
        }
        true
    }

    /// Lets `time` (s) pass under commanded torques, N m; `torque` is what the drives give.
    fn advance(
        &mut self,
        torques: &[f64; MAX_JOINTS],
        torque: &mut [f64; MAX_JOINTS],
        lags: &Lags,
        held: Option<&Grip>,
        time: f64,
        period: f64,
    ) {
        let longest = if self.plant.is_flexible() { STEP_S.1 } else { STEP_S.0 };
        let pieces = (time / longest).ceil();
        if pieces == 0.0 {
            return;
        }
        let h = time / pieces;
        for _ in 0..pieces as usize {
            let (tip, speed, turning) = (self.plant.tip(), self.plant.tip_velocity(), self.plant.motor_velocity());
            let mut load = Load::default();
            for j in 0..self.plant.joints() {
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
                load.torque[j] = mean + self.carried[j];
            }
            if let Some(Grip { goal, push }) = held {
                for i in 0..self.plant.task() {
                    load.force[i] = push[i] - self.hand.stiffness * (tip[i] - goal[i]) - self.hand.damping * speed[i];
                }
            }
            self.plant.step(&load, h);
        }
    }
}

/// The deviation of evenly spaced values from the straight line through them: root mean square, and from the smallest
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

/// The part of a force above [`RIPPLE_HZ`]: the force less a trend that two poles in series make of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fast {
    share: f64,
    trends: [f64; 2],
}

impl Fast {
    /// Of a force that is sampled at this rate and was zero before.
    pub fn new(rate_hz: f64) -> Self {
        Self { share: 1.0 - (-std::f64::consts::TAU * RIPPLE_HZ / rate_hz).exp(), trends: [0.0; 2] }
    }

    /// The part of the next sample.
    pub fn of(&mut self, force: f64) -> f64 {
        self.trends.iter_mut().fold(force, |left, trend| {
            *trend += self.share * (left - *trend);
            left - *trend
        })
    }
}
