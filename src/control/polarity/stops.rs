//! Homing by stops: each joint in turn is pushed to its stop twice, with a force at the tip of at most half a newton.
//!
//! A joint follows a slowly moving target on a spring, so a free joint takes the torque of its friction only. It is at
//! its stop when it stands still under the largest torque, near the angle of the device file and twice at the same
//! angle. The home pose from which this begins is known roughly, as for the polarity check.

use super::swing::spring_and_damper;
use super::{MAX_HOME_ERROR, PolarityCheck};
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::control::saturation::share_within;
use crate::control::{ControlLoop, Press};
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, Real, clamp, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::Homing;
use crate::safety::fault::{Fault, State};
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Largest tip force that pushes a joint to its stop, N.
pub const STOP_FORCE: f32 = 0.5;
/// Speed of the target that a joint follows, rad/s.
const PUSH_SPEED: f32 = 0.3;
/// Distance of the target at which the torque is largest, rad.
const FULL_PUSH_ANGLE: f32 = 0.1;
/// Longest time in which the torque on a joint that stands still grows to the largest, s.
const PUSH_SECONDS: f32 = 1.0;
/// Largest angular frequency of a joint on its target's spring, rad/s.
const MAX_PUSH_RATE: f32 = 30.0;
/// Angular frequency of the other joints about their initial angles, rad/s.
const HOLD_RATE: f32 = 10.0;
/// Distance from the stop at which a joint turns round between its two touches, rad, but at least [`BACK_COUNTS`].
const BACK_ANGLE: f32 = 0.06;
const BACK_COUNTS: f32 = 8.0;
/// Largest difference of two touches of a stop, rad, but at least [`MAX_TOUCH_COUNTS`].
const MAX_TOUCH_DIFFERENCE: f32 = 5.0e-3;
const MAX_TOUCH_COUNTS: f32 = 2.0;
/// Distance from its initial angle at which a joint has returned, rad, but at least [`MAX_TOUCH_COUNTS`].
const RETURNED_ANGLE: f32 = 0.02;
/// Largest travel of a joint, as a share of the range of its limits.
const MAX_TRAVEL_SHARE: f32 = 1.1;
/// Longest time for one joint, s.
const MAX_JOINT_SECONDS: f32 = 60.0;
/// Angle beyond limits and stops at which the motors go off during homing, rad; of a slide times its lever.
pub(in crate::control) const HOMING_MARGIN: f32 = MAX_HOME_ERROR + 0.05;

/// The way of a joint to its stop and back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Phase {
    /// To the stop for the first time.
    #[default]
    Out,
    /// Away from the stop.
    Back,
    /// To the stop for the second time.
    Again,
    /// To the initial angle.
    Return,
}

/// The push of a joint.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Push {
    phase: Phase,
    /// Motion from the initial angle that the joint follows, rad.
    target: f32,
    /// Mean motion of each joint over the time of its spring, rad.
    mean: [f32; MAX_JOINTS],
    /// Angle of the first touch, rad.
    first_touch: f32,
    /// Largest tip force for 1 N m of the joint in the poses that this cycle has checked, N.
    next_force_per_torque: f32,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Checks the conditions for homing by stops.
    pub(in crate::control) fn may_find_stops(&self, key: Press) -> Result<(), Refusal> {
        let program = self.check_ready()?;
        if !matches!(program.homing, Homing::Stop(_)) {
            return Err(Refusal::NoStops);
        }
        if self.hardware.real && !self.polarity_known {
            return Err(Refusal::PolarityUnchecked);
        }
        if self.is_fresh(key) { Ok(()) } else { Err(Refusal::KeyTooOld) }
    }

    /// Starts homing by stops while a key is held. Until it ends well the device is not homed.
    pub(in crate::control) fn find_stops(&mut self, key: Press) -> Result<(), Refusal> {
        self.may_find_stops(key)?;
        self.refuse_stray_current()?;
        self.polarity = PolarityCheck::default();
        (self.homed, self.key) = (false, Some(key));
        self.restart_checks();
        self.state = State::Homing;
        self.set_ranges();
        Ok(())
    }

    /// Runs a step of the push and returns the torques. `moved` is each joint's motion since the start, rad, and
    /// `counts` the angle of a count, rad.
    #[inline(never)]
    pub(super) fn push_to_stop(
        &mut self,
        push: &mut Push,
        moved: &[f32; MAX_JOINTS],
        counts: &[f32; MAX_JOINTS],
    ) -> Torques {
        // A step has time for a pose or for the push.
        self.polarity.part ^= 1;
        if self.polarity.part == 1 {
            self.check_next_pose_of(push);
            return self.polarity.commanded_torques;
        }
        let none = Torques::default();
        let (i, joints, seconds) = (self.axis(), self.count(), 2.0 * self.polarity.step_period);
        let Some((stop, (low, high))) = self.program.as_ref().and_then(|program| match program.homing {
            Homing::Stop(stops) => Some(stops[i]).zip(program.limits[i]),
            _ => None,
        }) else {
            self.trip(Fault::StopMissing, Some(i as u8), 0.0);
            return none;
        };
        let most = self.most_torque(STOP_FORCE.lesser(self.rules.limits.tip_force));
        let (inertia, lever) = (self.polarity.effective_inertia, self.lever(i));
        let (push_speed, home_error) = (lever * PUSH_SPEED, lever * MAX_HOME_ERROR);
        let rate = sqrt(most / (lever * FULL_PUSH_ANGLE * inertia.greater(f32::MIN_POSITIVE))).lesser(MAX_PUSH_RATE);
        let (stiffness, damping) = spring_and_damper(inertia, rate);
        let full_lag = most / stiffness.greater(f32::MIN_POSITIVE);
        let outward = if stop > 0.5 * (low + high) { 1.0 } else { -1.0 };
        let way = match push.phase {
            Phase::Out | Phase::Again => outward,
            Phase::Back => -outward,
            Phase::Return => 1.0_f32.copysign(-moved[i]),
        };
        // The torque is below its largest by rounding errors only.
        if (push.target - moved[i]) * way < 0.99 * full_lag {
            self.polarity.rest_seconds = 0.0;
        }
        let stands = self.is_at_rest(seconds);
        let lag = push.target - moved[i] + way * push_speed.greater(full_lag / PUSH_SECONDS) * seconds;
        push.target = moved[i] + clamp(lag, full_lag);

        let q = self.polarity.q[i];
        let beyond = outward * (q - stop);
        let few = |angle: f32, few: f32| (lever * angle).greater(few * counts[i].abs());
        let wrong = match push.phase {
            _ if beyond > home_error || outward * moved[i] > MAX_TRAVEL_SHARE * (high - low) => Some(q - stop),
            _ if self.polarity.wait_seconds > MAX_JOINT_SECONDS => Some(moved[i]),
            Phase::Out if stands && beyond < -home_error => Some(q - stop),
            Phase::Back | Phase::Return if stands => Some(q - stop),
            Phase::Again if stands => {
                let other = q - push.first_touch;
                // By the stop, the joint began within its limits.
                let (began, gap) = (stop - moved[i], (low - stop).greater(stop - high).greater(0.0));
                let differs = margin_bits(other, few(MAX_TOUCH_DIFFERENCE, MAX_TOUCH_COUNTS)) < 0;
                let inside = (low - gap..=high + gap).contains(&began);
                if differs || !inside { Some(other) } else { None }
            }
            _ => None,
        };
        if let Some(value) = wrong {
            self.trip(Fault::StopMissing, Some(i as u8), value);
            return none;
        }
        let next = match push.phase {
            Phase::Out if stands => {
                push.first_touch = q;
                Phase::Back
            }
            Phase::Back if outward * (push.first_touch - q) >= few(BACK_ANGLE, BACK_COUNTS) => Phase::Again,
            Phase::Again if stands => {
                self.polarity.corrections[i] = stop - q;
                Phase::Return
            }
            Phase::Return if moved[i].abs() <= few(RETURNED_ANGLE, MAX_TOUCH_COUNTS) => {
                self.continue_with_next_joint();
                return none;
            }
            phase => phase,
        };
        if next != push.phase {
            (push.phase, push.target) = (next, moved[i]);
            (self.polarity.rest_range, self.polarity.rest_seconds) = ((q, q), 0.0);
        }

        let mut torque = Torques::default();
        for j in 0..joints.min(MAX_JOINTS) {
            let (inertia, rate) = match j == i {
                true => (inertia, rate),
                false => (self.polarity.inertia.map_or(0.0, |inertia| inertia[j][j]), HOLD_RATE),
            };
            let speed = rate * (moved[j] - push.mean[j]);
            push.mean[j] += (seconds * rate).lesser(1.0) * (moved[j] - push.mean[j]);
            torque[j] = match j == i {
                true => clamp(stiffness * (push.target - moved[i]) + damping * (way * push_speed - speed), most),
                false => {
                    let (stiffness, damping) = spring_and_damper(inertia, rate);
                    -stiffness * moved[j] - damping * speed
                }
            };
        }
        // All torques together push no harder than the joint's largest torque alone.
        let share = share_within(self.leverage.force_squared(&torque), most * self.unit_force(i));
        Torques(torque.map(|torque| share * torque))
    }

    /// Checks the next pose within the home's error, and updates the leverage after the last of them.
    fn check_next_pose_of(&mut self, push: &mut Push) {
        let corner = self.polarity.poses_checked;
        let Some(force) = self.force_per_torque_at(corner) else { return };
        push.next_force_per_torque = push.next_force_per_torque.max(force);
        self.polarity.poses_checked = corner + 1;
        if self.polarity.poses_checked >= 1 << self.joint_count {
            self.polarity.poses_checked = 0;
            self.polarity.force_per_torque = core::mem::take(&mut push.next_force_per_torque);
        }
    }

    /// Homes the device by the touches of all its joints.
    pub(super) fn finish_homing(&mut self) {
        let corrections = self.polarity.corrections;
        let q = self.now.result.at.q;
        self.turn_motors_off();
        self.state = State::Disarmed;
        self.declare(&core::array::from_fn(|i| q[i] + corrections[i]));
        self.first_index = [None; MAX_JOINTS];
    }
}
