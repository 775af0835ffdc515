//! Encoders without motors, such as a gimbal's or a grip's. No torque depends on them, so a control step does not read
//! them.

use super::ControlLoop;
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::description::MAX_SENSED;
use core::ops::DerefMut;

/// Counts and angles of the encoders without motors.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SensedEncoders {
    counts: [i32; MAX_SENSED],
    /// Counts at the home pose; 0 until the device is homed.
    zero: [i32; MAX_SENSED],
    /// Angles, rad; 0 beyond the device's encoders.
    pub(super) angles: [f32; MAX_SENSED],
}

impl SensedEncoders {
    /// Declares that the device is in its home pose.
    pub(super) fn home(&mut self) {
        self.zero = self.counts;
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Returns true if the device has encoders without motors.
    #[inline(always)]
    pub fn has_sensed(&self) -> bool {
        self.program.as_ref().is_some_and(|program| !program.sensed.is_empty())
    }

    /// Computes the angles of the encoders without motors from the counts of the board's inputs, which follow those of
    /// the joints. Call once a control step, before its record.
    pub fn sense(&mut self, inputs: &[i32]) {
        let Some(program) = self.program.as_ref() else { return };
        let SensedEncoders { counts, zero, angles } = &mut self.sensed;
        let encoders = program.sensed.iter().zip(inputs.iter().skip(program.joints));
        for ((((sensed, input), count), zero), angle) in encoders.zip(counts).zip(zero).zip(angles) {
            *count = *input;
            *angle = input.wrapping_sub(*zero) as f32 * sensed.radians_per_count + sensed.offset;
        }
    }
}
