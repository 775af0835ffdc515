//! Faults of a board and its connectors.

use super::motor::MotorInput;

/// The faults of a board; none by default.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardFaults {
    /// Index of the motor that each axis drives and whose current it measures.
    pub motors: [usize; 3],
    /// Axes with swapped motor leads.
    pub reversed: [bool; 3],
    /// Gain of each current sensor, in the order of the board's sensors; 0 for a stuck sensor. The simulated board has
    /// one sensor per axis.
    pub sensor_gain: [f64; 4],
    /// Offset of each current sensor, A, in the same order.
    pub sensor_offset: [f64; 4],
    /// Fixed reading of an axis's sensors at any current, A.
    pub sensor_frozen: [Option<f64>; 3],
    /// Fixed reading of the bus divider at any voltage, V.
    pub bus_reading: Option<f64>,
    /// Axes with an open winding.
    pub open: [bool; 3],
    /// Bridges that stay at a duty, independent of the chip and the enable line.
    pub stuck_on: [Option<f64>; 3],
    /// Amplitude of an encoder's jitter, counts, added at every second reading.
    pub shake: [i32; 3],
    /// Offset of an encoder, counts.
    pub count_offset: [i32; 3],
    /// Scale error of an encoder: from this count on it shows this share of its joint's motion; 0 for a dead encoder,
    /// -1 for a backward one.
    pub share: [Option<(i32, f64)>; 3],
    /// Drift of an encoder: from this reading on it gains this number of counts per reading.
    pub drift: [Option<(u64, f64)>; 3],
    /// Encoders 0 and 1 are swapped from these counts on.
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
            swapped_at: None,
        }
    }
}

impl BoardFaults {
    /// Returns the inputs at the motors for these outputs of the bridges.
    #[must_use]
    pub fn drives(&self, drives: [MotorInput; 3]) -> [MotorInput; 3] {
        let mut reaching = [MotorInput::Floating; 3];
        for (axis, drive) in drives.into_iter().enumerate() {
            let input = self.stuck_on[axis].map_or(drive, MotorInput::Duty);
            reaching[self.motors[axis]] = match input {
                _ if self.open[axis] => MotorInput::Floating,
                MotorInput::Floating => MotorInput::Floating,
                MotorInput::Duty(duty) => MotorInput::Duty(duty * self.sign(axis)),
                MotorInput::Torque(torque) => MotorInput::Torque(torque * self.sign(axis)),
            };
        }
        reaching
    }

    fn sign(&self, axis: usize) -> f64 {
        if self.reversed[axis] { -1.0 } else { 1.0 }
    }

    /// Returns the reading of sensor `nth` of an axis for these motor currents, A.
    #[must_use]
    pub fn current(&self, currents: &[f64; 3], axis: usize, nth: usize) -> f64 {
        let current = self.sensor_frozen[axis].unwrap_or(currents[self.motors[axis]] * self.sign(axis));
        self.sensor_gain[nth] * current + self.sensor_offset[nth]
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
