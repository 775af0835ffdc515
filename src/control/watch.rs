//! Checks of each control step, which turn the motors off: numbers that are not finite, poses, index pulses, a silent
//! host. [`super::crest`] checks limits in every carrier period; [`super::budgets`] checks heat and stalls.

use super::{ControlLoop, HostAction, Press};
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::bits::{margin_bits, margin_bits_between};
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, FaultRecord};
use core::ops::DerefMut;

/// Lowest regularity of a closed loop (a sine, no unit) at which its tip force is defined well enough to act.
pub const MIN_PARALLEL_SINE: f32 = 2.0e-3;
/// Width of an index pulse, counts. The first pulse is used only if the joint moved by at most this width in the step.
pub const INDEX_WIDTH: u32 = 4;
/// Largest age of the last press of the dead man's key while the motors stay on, s; `host_seconds` if that is shorter.
/// Applies even if the rules ignore a silent host. A browser page takes up to 0.17 s to report the key.
pub const KEY_SECONDS: f32 = 0.5;
/// Share of a real motor's maximum current that may flow continuously if the rules set no continuous current. Half of
/// the current makes a quarter of the heat.
pub const CONTINUOUS_CURRENT_SHARE: f32 = 0.5;
/// Maximum number of steps until the host's silence is checked again: a quarter of the step counter's range.
const MAX_UNCHECKED_STEPS: u32 = 1 << 30;

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Sets the bounds of steps and carrier periods. Call after a change of device, homing or rate.
    pub(super) fn set_bounds(&mut self) {
        self.set_ranges();
        self.begin_bounds();
        self.finish_bounds();
    }

    /// Sets the device's bounds for new rules. Each [`ControlLoop::settle_next`] then sets the bounds of one joint.
    pub(super) fn begin_bounds(&mut self) {
        self.expect_host();
        let tip_force = self.rules.limits.tip_force;
        // Setting the same limit again must not give the present currents more time to fall.
        if tip_force * tip_force < self.max_tip_force_squared || !self.state.drives() {
            self.flow.settle(self.period);
        }
        self.set_max_tip_force(tip_force);
        self.set_crest_bounds();
        self.unsettled_joints = MAX_JOINTS as u8;
    }

    /// Sets the largest force at the tip, N.
    pub(super) fn set_max_tip_force(&mut self, force: f32) {
        (self.max_tip_force, self.max_tip_force_squared) = (force, force * force);
    }

    /// Applies the new rules to the next joint, and returns true if joints with the old rules remain. While the motors
    /// are on, a control interrupt has no time for all joints.
    #[inline(never)]
    pub fn settle_next(&mut self) -> bool {
        let Some(joint) = self.unsettled_joints.checked_sub(1) else { return false };
        self.unsettled_joints = joint;
        let (i, limits) = (usize::from(joint), &self.rules.limits);
        let lever = self.lever(i);
        if let (Some(joint), Some(heat)) = (self.joints.get_mut(i), self.heat.get_mut(i)) {
            joint.stage.limit(limits.current[i]);
            let (steady, motor) = (limits.continuous_current[i], joint.stage.motor_current());
            // A rule above the motor's maximum sets no continuous current: use the default share.
            let steady = if self.hardware.real && steady > motor { CONTINUOUS_CURRENT_SHARE * motor } else { steady };
            heat.limit(joint.stage.max_current(), steady);
            let largest = joint.stage.max_torque();
            joint.sums.set_limits(largest, limits.speed[i] * lever);
            self.max_joint_torque[i] = (limits.torque[i] / lever).min(largest).max(0.0);
            self.unclamped_torque[i] = torque_below(self.max_joint_torque[i]);
        }
        self.set_crest_bounds_of(i);
        joint > 0
    }

    /// Applies the new rules to all joints.
    pub(super) fn finish_bounds(&mut self) {
        while self.settle_next() {}
    }

    pub(super) fn record_host(&mut self) {
        self.host_seen_at = self.now.step;
        self.expect_host();
    }

    /// Returns the time since the last heartbeat, the start, a change of rules or arming, s.
    pub fn host_silence(&self) -> f32 {
        self.now.step.wrapping_sub(self.host_seen_at) as f32 * self.period
    }

    /// Records a press of the dead man's key. Its age counts from step `press.seen`, not from its arrival.
    pub(super) fn record_key(&mut self, press: Press) {
        let steps = |key: Press| self.now.step.wrapping_sub(key.seen);
        let newer = match self.key {
            Some(key) => key.holder == press.holder && steps(press) < steps(key),
            None => self.state.drives(),
        };
        if newer {
            self.key = Some(press);
        }
    }

    /// Returns the time since the key was last seen down and the longest allowed time, s; `None` without a key.
    pub fn key_age(&self) -> Option<(f32, f32)> {
        self.key.map(|key| self.press_age(key))
    }

    fn press_age(&self, key: Press) -> (f32, f32) {
        let steps = self.now.step.wrapping_sub(key.seen);
        (steps as f32 * self.period, self.rules.host_seconds.min(KEY_SECONDS))
    }

    /// Returns true if a key was seen down recently enough to keep the motors on.
    pub(super) fn is_fresh(&self, key: Press) -> bool {
        let (age, allowed) = self.press_age(key);
        // Steps before a change of rate had another length, so the key's age is unknown.
        let known = self.now.step.wrapping_sub(key.seen) <= self.now.step.wrapping_sub(self.rate_since);
        known && age <= allowed
    }

    /// Sets the step after which the silence of the host or its key is checked.
    fn expect_host(&mut self) {
        let key = match self.key_age() {
            Some((age, allowed)) => ((allowed - age) / self.period) as u32,
            None => MAX_UNCHECKED_STEPS,
        };
        let steps = match self.rules.host_action {
            HostAction::Ignore => MAX_UNCHECKED_STEPS,
            // The silence is already listed as a fault.
            HostAction::Hold if self.fault.is_some() => MAX_UNCHECKED_STEPS,
            HostAction::Hold | HostAction::Disarm => {
                (((self.rules.host_seconds - self.host_silence()) / self.period) as u32).min(MAX_UNCHECKED_STEPS)
            }
        };
        self.host_expected = self.now.step.wrapping_add(steps.min(key));
        self.forget_old_rates();
    }

    /// Keeps `rate_since` at most half of the step counter's range behind, so that the wrapping counter never reaches
    /// it. Steps in a host's request are never older.
    fn forget_old_rates(&mut self) {
        const HALF_RANGE: u32 = 1 << 31;
        if self.now.step.wrapping_sub(self.rate_since) > HALF_RANGE {
            self.rate_since = self.now.step.wrapping_sub(HALF_RANGE);
        }
    }

    /// Returns a negative number if the step of J joints must be checked for NaN, a singular pose or a silent host.
    /// [`ControlLoop::fits`] detects torques that are NaN.
    #[inline(always)]
    pub(super) fn watch<const J: usize>(&self) -> i32 {
        let found = &self.now.result;
        let mut sum = found.at.walls.wall_force + found.at.walls.normal_velocity;
        for qd in found.at.qd.iter().take(J) {
            sum += qd;
        }
        // A single check is sufficient: a sum of finite numbers this small is finite.
        margin_bits(sum, f32::MAX)
            | parallel_margin(found.parallel)
            | self.host_expected.wrapping_sub(self.now.step) as i32
    }

    /// Runs [`ControlLoop::watch`] for all joints, and checks that their torques are finite.
    pub(super) fn watch_all(&self) -> i32 {
        match self.count() {
            2 => self.watch::<2>() | self.finite_margin::<2>(),
            3 => self.watch::<3>() | self.finite_margin::<3>(),
            _ => self.watch::<1>() | self.finite_margin::<1>(),
        }
    }

    /// Returns a negative number if a requested torque of the J joints is NaN or infinite.
    #[inline(always)]
    pub(super) fn finite_margin<const J: usize>(&self) -> i32 {
        self.now.result.asked.total.iter().take(J).fold(0, |least, torque| least | margin_bits(*torque, f32::MAX))
    }

    /// Finds the first fault of an unusual step, and turns the motors off if the fault requires it. `before` are the
    /// previous counts.
    #[cold]
    #[inline(never)]
    pub(super) fn find_fault(&mut self, before: &Counts) {
        let active = self.state.drives();
        let joints = self.count();
        let mut first = None;
        let mut note = |wrong: bool, fault: Fault, axis: Option<usize>, value: f32| {
            if wrong && first.is_none() {
                first = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        // NaN is checked first because it makes every comparison below meaningless.
        let found = &self.now.result;
        let mut sum = found.at.walls.wall_force + found.at.walls.normal_velocity;
        for (qd, torque) in found.at.qd.iter().zip(&found.asked.total).take(joints) {
            sum += qd + torque;
        }
        note(!sum.is_finite(), Fault::NotFinite, None, sum);
        let marks = self.marks.take().unwrap_or_default();
        let counts = self.now.counts.iter().zip(before.iter());
        let learned = self.rules.index_period.iter().zip(&mut self.first_index);
        for (i, ((mark, (count, before)), (period, first))) in marks.iter().zip(counts).zip(learned).enumerate() {
            // A board may have more encoders than the device has joints.
            let (Some(at), true) = (*mark, *period > 0 && i < joints) else { continue };
            let moved = count.wrapping_sub(*before).unsigned_abs();
            match *first {
                Some(first) => {
                    let off = index_error(at, first, *period);
                    note(off > index_tolerance(moved), Fault::IndexMismatch, Some(i), off as f32);
                }
                None if moved <= INDEX_WIDTH => *first = Some(at),
                None => {}
            }
        }
        if active {
            let parallel = self.now.result.parallel;
            note(parallel_margin(parallel) < 0, Fault::Singularity, None, parallel);
            let seconds = self.host_silence();
            let silent = seconds > self.rules.host_seconds;
            match self.rules.host_action {
                HostAction::Disarm => note(silent, Fault::HostLost, None, seconds),
                // One record of the fault is sufficient.
                HostAction::Hold if silent && self.fault.is_none() => {
                    self.fault =
                        Some(FaultRecord { fault: Fault::HostLost, axis: None, value: seconds, step: self.now.step });
                }
                _ => {}
            }
            if let Some((age, allowed)) = self.key_age() {
                note(age > allowed, Fault::KeyReleased, None, age);
            }
        }
        self.expect_host();
        if let Some((fault, axis, value)) = first {
            self.trip(fault, axis, value);
        }
    }
}

/// Returns a torque slightly below `most` (N m), so that rounding on its way to a current does not exceed `most`.
fn torque_below(most: f32) -> f32 {
    if most.is_normal() { most * (1.0 - 8.0 * f32::EPSILON) } else { 0.0 }
}

/// Returns a negative number if a closed loop is so far stretched that its tip force is undefined, and for NaN.
#[inline(always)]
fn parallel_margin(parallel: f32) -> i32 {
    margin_bits_between(parallel, (MIN_PARALLEL_SINE, f32::MAX))
}

/// Returns the distance of an index pulse from the nearest multiple of `period` after the `first` pulse, counts.
fn index_error(count: i32, first: i32, period: i32) -> u32 {
    let off = count.wrapping_sub(first).checked_rem(period).unwrap_or(0).unsigned_abs();
    off.min(period.unsigned_abs().saturating_sub(off))
}

/// Returns the allowed error of an index pulse, counts: two pulse widths plus the joint's motion in this step.
fn index_tolerance(moved: u32) -> u32 {
    moved.saturating_add(2 * INDEX_WIDTH)
}
