//! The input of a control period, and its record for telemetry.

use crate::control::joints::{Counts, Currents, Duties, Torques};
use crate::drive::stage::MAX_DUTY;
use crate::model::description::MAX_SENSED;
use crate::render::step_result::{DeviceState, StepResult};
use crate::safety::fault::State;

/// Duty from which a drive counts as being at its maximum: [`MAX_DUTY`] less rounding errors.
const DUTY_END: f32 = MAX_DUTY * (1.0 - 8.0 * f32::EPSILON);

/// Samples of the hardware at one crest of the carrier.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counts.
    pub counts: Counts,
    /// Bus voltage, V; ignored on a board that does not measure it.
    pub bus_voltage: f32,
    /// Motor currents; ignored on a board that does not measure them.
    pub currents: Currents,
    /// Difference of a motor's two current sensors; 0 with a single sensor.
    pub imbalance: Currents,
    /// True if the duties come too late for the next valley and apply half a carrier period later.
    pub late: bool,
}

/// Result of one control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// True if the bridges may drive; false if the bridges must float.
    pub bridges: bool,
}

/// Commands of a step to the motors, and the motors' state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motors {
    /// Joint torques after limits, N m.
    pub torque: Torques,
    /// Currents, A: measured, or commanded on a board without current sensors.
    pub current: Currents,
    /// Duties of the carrier period after the step.
    pub duty: Duties,
    /// Bus voltage, V; 0 if it is not measured.
    pub bus_voltage: f32,
    /// Force of the walls along the normal of the deepest wall, after limits, N (docs/telemetry.md). 0 unless armed.
    pub rendered_force: f32,
    /// One bit per joint, set if a limit changed the requested torque. The limit may belong to any joint or to the tip,
    /// because all torques are cut by one factor.
    pub limited: u8,
}

/// State after the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Now {
    /// Control steps since boot.
    pub step: u32,
    /// Last step whose samples were recorded.
    pub recorded_step: u32,
    pub counts: Counts,
    pub motors: Motors,
    /// Result of the scene's step.
    pub result: StepResult<f32>,
}

/// One step as telemetry records it. Vectors are padded with zeros to three entries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepRecord {
    /// Control steps since boot.
    pub step: u32,
    /// State after this step.
    pub state: State,
    /// Encoder counts.
    pub counts: Counts,
    /// Position and velocity of the device, and the walls that touch it.
    pub at: DeviceState<f32>,
    /// State of the motors.
    pub motors: Motors,
    /// Angles of the encoders without motors, rad.
    pub sensed: [f32; MAX_SENSED],
}

impl StepRecord {
    /// Builds the record of a step that left the control loop in `state`. Copies single fields, to avoid a call of
    /// memcpy.
    #[inline(always)]
    pub(crate) fn of(now: &Now, state: State, sensed: &[f32; MAX_SENSED]) -> Self {
        Self { step: now.step, state, counts: now.counts, at: now.result.at, motors: now.motors, sensed: *sensed }
    }

    /// Returns the saturation of joint `i`: 0 for none, 1 if a limit changed its torque ([`Motors::limited`]), 2 if its
    /// duty is at the maximum, 3 for both.
    pub fn saturation(&self, i: usize) -> u8 {
        let end = self.motors.duty.get(i).is_some_and(|duty| duty.abs() >= DUTY_END);
        (self.motors.limited >> i & 1) | u8::from(end) << 1
    }
}
