//! The faults that a board and its connectors can have.

use super::motor::MotorInput;

/// The faults of a board; none by default.
#[derive(Clone, Debug, PartialEq)]
pub struct Broken {
    /// The motor that each axis really drives, and whose current it sees, from 0.
    pub motors: [usize; 3],
    /// Axes whose motor's two leads are swapped.
    pub reversed: [bool; 3],
    /// The gain of each current sensor, in the order of the board's sensors: 0 for one that is stuck. The simulated
    /// board has one sensor for each axis.
    pub sensor_gain: [f64; 4],
    /// The offset of each current sensor, A, in the same order.
    pub sensor_extra: [f64; 4],
    /// The fixed reading of an axis's sensors, whatever its current is, A.
    pub sensor_frozen: [Option<f64>; 3],
    /// The fixed reading of the bus divider, whatever the voltage is, V.
    pub bus_shown: Option<f64>,
    /// Axes whose winding is open.
    pub open: [bool; 3],
    /// Bridges that stand at a duty whatever the chip and the enable line say.
    pub stuck_on: [Option<f64>; 3],
    /// Counts by which an encoder shakes, up at one look and down at the next.
    pub shake: [i32; 3],
    /// Counts that an encoder shows too many.
    pub count_extra: [i32; 3],
    /// Encoders that from this count on show so much of what their joint turns: 0 for one that is dead, -1 backward.
    pub share: [Option<(i32, f64)>; 3],
    /// Encoders that from this look on gain so many counts at every look.
    pub drift: [Option<(u64, f64)>; 3],
    /// Encoders 0 and 1 change places at these counts.
    pub swapped_at: Option<[i32; 2]>,
}

impl Default for Broken {
    fn default() -> Self {
        Self {
            motors: [0, 1, 2],
            reversed: [false; 3],
            sensor_gain: [1.0; 4],
            sensor_extra: [0.0; 4],
            sensor_frozen: [None; 3],
            bus_shown: None,
            open: [false; 3],
            stuck_on: [None; 3],
            shake: [0; 3],
            count_extra: [0; 3],
            share: [None; 3],
            drift: [None; 3],
            swapped_at: None,
        }
    }
}

impl Broken {
    /// Returns the inputs that reach the motors when the bridges do this.
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

    /// Returns the reading of sensor `nth`, which belongs to an axis, for these motor currents, A.
    #[must_use]
    pub fn current(&self, currents: &[f64; 3], axis: usize, nth: usize) -> f64 {
        let flows = self.sensor_frozen[axis].unwrap_or(currents[self.motors[axis]] * self.sign(axis));
        self.sensor_gain[nth] * flows + self.sensor_extra[nth]
    }

    /// Returns the counts that the encoders show at the `nth` look, when `counts` are the true ones.
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
            *count += self.count_extra[axis] + if nth.is_multiple_of(2) { self.shake[axis] } else { 0 };
        }
        counts
    }
}
