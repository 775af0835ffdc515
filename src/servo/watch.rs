//! Everything that must turn the motors off, looked for once a control step.

use super::{HostAction, Samples, Servo};
use crate::description::MAX_JOINTS;
use crate::guard::{Fault, FaultRecord, POWER_SECONDS, State};
use crate::math::Math;
use crate::mechanism::Regularity;
use crate::program::Program;
use core::ops::DerefMut;

/// Regularity of a closed loop below which its tip force is no longer defined well enough to act.
pub const SINGULAR_SINE: f32 = 2.0e-3;
/// Width of an index pulse, counts; the first one counts only if it was passed no faster than this in a step.
pub const INDEX_WIDTH: u32 = 4;
/// How long torque near its limit without any encoder motion is believed, s.
pub const STALL_SECONDS: f32 = 5.0;
/// How long an encoder may stand still while the back-EMF says the joint turns, s.
pub const LOSS_SECONDS: f32 = 0.05;

impl<P, K> Servo<P>
where
    P: DerefMut<Target = Program<K>>,
    K: Math<f32>,
{
    /// Looks for everything that must turn the motors off. `acted` are the torques (N m) of the period that ended.
    #[inline(always)]
    pub(super) fn watch(&mut self, samples: &Samples, acted: &[f32; MAX_JOINTS], regularity: &Regularity<f32>) {
        let Some(program) = self.program.as_mut() else { return };
        let joints = program.joints;
        let mut found: Option<(Fault, Option<u8>, f32)> = None;
        let mut note = |fault: Fault, axis: Option<usize>, value: f32| {
            if found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        let active = matches!(self.state, State::Armed | State::CheckingPolarity);
        let mut power = 0.0;
        let sensed = self.hardware.bridge.current_sensed;
        let mut sum = self.frame.wall_force + self.frame.normal_velocity + self.frame.bus_voltage;
        for i in 0..joints.min(MAX_JOINTS) {
            let (q, qd, torque) = (self.frame.q[i], self.frame.qd[i], self.frame.torque[i]);
            let acted = acted[i];
            if sensed {
                self.frame.current[i] = samples.currents[i];
            }
            let current = self.frame.current[i];
            sum += q + qd + torque + current;
            power += acted * qd;
            let moved = samples.counts[i].wrapping_sub(self.last_counts[i]);
            let speed_limit = self.rules.limits.speed[i];
            // A jump is a step that even five times the speed limit cannot explain, and more than noise of a count.
            let jump = (moved.unsigned_abs() as f32) * program.counts_scale[i];
            if self.primed && moved.unsigned_abs() > 4 && jump > 5.0 * speed_limit * self.period {
                note(Fault::EncoderJump, Some(i), moved as f32);
            }
            if active {
                if qd.abs() > speed_limit {
                    note(Fault::SpeedLimit, Some(i), qd);
                }
                if let Some((low, high)) = program.limits[i]
                    && (q < low || q > high)
                {
                    note(Fault::JointLimit, Some(i), q);
                }
                let axis = &program.axes[i];
                // The loop may overshoot a little; half again as much as the limit is not the loop.
                if current.abs() > 1.5 * axis.max_current() + 1.0 {
                    note(Fault::OverCurrent, Some(i), current);
                }
                if moved != 0 {
                    self.still[i] = 0.0;
                } else if acted.abs() > 0.8 * axis.max_torque() && axis.max_torque() > 0.0 {
                    self.still[i] += self.period;
                    if self.still[i] > STALL_SECONDS {
                        note(Fault::EncoderStall, Some(i), self.still[i]);
                    }
                }
                // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
                if sensed && self.hardware.bus_sensed {
                    let turning = axis.speed_of(self.frame.duty[i], samples.bus_voltage, current);
                    let suspicious = moved == 0 && turning.abs() > 0.25 * speed_limit;
                    self.lost[i] = if suspicious { self.lost[i] + self.period } else { 0.0 };
                    if self.lost[i] > LOSS_SECONDS {
                        note(Fault::EncoderLoss, Some(i), turning);
                    }
                }
            }
            // The motor model goes on while the motors are off: that is when they cool.
            if program.axes[i].heat(current, self.period) && active {
                note(Fault::ThermalBudget, Some(i), current);
            }
            let period = self.rules.index_period[i];
            if let (Some(count), true) = (samples.index[i], period > 0) {
                match self.first_index[i] {
                    None if moved.unsigned_abs() <= INDEX_WIDTH => self.first_index[i] = Some(count),
                    None => {}
                    Some(first) => {
                        let off = count.wrapping_sub(first).checked_rem(period).unwrap_or(0).unsigned_abs();
                        let off = off.min(period.unsigned_abs() - off);
                        // Each of the two may be late: the first by the width, this one by what the joint moved.
                        if off > 2 * INDEX_WIDTH + moved.unsigned_abs() {
                            note(Fault::IndexMismatch, Some(i), off as f32);
                        }
                    }
                }
            }
        }
        if active {
            // Mean power into the hand: what the torques do on the joints, smoothed over POWER_SECONDS.
            self.power += (power - self.power) * (self.period * (1.0 / POWER_SECONDS));
            if self.power > self.rules.limits.power {
                note(Fault::PowerLimit, None, self.power);
            }
            if regularity.parallel < SINGULAR_SINE {
                note(Fault::Singularity, None, regularity.parallel);
            }
            if self.hardware.bus_sensed {
                if samples.bus_voltage < self.rules.limits.bus_min {
                    note(Fault::BusUnderVoltage, None, samples.bus_voltage);
                }
                if samples.bus_voltage > self.rules.limits.bus_max {
                    note(Fault::BusOverVoltage, None, samples.bus_voltage);
                }
            }
            if self.rules.host_action != HostAction::Ignore && self.host_silent > self.rules.host_seconds {
                if self.rules.host_action == HostAction::Disarm {
                    note(Fault::HostLost, None, self.host_silent);
                } else if self.fault.is_none() {
                    let record = FaultRecord {
                        fault: Fault::HostLost,
                        axis: None,
                        value: self.host_silent,
                        step: self.frame.step,
                    };
                    self.fault = Some(record);
                }
            }
        }
        // One check for all: a sum of finite numbers this small can only be infinite or NaN if one of them is.
        if !sum.is_finite() {
            found = Some((Fault::NotFinite, None, sum));
        }
        if let Some((fault, axis, value)) = found {
            self.trip(fault, axis, value);
        }
    }
}
