//! Everything that must turn the motors off, looked for once a control step.
//!
//! Every step asks of every joint whether all is well, by comparing with [`Bounds`] made ready beforehand. What builds
//! up over many steps (heat, stalls, lost encoders) is looked at for one joint a step, in turn. Only when something is
//! not well is it found out what: that is rare, and may take longer.

use super::{HostAction, Servo};
use crate::drive::brushed::limited;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::Regularity;
use crate::safety::fault::{Fault, FaultRecord, State};
use crate::safety::limits::POWER_SECONDS;
use crate::servo::frame::Samples;
use crate::servo::program::{MOST_JOINTS, Program};
use core::ops::DerefMut;

/// Regularity of a closed loop below which its tip force is no longer defined well enough to act.
pub const SINGULAR_SINE: f32 = 2.0e-3;
/// Width of an index pulse, counts; the first one counts only if it was passed no faster than this in a step.
pub const INDEX_WIDTH: u32 = 4;
/// How long torque near its limit without any encoder motion is believed, s.
pub const STALL_SECONDS: f32 = 5.0;
/// How long an encoder may stand still while the back-EMF says the joint turns, s.
pub const LOSS_SECONDS: f32 = 0.05;

/// A fault, its axis and its number.
type Found = (Fault, Option<u8>, f32);

/// What the steps are held to, made ready whenever device, rules or rate change.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bounds {
    /// Most counts that a joint can move in a step.
    jump: [u32; MAX_JOINTS],
    /// rad/s
    speed: [f32; MAX_JOINTS],
    /// Middle of each joint's range, rad, and what it may be left by.
    middle: [f32; MAX_JOINTS],
    half: [f32; MAX_JOINTS],
    /// Measured current that is not the loop's overshoot any more, A.
    current: [f32; MAX_JOINTS],
    /// Torque that moves a joint unless it is blocked, N m.
    stall: [f32; MAX_JOINTS],
}

/// What builds up over many steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Budgets {
    /// The joint whose turn it is.
    joint: usize,
    /// Its encoder's count at its last turn.
    counts: [i32; MAX_JOINTS],
    /// Squares of each motor's current since its last turn, A².
    squares: [f32; MAX_JOINTS],
    /// Time without a count in spite of torque, s.
    still: [f32; MAX_JOINTS],
    /// Time without a count in spite of back-EMF, s.
    lost: [f32; MAX_JOINTS],
    /// Mean power into the hand, W.
    power: f32,
}

impl Budgets {
    /// Forgets what was summed up while the motors were on the last time; what heated them stays.
    pub(super) fn anew(&mut self) {
        self.still = [0.0; MAX_JOINTS];
        self.lost = [0.0; MAX_JOINTS];
        self.power = 0.0;
    }
}

/// Negative when |`value`| exceeds `bound`, which is not negative, and when it is not a number. Bit patterns of
/// positive floats order like the floats, and signs of several such differences are gathered by OR: no branch, no flags
/// to move.
#[inline(always)]
fn left(value: f32, bound: f32) -> i32 {
    bound.to_bits().wrapping_sub(value.abs().to_bits()) as i32
}

impl<P, K> Servo<P>
where
    P: DerefMut<Target = Program<K>>,
    K: Math<f32>,
{
    /// Makes [`Bounds`] ready: after anything they depend on has changed.
    pub(super) fn set_bounds(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        for i in 0..MAX_JOINTS {
            let speed = self.rules.limits.speed[i].max(0.0);
            // A jump is a step that even five times the speed limit cannot explain, and more than noise of a count.
            let counts = 5.0 * speed * self.period / program.counts_scale[i];
            self.bounds.jump[i] = (counts as u32).clamp(4, i32::MAX as u32);
            self.bounds.speed[i] = speed;
            // Without limits, all that is a number.
            let (low, high) = program.limits[i].unwrap_or((-f32::MAX, f32::MAX));
            self.bounds.middle[i] = 0.5 * low + 0.5 * high;
            self.bounds.half[i] = (0.5 * high - 0.5 * low).max(0.0);
            let axis = &program.axes[i];
            // The loop may overshoot a little; half again as much as the limit is not the loop.
            self.bounds.current[i] = 1.5 * axis.max_current() + 1.0;
            let torque = axis.max_torque();
            self.bounds.stall[i] = if torque > 0.0 { 0.8 * torque } else { f32::INFINITY };
        }
    }

    /// Looks for everything that must turn the motors off. `acted` are the torques (N m) of the period that ended.
    #[inline(always)]
    pub(super) fn watch(&mut self, samples: &Samples, acted: &[f32; MAX_JOINTS], regularity: &Regularity<f32>) {
        let Some(program) = self.program.as_ref() else { return };
        let joints = program.joints.min(MOST_JOINTS);
        let active = matches!(self.state, State::Armed | State::CheckingPolarity);
        let sensed = self.hardware.bridge.current_sensed;
        // Negative as soon as something is beyond its bound.
        let mut worst = 0;
        let mut power = 0.0;
        let mut sum = self.frame.wall_force + self.frame.normal_velocity + self.frame.bus_voltage;
        #[allow(clippy::needless_range_loop, reason = "one number for ten arrays")]
        for i in 0..joints {
            if sensed {
                self.frame.current[i] = samples.currents[i];
            }
            let (q, qd, current) = (self.frame.q[i], self.frame.qd[i], self.frame.current[i]);
            sum += q + qd + self.frame.torque[i] + current;
            power += acted[i] * qd;
            self.budgets.squares[i] += current * current;
            let moved = samples.counts[i].wrapping_sub(self.last_counts[i]).unsigned_abs();
            worst |= self.bounds.jump[i].wrapping_sub(moved) as i32;
            if active {
                worst |= left(qd, self.bounds.speed[i]);
                worst |= left(q - self.bounds.middle[i], self.bounds.half[i]);
                worst |= left(current, self.bounds.current[i]);
            }
            if self.rules.index_period[i] > 0 && !self.index_agrees(i, samples.index[i], moved) {
                worst = -1;
            }
        }
        // One check for all: a sum of finite numbers this small can only be infinite or NaN if one of them is.
        let mut well = worst | left(sum, f32::MAX) >= 0;
        let built_up = self.watch_budgets(samples, acted, active);
        if active {
            // Mean power into the hand: what the torques do on the joints, smoothed over POWER_SECONDS.
            self.budgets.power += (power - self.budgets.power) * (self.period * (1.0 / POWER_SECONDS));
            let limits = &self.rules.limits;
            well &= self.budgets.power <= limits.power && regularity.parallel >= SINGULAR_SINE;
            if self.hardware.bus_sensed {
                well &= samples.bus_voltage >= limits.bus_min && samples.bus_voltage <= limits.bus_max;
            }
            well &= match self.rules.host_action {
                HostAction::Ignore => true,
                // Listed once is enough.
                HostAction::Hold => self.host_silent <= self.rules.host_seconds || self.fault.is_some(),
                HostAction::Disarm => self.host_silent <= self.rules.host_seconds,
            };
        }
        if !well || built_up.is_some() {
            self.find(samples, regularity, sum, built_up);
        }
    }

    /// What builds up, of the joint whose turn it is.
    #[inline(always)]
    fn watch_budgets(&mut self, samples: &Samples, acted: &[f32; MAX_JOINTS], active: bool) -> Option<Found> {
        let program = self.program.as_mut()?;
        let joints = program.joints.min(MOST_JOINTS);
        let budgets = &mut self.budgets;
        let i = if budgets.joint < joints { budgets.joint } else { 0 };
        budgets.joint = i + 1;
        let elapsed = self.period * joints as f32;
        let axis = program.axes.get_mut(i)?;
        let mut found = None;
        let count = samples.counts[i];
        let moved = core::mem::replace(&mut budgets.counts[i], count) != count;
        let heat = limited(core::mem::take(&mut budgets.squares[i]) * self.period, f32::MAX);
        // The motor model goes on while the motors are off: that is when they cool.
        if axis.heat(heat, elapsed) {
            found = Some((Fault::ThermalBudget, Some(i as u8), self.frame.current[i]));
        }
        if moved {
            budgets.still[i] = 0.0;
            budgets.lost[i] = 0.0;
        } else if active {
            if acted[i].abs() > self.bounds.stall[i] {
                budgets.still[i] += elapsed;
                if budgets.still[i] > STALL_SECONDS {
                    found = Some((Fault::EncoderStall, Some(i as u8), budgets.still[i]));
                }
            }
            // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
            if self.hardware.bridge.current_sensed && self.hardware.bus_sensed {
                let turning = axis.speed_of(self.frame.duty[i], samples.bus_voltage, self.frame.current[i]);
                let suspicious = turning.abs() > 0.25 * self.bounds.speed[i];
                budgets.lost[i] = if suspicious { budgets.lost[i] + elapsed } else { 0.0 };
                if budgets.lost[i] > LOSS_SECONDS {
                    found = Some((Fault::EncoderLoss, Some(i as u8), turning));
                }
            }
        }
        if active { found } else { None }
    }

    /// Whether an index pulse, if there was one, came where the first one said; `moved` is what its joint did in this
    /// step, counts.
    #[inline(always)]
    fn index_agrees(&mut self, i: usize, index: Option<i32>, moved: u32) -> bool {
        let Some(count) = index else { return true };
        match self.first_index[i] {
            Some(first) => index_error(count, first, self.rules.index_period[i]) <= index_doubt(moved),
            None => {
                if moved <= INDEX_WIDTH {
                    self.first_index[i] = Some(count);
                }
                true
            }
        }
    }

    /// Something is not well: finds out what comes first, and turns the motors off.
    #[cold]
    #[inline(never)]
    fn find(&mut self, samples: &Samples, regularity: &Regularity<f32>, sum: f32, built_up: Option<Found>) {
        let Some(program) = self.program.as_ref() else { return };
        let joints = program.joints.min(MOST_JOINTS);
        let active = matches!(self.state, State::Armed | State::CheckingPolarity);
        let mut found: Option<Found> = None;
        let mut note = |wrong: bool, fault: Fault, axis: Option<usize>, value: f32| {
            if wrong && found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        // No number first: it makes every comparison below meaningless.
        note(!sum.is_finite(), Fault::NotFinite, None, sum);
        for i in 0..joints {
            let (q, qd, current) = (self.frame.q[i], self.frame.qd[i], self.frame.current[i]);
            let moved = samples.counts[i].wrapping_sub(self.last_counts[i]);
            note(moved.unsigned_abs() > self.bounds.jump[i], Fault::EncoderJump, Some(i), moved as f32);
            if active {
                note(left(qd, self.bounds.speed[i]) < 0, Fault::SpeedLimit, Some(i), qd);
                let out = left(q - self.bounds.middle[i], self.bounds.half[i]) < 0;
                note(out, Fault::JointLimit, Some(i), q);
                note(left(current, self.bounds.current[i]) < 0, Fault::OverCurrent, Some(i), current);
            }
            if let (Some(count), Some(first)) = (samples.index[i], self.first_index[i]) {
                let off = index_error(count, first, self.rules.index_period[i]);
                note(off > index_doubt(moved.unsigned_abs()), Fault::IndexMismatch, Some(i), off as f32);
            }
        }
        if let Some((fault, axis, value)) = built_up {
            note(true, fault, axis.map(usize::from), value);
        }
        if active {
            let (limits, bus) = (&self.rules.limits, samples.bus_voltage);
            note(self.budgets.power > limits.power, Fault::PowerLimit, None, self.budgets.power);
            note(regularity.parallel < SINGULAR_SINE, Fault::Singularity, None, regularity.parallel);
            if self.hardware.bus_sensed {
                note(bus < limits.bus_min, Fault::BusUnderVoltage, None, bus);
                note(bus > limits.bus_max, Fault::BusOverVoltage, None, bus);
            }
            let silent = self.host_silent > self.rules.host_seconds;
            match self.rules.host_action {
                HostAction::Disarm => note(silent, Fault::HostLost, None, self.host_silent),
                HostAction::Hold if silent && self.fault.is_none() => {
                    let (value, step) = (self.host_silent, self.frame.step);
                    self.fault = Some(FaultRecord { fault: Fault::HostLost, axis: None, value, step });
                }
                _ => {}
            }
        }
        if let Some((fault, axis, value)) = found {
            self.trip(fault, axis, value);
        }
    }
}

/// Counts between an index pulse at `count` and the nearest place where it should be: whole turns of `period` from the
/// `first`.
fn index_error(count: i32, first: i32, period: i32) -> u32 {
    let off = count.wrapping_sub(first).checked_rem(period).unwrap_or(0).unsigned_abs();
    off.min(period.unsigned_abs().saturating_sub(off))
}

/// What it may be: each of the two pulses may be late, the first by its width, this one by what the joint moved.
fn index_doubt(moved: u32) -> u32 {
    moved.saturating_add(2 * INDEX_WIDTH)
}
