//! Limits that the board enforces.

use crate::model::catalogue::MAX_JOINTS;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Limits that the board enforces, whatever a tool asks for. Raising them needs the disarmed state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Limits {
    /// Joint torque, N m; the motor's current limit counts as well.
    pub torque: [f32; MAX_JOINTS],
    /// Motor current, A.
    pub current: [f32; MAX_JOINTS],
    /// Motor current that may flow for ever, A.
    pub continuous_current: [f32; MAX_JOINTS],
    /// Joint speed, rad/s.
    pub speed: [f32; MAX_JOINTS],
    /// Mean mechanical power given to the hand over [`POWER_SECONDS`], W.
    pub power: f32,
    /// Lowest bus voltage, V.
    pub bus_min: f32,
    /// Highest bus voltage, V.
    pub bus_max: f32,
}

/// Averaging time of the power limit, s.
pub const POWER_SECONDS: f32 = 0.1;

impl Default for Limits {
    fn default() -> Self {
        Self {
            torque: [5.0; MAX_JOINTS],
            current: [10.0; MAX_JOINTS],
            continuous_current: [10.0; MAX_JOINTS],
            speed: [60.0; MAX_JOINTS],
            power: 20.0,
            bus_min: 8.0,
            bus_max: 28.0,
        }
    }
}

impl Limits {
    /// Whether every number is finite, positive and no larger than what `most` allows.
    pub fn within(&self, most: &Self) -> bool {
        let below = |values: &[f32; MAX_JOINTS], bounds: &[f32; MAX_JOINTS]| {
            values.iter().zip(bounds).all(|(value, bound)| *value > 0.0 && value <= bound)
        };
        below(&self.torque, &most.torque)
            && below(&self.current, &most.current)
            && below(&self.continuous_current, &most.current)
            && below(&self.speed, &most.speed)
            && self.power > 0.0
            && self.power <= most.power
            && self.bus_min >= most.bus_min
            && self.bus_max <= most.bus_max
            && self.bus_min < self.bus_max
    }

    /// Whether no limit is higher than in `other`: such a change is safe at any time.
    pub fn no_higher_than(&self, other: &Self) -> bool {
        let mut steady = self.continuous_current.iter().zip(&other.continuous_current);
        // Held against itself alone: it may stand above a current limit that was lowered below it.
        let rest = Self { continuous_current: self.current, ..*self };
        steady.all(|(value, bound)| *value > 0.0 && value <= bound) && rest.within(other)
    }
}
