//! The input of a control period, and the record that it leaves for telemetry.

use crate::control::joints::{Counts, Currents, Duties, Torques};
use crate::drive::stage::MAX_DUTY;
use crate::render::step_result::{DeviceState, StepResult};
use crate::safety::fault::State;

/// A duty as large as this is as large as it can be: the drive's own end, less what rounding may take off it.
const DUTY_END: f32 = MAX_DUTY * (1.0 - 8.0 * f32::EPSILON);

/// The hardware's samples of one instant, a crest of the carrier.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counts.
    pub counts: Counts,
    /// V; ignored where the board does not sense it.
    pub bus_voltage: f32,
    /// Motor currents; ignored where they are not sensed.
    pub currents: Currents,
    /// Difference of the two sensors of a motor's current; 0 with a single sensor.
    pub imbalance: Currents,
    /// True if what the legs do of it comes too late for the next valley, and applies half a carrier period later.
    pub late: bool,
}

/// The decision of one control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// True if the bridges may drive; false means floating.
    pub bridges: bool,
}

/// The commands of a step to the motors, and their state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motors {
    /// Joint torques after limits, N m.
    pub torque: Torques,
    /// Measured, or commanded where none is sensed, A.
    pub current: Currents,
    /// Of the carrier period after the step.
    pub duty: Duties,
    /// V; 0 where it is not sensed.
    pub bus_voltage: f32,
    /// The walls' force along the normal of the deepest, within the limits, N (docs/telemetry.md). Zero unless armed.
    pub rendered_force: f32,
    /// A bit for every joint that a limit gave another torque than was asked: its own limit of torque or current,
    /// another joint's, or that of the force at the tip, because all are cut by one factor.
    pub limited: u8,
}

/// The control loop's working memory: the state that the last step left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Now {
    /// Control steps since boot, and up to which one it was noted what they saw.
    pub step: u32,
    pub noted: u32,
    pub counts: Counts,
    pub motors: Motors,
    /// The result of the scene's step.
    pub found: StepResult<f32>,
}

/// One step as telemetry records it. Vectors are padded with zeros to three entries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepRecord {
    /// Control steps since boot.
    pub step: u32,
    /// The state after this step.
    pub state: State,
    /// Encoder counts.
    pub counts: Counts,
    /// Position and velocity of the device, and the walls that touch it.
    pub at: DeviceState<f32>,
    /// The state of the motors.
    pub motors: Motors,
}

impl StepRecord {
    /// The record of a step that left the control loop in `state`, part by part: a copy of the whole would be a call of memcpy.
    #[inline(always)]
    pub(crate) fn of(now: &Now, state: State) -> Self {
        Self { step: now.step, state, counts: now.counts, at: now.found.at, motors: now.motors }
    }

    /// Shortfall of joint `i`: 0 none, 1 a limit changed its torque ([`Motors::limited`]), 2 its
    /// duty is at its end, 3 both.
    pub fn saturation(&self, i: usize) -> u8 {
        let end = self.motors.duty.get(i).is_some_and(|duty| duty.abs() >= DUTY_END);
        (self.motors.limited >> i & 1) | u8::from(end) << 1
    }
}
