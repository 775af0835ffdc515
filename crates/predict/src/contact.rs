//! Simulates a device in a hand against a rendered wall, with encoder steps.
//!
//! The device moves by its complete equations with friction, cogging, transmissions and modes ([`Plant`]). Delay and
//! drives are those of a control loop. A `Law` renders the wall: the loop of a prediction ([`crate::ripple`]) or the
//! board's own step ([`crate::bench::wall`]). All simulations with encoder steps use this module.

use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_sim::{Load, Plant};
use haptic_stability::analysis::amplitudes::RIPPLE_HZ;
use haptic_stability::analysis::control_loop::Loop;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::plant::Lags;
use std::collections::VecDeque;

/// Longest integration steps for a rigid and for a compliant device, s.
const MAX_STEP_S: (f64, f64) = (50e-6, 25e-6);
/// Distance of the tip from its start along the normal at which the tip counts as lost, m.
const LOST_DISTANCE_M: f64 = 0.02;

/// A control law that renders a wall.
pub(crate) trait Law {
    /// Evaluates one control period from the encoder angles, rad.
    fn evaluate(&mut self, measured: &[f64; MAX_JOINTS]) -> LawOutput;
}

/// Wall force (N), and commanded torques (N m).
pub(crate) struct LawOutput {
    pub force: f64,
    pub torque: [f64; MAX_JOINTS],
}

/// Target position of a hand (m), and its additional push (N).
pub(crate) struct Grip {
    pub goal: [f64; MAX_JOINTS],
    pub push: [f64; MAX_JOINTS],
}

/// A contact without its wall.
pub(crate) struct Contact<'a> {
    pub plant: Plant,
    /// Unit normal of the wall.
    pub normal: [f64; MAX_JOINTS],
    pub around: &'a Loop,
    /// Commanded torques before the first period, N m.
    pub initial_torque: [f64; MAX_JOINTS],
    /// Additional motor torques without delay, N m.
    pub weight_torque: [f64; MAX_JOINTS],
    /// Damping and stiffness of the hand. Its mass is in the plant.
    pub hand: Hand,
}

impl<'a> Contact<'a> {
    /// Prepares the contact of a plant at rest in a control loop.
    pub fn new(plant: Plant, normal: [f64; MAX_JOINTS], around: &'a Loop, hand: Hand) -> Self {
        let none = [0.0; MAX_JOINTS];
        Self { plant, normal, around, initial_torque: none, weight_torque: none, hand }
    }

    /// Simulates `seconds` with the hand's `grip` at each time (s), or until `seen` returns false. Each period `seen`
    /// receives the wall's force (N) and the tip's displacement along the normal (m). Returns false if the tip flies
    /// off.
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
        let mut delayed: VecDeque<_> = (0..whole as usize).map(|_| self.initial_torque).collect();
        let (mut acting, mut torque) = (self.initial_torque, self.initial_torque);
        for n in 0..(seconds * rate_hz).round() as usize {
            let grip_now = grip(n as f64 * period);
            let LawOutput { force, torque: commanded } = law.evaluate(&self.plant.measured());
            delayed.push_back(commanded);
            let next = delayed.pop_front().unwrap_or(commanded);
            for (torques, time) in [(acting, fraction * period), (next, (1.0 - fraction) * period)] {
                self.advance(&torques, &mut torque, &lags, grip_now.as_ref(), time, period);
            }
            acting = next;
            let tip = self.plant.tip();
            let along: f64 = self.normal.iter().enumerate().map(|(i, n)| n * (tip[i] - tip0[i])).sum();
            if along.is_nan() || along.abs() >= LOST_DISTANCE_M {
                return false;
            }
            if !seen(force, along) {
                break;
            }
        }
        true
    }

    /// Simulates `time` (s) under commanded torques (N m). Updates `torque`, the state of the drives.
    fn advance(
        &mut self,
        torques: &[f64; MAX_JOINTS],
        torque: &mut [f64; MAX_JOINTS],
        lags: &Lags,
        grip_now: Option<&Grip>,
        time: f64,
        period: f64,
    ) {
        let longest = if self.plant.is_flexible() { MAX_STEP_S.1 } else { MAX_STEP_S.0 };
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
                load.torque[j] = mean + self.weight_torque[j];
            }
            if let Some(Grip { goal, push }) = grip_now {
                for i in 0..self.plant.task() {
                    load.force[i] = push[i] - self.hand.stiffness * (tip[i] - goal[i]) - self.hand.damping * speed[i];
                }
            }
            self.plant.step(&load, h);
        }
    }
}

/// Returns the root mean square and the peak-to-peak deviation of evenly spaced values from their fitted line.
pub(crate) fn deviation_from_line(values: &[f64]) -> (f64, f64) {
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

/// High-pass at [`RIPPLE_HZ`] for a force: subtracts two one-pole trends in series.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RippleFilter {
    share: f64,
    trends: [f64; 2],
}

impl RippleFilter {
    /// Creates a filter for a force at this sample rate, Hz, that was zero before.
    pub fn new(rate_hz: f64) -> Self {
        Self { share: 1.0 - (-std::f64::consts::TAU * RIPPLE_HZ / rate_hz).exp(), trends: [0.0; 2] }
    }

    /// Filters the next sample.
    pub fn filter(&mut self, force: f64) -> f64 {
        self.trends.iter_mut().fold(force, |left, trend| {
            *trend += self.share * (left - *trend);
            left - *trend
        })
    }
}
