//! The polarity check: before a real device is armed, each motor must swing its joint as the device file predicts.
//!
//! Angles below are those of a joint that turns; of a slide they are travels at its lever
//! ([`JointUnits::lever`](crate::model::units::JointUnits::lever)).
//!
//! The check relies on measurements only. An alternating torque grows from a twentieth of a newton at the tip until the
//! joint swings by a degree. No joint is therefore pushed harder than its inertia and friction need, even if the file
//! is wrong, and a joint with a dead encoder swings about its place instead of running away. If the torque that acted
//! is roughly the file's, a second swing measures it well (docs/safety.md, "What is measured before a board arms").
//!
//! Homing by stops (`stops`) pushes the joints one after the other in the same way.

mod alignment;
pub(super) mod stops;
mod swing;

use super::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, Real, clamp, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, State};
use crate::safety::refusal::Refusal;
use alignment::{Alignment, MAX_SWING_ELECTRICAL};
use core::ops::DerefMut;
use stops::Push;
use swing::{Results, Swing, effective_inertia, swing_angle};

/// Longest time that the check waits for a joint to come to rest before its swing, s, because a device almost without
/// friction glides for seconds.
const MAX_WAIT_FOR_REST: f32 = 5.0;
/// Shortest time between two steps of the check, s, because a step with the check's sums is long and the motion slow.
const CHECK_PERIOD: f32 = 1.0e-4;
/// Angle within which a joint at rest stays for [`MIN_REST_SECONDS`], rad. Speed does not show rest, because it is zero
/// between two counts of a coarse encoder.
const MAX_REST_MOTION: f32 = 2.0e-3;
const MIN_REST_SECONDS: f32 = 0.2;
/// Largest distance of a joint from its initial angle, rad, but at least [`MAX_STRAY_COUNTS`].
const MAX_STRAY_ANGLE: f32 = 0.1;
/// Distance of a joint from its initial angle that is always allowed, counts.
const MAX_STRAY_COUNTS: f32 = 8.0;
/// Largest distance of an undriven joint from its initial angle during a swing, rad.
const MAX_UNDRIVEN_ANGLE: f32 = 0.14;
/// Largest error of each joint's home angle with which the tip forces stay within their limits, rad.
const MAX_HOME_ERROR: f32 = 0.15;
/// Smallest factor by which possible home errors reduce the torque. Near a stretched pose the factor would be 0.
const MIN_HOME_ERROR_FACTOR: f32 = 0.4;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PolarityCheck {
    /// Number of the joint under test.
    axis: usize,
    swing: Option<Swing>,
    push: Option<Push>,
    /// Errors of the joint angles before homing by stops, rad.
    corrections: [f32; MAX_JOINTS],
    /// Time spent waiting for the joint to come to rest, s.
    wait_seconds: f32,
    /// Lowest and highest angle of the joint at rest, rad.
    rest_range: (f32, f32),
    /// Time that the joint has been at rest, s.
    rest_seconds: f32,
    /// Initial angles of all joints, rad.
    initial: Option<[f32; MAX_JOINTS]>,
    /// Number of neighbouring poses that were checked.
    poses_checked: u32,
    /// Largest tip force for 1 N m of the joint in the checked poses, N.
    force_per_torque: f32,
    /// Mass matrix at the swing's pose, kg m², once it is known.
    inertia: Option<[[f32; MAX_JOINTS]; MAX_JOINTS]>,
    /// Ratio of the joint's torque to the largest acceleration of any joint, kg m².
    effective_inertia: f32,
    /// Time between two steps of the check, s.
    step_period: f32,
    /// Number of control steps until the next step of the check.
    steps_left: u32,
    /// True if the next step waits for the valley.
    due: bool,
    /// Part of the comparison that the next step runs; 0 while the joint swings.
    part: u8,
    results: Results,
    /// Alignment of the joint's motor, if it has three phases.
    alignment: Alignment,
    /// Angles of all joints at the last sample, rad.
    q: [f32; MAX_JOINTS],
    /// Current of the joint's motor at the last sample, A.
    current: f32,
    voltage: f32,
    /// Commanded torques until the next step.
    commanded_torques: Torques,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    pub(super) fn start_polarity_check(&mut self) -> Result<(), Refusal> {
        self.check_ready()?;
        self.refuse_stray_current()?;
        self.polarity = PolarityCheck::default();
        self.polarity_known = false;
        self.restart_checks();
        self.state = State::CheckingPolarity;
        Ok(())
    }

    /// Returns the motors' torques in a control step, and samples the joints if a step of the check is due. The rest of
    /// that step runs at the valley, because a crest has no time for it at high rates.
    pub(super) fn check_polarity(&mut self) -> Torques {
        if let Some(left) = self.polarity.steps_left.checked_sub(1) {
            self.polarity.steps_left = left;
            return self.polarity.commanded_torques;
        }
        let steps = ((CHECK_PERIOD / self.period + 0.5) as u32).max(1);
        let (motors, i) = (&self.now.motors, self.axis());
        let polarity = &mut self.polarity;
        (polarity.steps_left, polarity.step_period) = (steps - 1, steps as f32 * self.period);
        (polarity.current, polarity.voltage) = (motors.current[i], motors.duty[i] * motors.bus_voltage);
        polarity.q = self.now.result.at.q;
        polarity.due = true;
        polarity.commanded_torques
    }

    /// Runs the rest of a due step of the check. Returns false if none is due.
    #[inline(always)]
    pub(super) fn check_polarity_at_valley(&mut self) -> bool {
        let due = matches!(self.state, State::CheckingPolarity | State::Homing) && self.polarity.due;
        if due {
            self.advance_check();
        }
        due
    }

    /// Returns the number of the joint under test, always a valid index.
    fn axis(&self) -> usize {
        self.polarity.axis.min(MAX_JOINTS - 1)
    }

    #[cold]
    #[inline(never)]
    fn advance_check(&mut self) {
        self.polarity.due = false;
        let torque = self.check_step();
        self.polarity.commanded_torques = torque;
        if self.state.drives() {
            self.command_test(&torque);
        }
    }

    /// Runs a step of the check and returns the motors' torques, which are zero while the check waits and at its end.
    fn check_step(&mut self) -> Torques {
        let none = Torques::default();
        let i = self.axis();
        let q = self.polarity.q;
        let from = *self.polarity.initial.get_or_insert(q);
        let moved: [f32; MAX_JOINTS] = core::array::from_fn(|j| q[j] - from[j]);
        let Some(program) = self.program.as_ref() else { return none };
        let (counts, lever) = (program.radians_per_count, program.lever);
        let (swung, pushed) = (self.polarity.swing.is_some(), self.polarity.push.is_some());
        let farthest = |j: usize| match j == i {
            true if pushed => f32::MAX,
            true if self.polarity.alignment.follows() => {
                Alignment::max_distance(self.joints[i].stage.electrical_ratio())
            }
            false if swung || pushed => lever[j] * MAX_UNDRIVEN_ANGLE,
            _ => lever[j] * MAX_STRAY_ANGLE,
        };
        let beyond = |j: &usize| margin_bits(moved[*j], farthest(*j).greater(MAX_STRAY_COUNTS * counts[*j].abs())) < 0;
        if let Some(j) = (0..self.count().min(MAX_JOINTS)).find(beyond) {
            match &self.polarity.swing {
                Some(Swing { angle, work, .. }) => {
                    let fault = if j == i && *work < 0.0 { Fault::PolarityWrong } else { Fault::TorqueMismatch };
                    self.trip(fault, Some(j as u8), moved[j] * lever[i] / (angle * lever[j]));
                }
                None if j == i && self.polarity.alignment.follows() => {
                    let rough = self.polarity.alignment.rough_pole_pairs(moved[i], &self.joints[i].stage);
                    self.trip(Fault::PolePairs, Some(i as u8), rough);
                }
                None if pushed => self.trip(Fault::StopMissing, Some(j as u8), moved[j]),
                None => self.trip(Fault::PolarityUnrest, Some(j as u8), moved[j]),
            }
            return none;
        }
        if self.polarity.alignment.follows() {
            return self.follow_field(moved[i], counts[i]);
        }
        if let Some(mut push) = self.polarity.push {
            let torques = self.push_to_stop(&mut push, &moved, &counts);
            // The next joint's check has no push yet.
            self.polarity.push = self.polarity.push.map(|_| push);
            return torques;
        }
        // Each part below has a step of its own, because steps at high rates have little time.
        if swung && self.polarity.part == 0 {
            return self.swing(&moved, &counts, &lever);
        }
        match (self.polarity.swing, self.polarity.inertia) {
            (Some(swing), _) => self.check_swings(&swing),
            (None, Some(inertia)) => {
                self.polarity.effective_inertia = effective_inertia(i, inertia, self.count(), &lever);
                if self.state == State::Homing {
                    (self.polarity.push, self.polarity.poses_checked) = (Some(Push::default()), 0);
                } else if !self.begin_aligning_swing() {
                    self.begin_first_swing();
                }
            }
            (None, None) if self.is_at_rest(self.polarity.step_period) => {
                if self.polarity.poses_checked < 1 << self.joint_count {
                    let corner = self.polarity.poses_checked;
                    let Some(force) = self.force_per_torque_at(corner) else { return none };
                    self.polarity.force_per_torque = self.polarity.force_per_torque.max(force);
                    self.polarity.poses_checked = corner + 1;
                    return none;
                }
                self.polarity.initial = Some(q);
                self.polarity.inertia = self.program.as_ref().map(|program| program.mechanism.inertia::<K>(&q));
            }
            (None, None) if self.polarity.wait_seconds >= MAX_WAIT_FOR_REST => {
                self.trip(Fault::PolarityUnrest, Some(i as u8), q[i] - self.polarity.rest_range.0);
            }
            (None, None) => {}
        }
        none
    }

    /// Returns the tip force (N) for 1 N m of joint `i` in the present pose.
    fn unit_force(&self, i: usize) -> f32 {
        let unit = Torques::from_fn(|j| f32::from(u8::from(j == i)));
        sqrt(self.leverage.force_squared(&unit))
    }

    /// Returns the larger of the joint's tip forces (N) for 1 N m in the present pose and at a corner of the range of
    /// home errors. Leverage is highest at a corner, because it grows towards singular poses.
    fn force_per_torque_at(&self, corner: u32) -> Option<f32> {
        let program = self.program.as_ref()?;
        let (i, here) = (self.axis(), self.unit_force(self.axis()));
        let unit = Torques::from_fn(|j| f32::from(u8::from(j == i)));
        let off = |j: usize| program.lever[j] * if corner >> j & 1 == 0 { MAX_HOME_ERROR } else { -MAX_HOME_ERROR };
        let leverage = program.mechanism.leverage::<K>(&core::array::from_fn(|j| self.polarity.q[j] + off(j)));
        let there = sqrt(leverage.force_squared(&unit));
        // `min` also drops the NaN of an impossible pose.
        Some(there.max(here).min(here / MIN_HOME_ERROR_FACTOR))
    }

    /// Returns the largest torque (N m) of the joint under test that stays within a tip force (N) in all nearby poses.
    fn most_torque(&self, tip_force: f32) -> f32 {
        let i = self.axis();
        let torque = tip_force / self.polarity.force_per_torque;
        torque.lesser(self.joints[i].stage.max_torque()).lesser(self.max_joint_torque[i])
    }

    /// Returns a torque (N m) of the joint under test, reduced to the tip's force limit here and in nearby poses.
    fn torques_within_tip_force(&self, wanted: f32) -> Torques {
        let i = self.axis();
        let tip_force = self.rules.limits.tip_force;
        let mut torque = Torques::default();
        torque[i] = clamp(wanted, self.most_torque(tip_force));
        torque[i] *= share_within(self.leverage.force_squared(&torque), tip_force);
        torque
    }

    /// Continues with the next joint. Ends the check with success after the last joint.
    fn continue_with_next_joint(&mut self) {
        let next = self.axis() + 1;
        if next < self.count() {
            let corrections = self.polarity.corrections;
            self.polarity = PolarityCheck { axis: next, corrections, ..PolarityCheck::default() };
        } else if self.state == State::Homing {
            self.finish_homing();
        } else {
            self.turn_motors_off();
            self.state = State::Disarmed;
            self.record_known_polarity();
        }
    }

    /// Records that the polarity is known, for the present home if the joint angles are known.
    pub(super) fn record_known_polarity(&mut self) {
        self.polarity_known = self.joints.iter().all(|joint| joint.stage.is_aligned());
        if let Some(program) = self.program.as_ref().filter(|_| self.placed) {
            self.checked_zero = program.controller.zero();
        }
    }

    /// Keeps the result of the check after homing if the new home is within one swing of the checked home, because the
    /// mass matrix of the check is valid only there.
    pub(super) fn keep_polarity_near_its_home(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        let zero = program.controller.zero();
        self.polarity_known &= program.radians_per_count.iter().enumerate().take(program.joints).all(|(i, radians)| {
            let off = zero[i].wrapping_sub(self.checked_zero[i]) as f32 * radians;
            let most = swing_angle(*radians, program.lever[i]);
            // A lost count also turns the frame of a three-phase motor.
            let stage = self.joints.get(i).map(|joint| &joint.stage).filter(|stage| stage.is_three_phase());
            off.abs() <= stage.map_or(most, |stage| most.lesser(MAX_SWING_ELECTRICAL / stage.electrical_ratio()))
        });
    }

    /// Returns true if the joint has come to rest. Call every `seconds`.
    fn is_at_rest(&mut self, seconds: f32) -> bool {
        let (q, lever) = (self.polarity.q[self.axis()], self.lever(self.axis()));
        let polarity = &mut self.polarity;
        polarity.wait_seconds += seconds;
        polarity.rest_seconds += seconds;
        // Lowest and highest angle both count, so a joint that a hand moves to and fro is not at rest.
        let (low, high) = (polarity.rest_range.0.min(q), polarity.rest_range.1.max(q));
        (polarity.rest_range, polarity.rest_seconds) = match high - low <= MAX_REST_MOTION * lever {
            true => ((low, high), polarity.rest_seconds),
            false => ((q, q), 0.0),
        };
        polarity.rest_seconds >= MIN_REST_SECONDS
    }
}
