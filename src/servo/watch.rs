//! What must turn the motors off and only a control step can show: numbers that are none, poses, marks, silence; and
//! what builds up over many steps (heat, stalls, lost encoders), which is looked at for one joint a step, in turn.
//! Limits are held to once a carrier period, in [`super::crest`].

use super::crest::left;
use super::{HostAction, Servo};
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::math::limited;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::Regularity;
use crate::safety::fault::{Fault, FaultRecord, State};
use crate::servo::frame::{Rendered, Samples};
use crate::servo::joints::Counts;
use crate::servo::program::Program;
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

/// What builds up over many steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Budgets {
    /// The joint whose turn it is.
    joint: usize,
    /// Its encoder's count at its last turn.
    counts: Counts,
    /// Time without a count in spite of torque, s.
    still: [f32; MAX_JOINTS],
    /// Time without a count in spite of back-EMF, s.
    lost: [f32; MAX_JOINTS],
    /// Torque that moves a joint unless it is blocked, N m.
    stall: [f32; MAX_JOINTS],
}

impl Budgets {
    /// Forgets what was summed up while the motors were on the last time; what heated them stays.
    pub(super) fn anew(&mut self) {
        self.still = [0.0; MAX_JOINTS];
        self.lost = [0.0; MAX_JOINTS];
    }
}

impl<P, K, S> Servo<P>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Makes ready what steps and carrier periods are held to: after device, homing, rules or rate have changed.
    pub(super) fn set_bounds(&mut self) {
        let Some(program) = self.program.as_ref() else { return };
        for (most, (limit, axis)) in self.most_torque.iter_mut().zip(self.rules.limits.torque.iter().zip(&program.axes))
        {
            *most = limit.min(axis.max_torque()).max(0.0);
        }
        for (stall, axis) in self.budgets.stall.iter_mut().zip(&program.axes) {
            let torque = axis.max_torque();
            *stall = if torque > 0.0 { 0.8 * torque } else { f32::INFINITY };
        }
        self.set_crest_bounds();
    }

    /// Looks for everything that must turn the motors off.
    #[inline(always)]
    pub(super) fn watch<const J: usize>(&mut self, samples: &Samples, rendered: &Rendered) {
        let Rendered { regularity, asked } = rendered;
        let active = matches!(self.state, State::Armed | State::CheckingPolarity);
        let sensed = self.hardware.bridge.current_sensed;
        let mut sum = self.now.walls.force + self.now.walls.normal_velocity + self.now.bus_voltage;
        let mut well = true;
        #[allow(clippy::needless_range_loop, reason = "one number for ten arrays")]
        for i in 0..J {
            if sensed {
                self.now.current[i] = samples.currents[i];
            }
            sum += self.now.q[i] + self.now.qd[i] + asked.total[i] + self.now.current[i];
            if self.rules.index_period[i] > 0 {
                let moved = samples.counts[i].wrapping_sub(self.last_counts[i]).unsigned_abs();
                well &= self.index_agrees(i, samples.index[i], moved);
            }
        }
        // One check for all: a sum of finite numbers this small can only be infinite or NaN if one of them is.
        well &= left(sum, f32::MAX) >= 0;
        let built_up = self.watch_budgets::<J>(samples, active);
        if active {
            well &= regularity.parallel >= SINGULAR_SINE;
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
    fn watch_budgets<const J: usize>(&mut self, samples: &Samples, active: bool) -> Option<Found> {
        let program = &mut **self.program.as_mut()?;
        let budgets = &mut self.budgets;
        let i = if budgets.joint < J { budgets.joint } else { 0 };
        budgets.joint = i + 1;
        let elapsed = self.period * J as f32;
        let (axis, motor) = (program.axes.get(i)?, self.heat.get_mut(i)?);
        let mut found = None;
        let count = samples.counts[i];
        let moved = core::mem::replace(&mut budgets.counts[i], count) != count;
        let heat = limited(self.crests.take_heat(i), f32::MAX);
        // The motor model goes on while the motors are off: that is when they cool.
        if motor.warm(heat, elapsed) {
            found = Some((Fault::ThermalBudget, Some(i as u8), self.now.current[i]));
        }
        if moved {
            budgets.still[i] = 0.0;
            budgets.lost[i] = 0.0;
        } else if active {
            // Of the period that ended: this step has commanded nothing yet.
            if self.now.torque[i].abs() > budgets.stall[i] {
                budgets.still[i] += elapsed;
                if budgets.still[i] > STALL_SECONDS {
                    found = Some((Fault::EncoderStall, Some(i as u8), budgets.still[i]));
                }
            }
            // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
            if self.hardware.bridge.current_sensed && self.hardware.bus_sensed {
                let turning = axis.speed_of(self.now.duty[i], samples.bus_voltage, self.now.current[i]);
                let suspicious = turning.abs() > 0.25 * self.rules.limits.speed[i];
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
        let joints = program.joints.min(MAX_JOINTS);
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
            let moved = samples.counts[i].wrapping_sub(self.last_counts[i]);
            if let (Some(count), Some(first)) = (samples.index[i], self.first_index[i]) {
                let off = index_error(count, first, self.rules.index_period[i]);
                note(off > index_doubt(moved.unsigned_abs()), Fault::IndexMismatch, Some(i), off as f32);
            }
        }
        if let Some((fault, axis, value)) = built_up {
            note(true, fault, axis.map(usize::from), value);
        }
        if active {
            note(regularity.parallel < SINGULAR_SINE, Fault::Singularity, None, regularity.parallel);
            let silent = self.host_silent > self.rules.host_seconds;
            match self.rules.host_action {
                HostAction::Disarm => note(silent, Fault::HostLost, None, self.host_silent),
                HostAction::Hold if silent && self.fault.is_none() => {
                    let (value, step) = (self.host_silent, self.now.step);
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
