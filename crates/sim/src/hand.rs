//! A hand that holds the tip: a mass between two springs with dampers, the grip (tip to hand) and the arm (hand to
//! aim).
//!
//! The intent is a path to follow or a force to push with, both along minimum-jerk segments (Flash and Hogan 1985).
//! Physiological tremor, if enabled, is a sum of sinusoids of 8-12 Hz whose phases come from the seed.

use super::random::Random;
use std::f64::consts::TAU;

/// A position (m) or force (N) that the intent reaches at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Waypoint {
    /// Time since the hand gripped the tip, s.
    pub time: f64,
    /// Position, m, or force, N. Only the first d (task dimension) entries are used.
    pub value: [f64; 3],
}

/// The hand's intention.
#[derive(Clone, Debug, PartialEq)]
pub enum Intent {
    /// No hand force.
    LetGo,
    /// Follow a path through these points, in order of time.
    Follow(Vec<Waypoint>),
    /// Push with these forces, in order of time, without the arm's stiffness.
    Push(Vec<Waypoint>),
    /// Go to this position (m), which [`Hand::lead`] changes, such as the position of a mouse.
    Lead([f64; 3]),
}

/// Natural frequency of the critically damped filter from a led hand's goal to its aim, rad/s. Its lag of 50 ms is
/// about the lag of an arm behind a mouse, and smooths the 60 positions per second of a mouse.
const LEAD_RATE_RAD_S: f64 = 40.0;

/// The mechanics of a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSettings {
    /// Moving mass of hand and forearm, kg.
    pub mass: f64,
    /// Grip stiffness, N/m.
    pub grip_stiffness: f64,
    /// Grip damping, N s/m.
    pub grip_damping: f64,
    /// Arm stiffness, N/m.
    pub arm_stiffness: f64,
    /// Arm damping, N s/m.
    pub arm_damping: f64,
    /// Amplitude of the tremor of the arm's aim along each axis, m.
    pub tremor: f64,
    /// Seed of the tremor's phases.
    pub seed: u64,
}

impl Default for HandSettings {
    /// Returns a relaxed pen grip and forearm (orders of magnitude after Kuchenbecker, Park and Niemeyer 2003).
    fn default() -> Self {
        Self {
            mass: 0.12,
            grip_stiffness: 1200.0,
            grip_damping: 6.0,
            arm_stiffness: 250.0,
            arm_damping: 10.0,
            tremor: 0.0,
            seed: 1,
        }
    }
}

/// A hand with its state.
#[derive(Clone, Debug)]
pub struct Hand {
    settings: HandSettings,
    intent: Intent,
    began: f64,
    position: [f64; 3],
    velocity: [f64; 3],
    aim: [f64; 3],
    aim_velocity: [f64; 3],
    tremor: Vec<Sinusoid>,
}

#[derive(Clone, Copy, Debug)]
struct Sinusoid {
    axis: usize,
    hz: f64,
    phase: f64,
}

/// Number of sinusoids per axis whose sum is the tremor.
const TREMOR_SINUSOIDS: usize = 3;

impl Hand {
    /// Creates a hand that grips the tip at `tip` (m) at the time `now` (s).
    pub fn new(settings: HandSettings, intent: Intent, tip: [f64; 3], now: f64) -> Self {
        let mut random = Random::new(settings.seed);
        let tremor = (0..3 * TREMOR_SINUSOIDS)
            .map(|i| Sinusoid { axis: i % 3, hz: random.between(8.0, 12.0), phase: random.between(0.0, TAU) })
            .collect();
        let at_rest = [0.0; 3];
        Self { settings, intent, began: now, position: tip, velocity: at_rest, aim: tip, aim_velocity: at_rest, tremor }
    }

    /// Leads the hand to `goal` (m) from its present position.
    pub fn lead(&mut self, goal: [f64; 3]) {
        if !matches!(self.intent, Intent::Lead(_)) {
            (self.aim, self.aim_velocity) = (self.position, [0.0; 3]);
        }
        self.intent = Intent::Lead(goal);
    }

    /// Returns the position that [`Hand::lead`] leads to, m.
    pub fn goal(&self) -> Option<[f64; 3]> {
        if let Intent::Lead(goal) = self.intent { Some(goal) } else { None }
    }

    /// Changes the intent of the hand from the time `now` (s) on.
    pub fn set_intent(&mut self, intent: Intent, now: f64) {
        (self.intent, self.began) = (intent, now);
        (self.aim, self.aim_velocity) = (self.position, [0.0; 3]);
    }
    /// Returns the position of the hand, m; `None` if the hand has let go of the tip.
    pub fn position(&self) -> Option<[f64; 3]> {
        (self.intent != Intent::LetGo).then_some(self.position)
    }
    /// Creates a hand that does not hold the tip.
    pub fn none() -> Self {
        Self::new(HandSettings::default(), Intent::LetGo, [0.0; 3], 0.0)
    }
    /// Advances the hand by `h` (s) and returns its force on the tip, N. `task` is the task dimension.
    pub fn step(&mut self, tip: &[f64; 3], tip_velocity: &[f64; 3], task: usize, now: f64, h: f64) -> [f64; 3] {
        let mut force = [0.0; 3];
        if self.intent == Intent::LetGo {
            return force;
        }
        let time = now - self.began;
        let s = &self.settings;
        let tremor = if s.tremor > 0.0 { self.tremor_at(time) } else { [0.0; 3] };
        for axis in 0..task {
            let grip = s.grip_stiffness * (self.position[axis] - tip[axis])
                + s.grip_damping * (self.velocity[axis] - tip_velocity[axis]);
            let arm = match &self.intent {
                Intent::LetGo => 0.0,
                Intent::Follow(path) => {
                    let (aim, aim_velocity) = minimum_jerk(path, axis, time);
                    s.arm_stiffness * (aim + tremor[axis] - self.position[axis])
                        + s.arm_damping * (aim_velocity - self.velocity[axis])
                }
                Intent::Lead(goal) => {
                    let lag = LEAD_RATE_RAD_S
                        * (LEAD_RATE_RAD_S * (goal[axis] - self.aim[axis]) - 2.0 * self.aim_velocity[axis]);
                    self.aim_velocity[axis] += h * lag;
                    self.aim[axis] += h * self.aim_velocity[axis];
                    s.arm_stiffness * (self.aim[axis] + tremor[axis] - self.position[axis])
                        + s.arm_damping * (self.aim_velocity[axis] - self.velocity[axis])
                }
                Intent::Push(forces) => {
                    minimum_jerk(forces, axis, time).0 + s.arm_stiffness * tremor[axis]
                        - s.arm_damping * self.velocity[axis]
                }
            };
            force[axis] = grip;
            self.velocity[axis] += h * (arm - grip) / s.mass;
            self.position[axis] += h * self.velocity[axis];
        }
        force
    }

    fn tremor_at(&self, time: f64) -> [f64; 3] {
        let mut aim = [0.0; 3];
        for Sinusoid { axis, hz, phase } in &self.tremor {
            aim[*axis] += self.settings.tremor / TREMOR_SINUSOIDS as f64 * (TAU * hz * time + phase).sin();
        }
        aim
    }
}

/// Returns value and rate of the minimum-jerk segments through `points` at `time` (s), along one axis.
fn minimum_jerk(points: &[Waypoint], axis: usize, time: f64) -> (f64, f64) {
    let next = points.partition_point(|point| point.time <= time);
    let Some(to) = points.get(next) else {
        return (points.last().map_or(0.0, |last| last.value[axis]), 0.0);
    };
    let Some(from) = next.checked_sub(1).and_then(|before| points.get(before)) else {
        return (to.value[axis], 0.0);
    };
    let duration = to.time - from.time;
    let s = (time - from.time) / duration;
    let distance = to.value[axis] - from.value[axis];
    let travelled = s * s * s * (10.0 - s * (15.0 - 6.0 * s));
    let rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) / duration;
    (from.value[axis] + distance * travelled, distance * rate)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: [Waypoint; 2] =
        [Waypoint { time: 1.0, value: [0.0, 2.0, 0.0] }, Waypoint { time: 3.0, value: [1.0, 2.0, 0.0] }];

    #[test]
    fn a_minimum_jerk_segment_is_at_rest_at_its_ends() {
        assert_eq!(minimum_jerk(&PATH, 0, 0.5), (0.0, 0.0));
        assert_eq!(minimum_jerk(&PATH, 0, 1.0), (0.0, 0.0));
        // After half of the time the segment is half way and has 15/8 of the mean speed (Flash and Hogan).
        let (value, rate) = minimum_jerk(&PATH, 0, 2.0);
        assert!((value - 0.5).abs() < 1e-15 && (rate - 0.5 * 15.0 / 8.0).abs() < 1e-15);
        assert_eq!(minimum_jerk(&PATH, 0, 3.5), (1.0, 0.0));
        assert_eq!(minimum_jerk(&PATH, 1, 2.2), (2.0, 0.0));
    }

    #[test]
    fn a_push_on_a_blocked_tip_settles_at_its_force() {
        let push = Intent::Push(vec![Waypoint { time: 0.0, value: [0.0, -3.0, 0.0] }]);
        let mut hand = Hand::new(HandSettings::default(), push, [0.1, 0.2, 0.0], 0.0);
        let mut force = [0.0; 3];
        for i in 0..200_000 {
            force = hand.step(&[0.1, 0.2, 0.0], &[0.0; 3], 2, f64::from(i) * 1e-5, 1e-5);
        }
        assert!(force[0].abs() < 1e-9 && (force[1] + 3.0).abs() < 1e-6, "{force:?}");
    }

    #[test]
    fn a_led_hand_at_rest_pulls_with_arm_and_grip_in_series() {
        let mut hand = Hand::new(HandSettings::default(), Intent::LetGo, [0.1, 0.2, 0.0], 0.0);
        assert_eq!(hand.position(), None);
        hand.lead([0.1, 0.19, 0.0]);
        let mut force = [0.0; 3];
        for i in 0..200_000 {
            force = hand.step(&[0.1, 0.2, 0.0], &[0.0; 3], 2, f64::from(i) * 1e-5, 1e-5);
        }
        // Arm (250 N/m) and grip (1200 N/m) are springs in series, stretched by 1 cm together.
        let pull = 0.01 / (1.0 / 250.0 + 1.0 / 1200.0);
        assert!(force[0].abs() < 1e-9 && (force[1] + pull).abs() < 1e-6, "{force:?}");
        assert!((hand.position().unwrap()[1] - (0.2 - pull / 1200.0)).abs() < 1e-6);
    }

    #[test]
    fn tremor_depends_only_on_its_seed() {
        let hand = |seed| {
            let settings = HandSettings { tremor: 1e-3, seed, ..HandSettings::default() };
            let mut hand = Hand::new(settings, Intent::Follow(PATH.to_vec()), [0.0; 3], 0.0);
            (0..100).map(|i| hand.step(&[0.0; 3], &[0.0; 3], 2, f64::from(i) * 1e-4, 1e-4)).last()
        };
        assert_eq!(hand(7), hand(7));
        assert_ne!(hand(7), hand(8));
    }
}
