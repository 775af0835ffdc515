//! What must turn the motors off and only a control step can show: numbers that are not finite, poses, marks, silence.
//! Limits are held to once a carrier period, in [`super::crest`]; what builds up is in [`super::budgets`].

use super::crest::{left, left_from};
use super::{HostAction, Servo};
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::safety::fault::{Fault, FaultRecord};
use crate::servo::frame::Samples;
use crate::servo::joints::Torques;
use crate::servo::program::Program;
use core::ops::DerefMut;

/// Regularity of a closed loop below which its tip force is no longer defined well enough to act.
pub const TRIPPING_SINE: f32 = 2.0e-3;
/// Width of an index pulse, counts; the first one counts only if it was passed no faster than this in a step.
pub const INDEX_WIDTH: u32 = 4;

impl<P, K, S> Servo<P>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Makes ready what steps and carrier periods are held to: after device, homing, rules or rate have changed.
    pub(super) fn set_bounds(&mut self) {
        let rules = &self.rules;
        self.host_patience = match rules.host_action {
            HostAction::Ignore => f32::INFINITY,
            HostAction::Hold | HostAction::Disarm => rules.host_seconds,
        };
        let Some(program) = self.program.as_ref() else { return };
        self.most_force_squared = rules.limits.tip_force * rules.limits.tip_force;
        let largest = program.axes.map(|axis| axis.max_torque());
        self.most_torque = Torques::from_fn(|i| rules.limits.torque[i].min(largest[i]).max(0.0));
        self.budgets.set_torques(largest);
        self.set_crest_bounds();
    }

    /// Looks for what must turn the motors off in what the step found, before the counts of the last are forgotten.
    #[inline(always)]
    pub(super) fn watch<const J: usize>(&mut self, samples: &Samples) {
        let active = self.state.drives();
        let sensed = self.hardware.bridge.current_sensed;
        let mut sum = self.now.found.at.walls.wall_force + self.now.found.at.walls.normal_velocity;
        let mut well = true;
        #[allow(clippy::needless_range_loop, reason = "one number for ten arrays")]
        for i in 0..J {
            if sensed {
                self.now.motors.current[i] = samples.currents[i];
            }
            sum += self.now.found.at.qd[i] + self.now.found.asked.total[i];
            if self.rules.index_period[i] > 0 {
                let moved = samples.counts[i].wrapping_sub(self.now.counts[i]).unsigned_abs();
                well &= self.index_agrees(i, samples.index[i], moved);
            }
        }
        // One check for all: a sum of finite numbers this small can only be infinite or NaN if one of them is.
        let mut least = left(sum, f32::MAX);
        if active {
            least |= left(self.host_silent, self.host_patience) | beyond(self.now.found.regularity.parallel);
        }
        if !well || least < 0 {
            self.find(samples, sum);
        }
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
    fn find(&mut self, samples: &Samples, sum: f32) {
        let joints = self.joints();
        let active = self.state.drives();
        let mut found = None;
        let mut note = |wrong: bool, fault: Fault, axis: Option<usize>, value: f32| {
            if wrong && found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        // No number first: it makes every comparison below meaningless.
        note(!sum.is_finite(), Fault::NotFinite, None, sum);
        for i in 0..joints {
            let moved = samples.counts[i].wrapping_sub(self.now.counts[i]);
            if let (Some(count), Some(first)) = (samples.index[i], self.first_index[i]) {
                let off = index_error(count, first, self.rules.index_period[i]);
                note(off > index_doubt(moved.unsigned_abs()), Fault::IndexMismatch, Some(i), off as f32);
            }
        }
        if active {
            let parallel = self.now.found.regularity.parallel;
            note(beyond(parallel) < 0, Fault::Singularity, None, parallel);
            let silent = self.host_silent > self.rules.host_seconds;
            match self.rules.host_action {
                HostAction::Disarm => note(silent, Fault::HostLost, None, self.host_silent),
                // Listed once is enough.
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

/// Negative where a closed loop is stretched so far that its tip force is not defined, and where that is not known.
#[inline(always)]
fn beyond(parallel: f32) -> i32 {
    left_from(parallel, TRIPPING_SINE) | left(parallel, f32::MAX)
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
