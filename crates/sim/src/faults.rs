//! Injected faults of a board and its wiring.

use super::motor::MotorInput;

/// The faults of a board; none by default.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardFaults {
    /// For each axis, the index of the motor that the axis drives and whose current it measures.
    pub motors: [usize; 3],
    /// Axes with swapped motor leads.
    pub reversed: [bool; 3],
    /// Gain of each current sensor, in the order of the board's sensors; 0 for a stuck sensor.
    pub sensor_gain: [f64; 4],
    /// Offset of each current sensor, A, in the order of the board's sensors.
    pub sensor_offset: [f64; 4],
    /// Reading of an axis's current sensors that is independent of the current, A.
    pub sensor_frozen: [Option<f64>; 3],
    /// Reading of the bus voltage that is independent of the voltage, V.
    pub bus_reading: Option<f64>,
    /// Axes with an open winding.
    pub open: [bool; 3],
    /// Duty at which an axis's bridge is stuck, independent of the chip and the enable line.
    pub stuck_on: [Option<f64>; 3],
    /// Jitter of an encoder, counts, which is added to every second reading.
    pub shake: [i32; 3],
    /// Offset of an encoder, counts.
    pub count_offset: [i32; 3],
    /// Count from which an encoder shows only a share of the joint's motion, and the share: 0 for a dead encoder, -1
    /// for a reversed encoder.
    pub share: [Option<(i32, f64)>; 3],
    /// First reading and rate of an encoder's drift, counts per reading.
    pub drift: [Option<(u64, f64)>; 3],
    /// First disturbed frame of an absolute encoder, and the number of disturbed frames.
    pub frames: [Option<(u64, u64)>; 3],
    /// Counts at which encoders 0 and 1 are swapped.
    pub swapped_at: Option<[i32; 2]>,
}

impl Default for BoardFaults {
    fn default() -> Self {
        Self {
            motors: [0, 1, 2],
            reversed: [false; 3],
            sensor_gain: [1.0; 4],
            sensor_offset: [0.0; 4],
            sensor_frozen: [None; 3],
            bus_reading: None,
            open: [false; 3],
            stuck_on: [None; 3],
            shake: [0; 3],
            count_offset: [0; 3],
            share: [None; 3],
            drift: [None; 3],
            frames: [None; 3],
            swapped_at: None,
        }
    }
}

impl BoardFaults {
    /// Returns the inputs of the motors for these outputs of the bridges.
    #[must_use]
    pub fn drives(&self, drives: [MotorInput; 3]) -> [MotorInput; 3] {
        let mut inputs = [MotorInput::Floating; 3];
        for (axis, drive) in drives.into_iter().enumerate() {
            let input = self.stuck_on[axis].map_or(drive, MotorInput::Duty);
            inputs[self.motors[axis]] = match input {
                _ if self.open[axis] => MotorInput::Floating,
                MotorInput::Floating => MotorInput::Floating,
                MotorInput::Duty(duty) => MotorInput::Duty(duty * self.sign(axis)),
                MotorInput::Legs([first, second, third]) if self.reversed[axis] => {
                    MotorInput::Legs([first, third, second])
                }
                MotorInput::Legs(legs) => MotorInput::Legs(legs),
                MotorInput::Torque(torque) => MotorInput::Torque(torque * self.sign(axis)),
            };
        }
        inputs
    }

    fn sign(&self, axis: usize) -> f64 {
        if self.reversed[axis] { -1.0 } else { 1.0 }
    }
    /// Returns the reading of the axis's sensor `nth` for these motor currents, A.
    #[must_use]
    pub fn current(&self, currents: &[f64; 3], axis: usize, nth: usize) -> f64 {
        let current = self.sensor_frozen[axis].unwrap_or(currents[self.motors[axis]] * self.sign(axis));
        self.sensor_gain[nth] * current + self.sensor_offset[nth]
    }
    /// Returns the reading of the sensor of a leg (0 or 1) of the axis, for these phase currents of its motor, A.
    #[must_use]
    pub fn leg_current(&self, phases: [f64; 3], axis: usize, leg: usize) -> f64 {
        let phase = if self.reversed[axis] && leg == 1 { phases[2] } else { phases[leg] };
        let nth = (2 * axis + leg).min(self.sensor_gain.len() - 1);
        self.sensor_gain[nth] * self.sensor_frozen[axis].unwrap_or(phase) + self.sensor_offset[nth]
    }
    /// Returns the `nth` frame of an absolute encoder whose intact frame is `frame`.
    #[must_use]
    pub fn frame(&self, axis: usize, frame: u16, nth: u64) -> u16 {
        let is_disturbed = self.frames[axis].is_some_and(|(first, frames)| (first..first + frames).contains(&nth));
        if is_disturbed { frame ^ 1 << (nth % 16) } else { frame }
    }
    /// Returns the encoders' `nth` reading for the true `counts`.
    #[must_use]
    pub fn counts(&self, mut counts: [i32; 3], nth: u64) -> [i32; 3] {
        if let Some([first, second]) = self.swapped_at {
            [counts[0], counts[1]] = [first + counts[1] - second, second + counts[0] - first];
        }
        for (axis, count) in counts.iter_mut().enumerate() {
            if let Some((from, share)) = self.share[axis] {
                *count = from + (f64::from(*count - from) * share).round() as i32;
            }
            if let Some((from, rate)) = self.drift[axis] {
                *count += (nth.saturating_sub(from) as f64 * rate) as i32;
            }
            *count += self.count_offset[axis] + if nth.is_multiple_of(2) { self.shake[axis] } else { 0 };
        }
        counts
    }
}
