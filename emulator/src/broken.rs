//! What can be broken on a board and at its connectors, and what a person there would feel of it.

use crate::plant::Plant;
use haptic::sim::MotorInput;

/// What is broken. Nothing, to begin with.
#[derive(Clone, Debug, PartialEq)]
pub struct Broken {
    /// What each current sensor shows of a current, in the order of the wiring: 0 for one that is stuck.
    pub sensor_gain: [f64; 4],
    /// What each current sensor shows on top of a current, A, in the order of the wiring.
    pub sensor_extra: [f64; 4],
    /// What the sensors of an axis show whatever its current is, A.
    pub sensor_frozen: [Option<f64>; 3],
    /// What the divider of the bus shows whatever the voltage is, V.
    pub bus_shown: Option<f64>,
    /// From the next start on the chip's pin at that divider has no wire.
    pub bus_cut: bool,
    /// Axes whose winding is open.
    pub open: [bool; 3],
    /// Bridges that stand at a duty whatever the chip and the enable line say.
    pub stuck_on: [Option<f64>; 3],
    /// Counts by which an encoder shakes, up at one look and down at the next.
    pub shake: [i32; 3],
    /// Encoders that count backward from this count on.
    pub backward_from: [Option<i32>; 3],
    /// Encoders 0 and 1 change places at these counts.
    pub swapped_at: Option<[i32; 2]>,
}

impl Default for Broken {
    fn default() -> Self {
        Self {
            sensor_gain: [1.0; 4],
            sensor_extra: [0.0; 4],
            sensor_frozen: [None; 3],
            bus_shown: None,
            bus_cut: false,
            open: [false; 3],
            stuck_on: [None; 3],
            shake: [0; 3],
            backward_from: [None; 3],
            swapped_at: None,
        }
    }
}

impl Broken {
    /// What reaches the motors of what the bridges do.
    #[must_use]
    pub fn drives(&self, mut drives: [MotorInput; 3]) -> [MotorInput; 3] {
        for (axis, drive) in drives.iter_mut().enumerate() {
            if let Some(duty) = self.stuck_on[axis] {
                *drive = MotorInput::Duty(duty);
            }
            if self.open[axis] {
                *drive = MotorInput::Floating;
            }
        }
        drives
    }

    /// What the encoders show of what the joints do, at the `nth` look.
    #[must_use]
    pub fn counts(&self, mut counts: [i32; 3], nth: u64) -> [i32; 3] {
        if let Some([first, second]) = self.swapped_at {
            [counts[0], counts[1]] = [first + counts[1] - second, second + counts[0] - first];
        }
        for (axis, count) in counts.iter_mut().enumerate() {
            if let Some(from) = self.backward_from[axis] {
                *count = 2 * from - *count;
            }
            *count += if nth.is_multiple_of(2) { self.shake[axis] } else { 0 };
        }
        counts
    }
}

/// The most that there was since it was last set to nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peaks {
    /// A winding's current, A.
    pub current: f64,
    /// A joint's speed, rad/s.
    pub speed: f64,
    /// The tip's way from where it was, m.
    pub travel: f64,
    /// Whether a bridge was on.
    pub driven: bool,
    /// Whether the chip drove a pin of the power stage, or pulled it up.
    pub touched: bool,
    from: Option<[f64; 3]>,
}

impl Peaks {
    /// Takes what is.
    pub fn take(&mut self, plant: &mut dyn Plant) {
        let currents = plant.currents();
        let Some(device) = plant.device() else { return };
        let most = |values: [f64; 3]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        self.current = self.current.max(most(currents));
        self.speed = self.speed.max(most(device.qd()));
        let tip = device.tip();
        let from = *self.from.get_or_insert(tip);
        let way = tip.iter().zip(from).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        self.travel = self.travel.max(way);
    }
}
