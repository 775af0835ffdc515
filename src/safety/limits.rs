//! Limits that the board enforces.

use crate::model::catalogue::MAX_JOINTS;
use crate::model::units::JointUnits;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Limits that the board enforces for every tool. They can be raised only while the motors are off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Limits {
    /// Joint torque, N m; the motor's current limit applies as well. A slide has the force of this torque at its lever,
    /// see [`Limits::in_units`].
    pub torque: [f32; MAX_JOINTS],
    /// Motor current, A.
    pub current: [f32; MAX_JOINTS],
    /// Motor current that may flow continuously, A.
    pub continuous_current: [f32; MAX_JOINTS],
    /// Joint speed, rad/s. A slide has the speed of its lever's end.
    pub speed: [f32; MAX_JOINTS],
    /// Mean mechanical power into the hand over [`POWER_SECONDS`], W.
    pub power: f32,
    /// Lowest bus voltage, V.
    pub bus_min: f32,
    /// Highest bus voltage, V.
    pub bus_max: f32,
    /// Total force of walls, springs and fields at the tip in any pose, |f| of τ = Jᵀ f, N.
    #[serde(default = "default_tip_force")]
    pub tip_force: f32,
}

/// Default force limit at the tip of a board with real motors, N, which a wrist withstands and a hand can hold.
pub const GENTLE_FORCE: f32 = 5.0;
/// Highest force limit at the tip that a board with real motors accepts, N.
pub const MAX_TIP_FORCE: f32 = 100.0;
/// Largest tip force of the currents computed from the motors' voltages, as a multiple of the force limit at the tip,
/// because a wrong current sensor can hide a force.
pub const VOLTS_MARGIN: f32 = 1.5;

/// Returns the force limit at the tip for a backup whose limits contain none.
fn default_tip_force() -> f32 {
    GENTLE_FORCE
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
            tip_force: 1.0e3,
        }
    }
}

/// The quantity that a number limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Limit {
    /// Joint torque, N m.
    Torque,
    /// Motor current, A.
    Current,
    /// Motor current that may flow continuously, A.
    ContinuousCurrent,
    /// Joint speed, rad/s.
    Speed,
    /// Mean power into the hand, W.
    Power,
    /// Lowest bus voltage, V.
    BusMin,
    /// Highest bus voltage, V.
    BusMax,
    /// Force at the tip, N.
    TipForce,
    /// Time for which a host may be silent, s.
    HostSeconds,
    /// Counts between two index pulses.
    IndexPeriod,
}

impl Limit {
    /// Returns the name and, for a joint with these units, the unit and the factor from a number of [`Limits`].
    pub const fn words(self, units: &JointUnits) -> (&'static str, &'static str, f32) {
        match self {
            Self::Torque => ("torque", units.torque, 1.0 / units.lever),
            Self::Current => ("current", "A", 1.0),
            Self::ContinuousCurrent => ("continuous current", "A", 1.0),
            Self::Speed => ("speed", units.speed, units.lever),
            Self::Power => ("power into the hand", "W", 1.0),
            Self::BusMin => ("lowest supply voltage", "V", 1.0),
            Self::BusMax => ("highest supply voltage", "V", 1.0),
            Self::TipForce => ("force at the tip", "N", 1.0),
            Self::HostSeconds => ("silence of the host", "s", 1.0),
            Self::IndexPeriod => ("index period", "counts", 1.0),
        }
    }
}

/// A number that a board does not accept as a limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BadLimit {
    /// Limited quantity.
    pub limit: Limit,
    /// Joint, from 0; `None` if the limit does not belong to a joint.
    pub joint: Option<u8>,
    /// Rejected number.
    pub value: f32,
    /// Smallest accepted number. Torque, current, speed, power and force must be above it.
    pub least: f32,
    /// Largest accepted number.
    pub most: f32,
}

impl BadLimit {
    /// Writes the text for a joint with these units.
    pub fn write(&self, units: &JointUnits, f: &mut impl core::fmt::Write) -> core::fmt::Result {
        let (name, unit, factor) = self.limit.words(units);
        write!(f, "the {name}")?;
        if let Some(joint) = self.joint {
            write!(f, " of joint {joint}")?;
        }
        write!(f, " cannot be {} {unit}: this board accepts ", factor * self.value)?;
        match (self.least, factor * self.most) {
            (0.0, f32::INFINITY) => f.write_str("0 or more"),
            (0.0, most) => write!(f, "more than 0 and at most {most} {unit}"),
            (least, most) => write!(f, "{least} to {most} {unit}"),
        }
    }
}

impl core::fmt::Display for BadLimit {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.write(&JointUnits::REVOLUTE, f)
    }
}

impl Limits {
    /// Returns the limits of joints with these units in those units.
    pub fn in_units(&self, units: &[&JointUnits]) -> Self {
        let mut limits = *self;
        for ((torque, speed), units) in limits.torque.iter_mut().zip(&mut limits.speed).zip(units) {
            (*torque, *speed) = (*torque / units.lever, *speed * units.lever);
        }
        limits
    }

    /// Returns true if every number is finite, positive and not larger than in `most`.
    pub fn is_within(&self, most: &Self) -> bool {
        self.first_wrong_limit(most).is_none()
    }

    /// Returns the first number that is not positive, or larger than in `most`.
    pub fn first_wrong_limit(&self, most: &Self) -> Option<BadLimit> {
        let each = [
            (Limit::Torque, &self.torque, &most.torque),
            (Limit::Current, &self.current, &most.current),
            (Limit::ContinuousCurrent, &self.continuous_current, &most.current),
            (Limit::Speed, &self.speed, &most.speed),
        ];
        for (limit, values, bounds) in each {
            for (joint, (value, most)) in (0..).zip(values.iter().zip(bounds)) {
                if !(*value > 0.0 && value <= most) {
                    return Some(BadLimit { limit, joint: Some(joint), value: *value, least: 0.0, most: *most });
                }
            }
        }
        let one = |limit, value, least, most| Some(BadLimit { limit, joint: None, value, least, most });
        if !(self.power > 0.0 && self.power <= most.power) {
            return one(Limit::Power, self.power, 0.0, most.power);
        }
        if !(self.tip_force > 0.0 && self.tip_force <= most.tip_force) {
            return one(Limit::TipForce, self.tip_force, 0.0, most.tip_force);
        }
        if !(self.bus_min >= most.bus_min && self.bus_min < most.bus_max) {
            return one(Limit::BusMin, self.bus_min, most.bus_min, most.bus_max);
        }
        if !(self.bus_max > self.bus_min && self.bus_max <= most.bus_max) {
            return one(Limit::BusMax, self.bus_max, self.bus_min, most.bus_max);
        }
        None
    }

    /// Returns true if no limit is higher than in `other`, so that the change is safe at any time.
    pub fn is_no_higher_than(&self, other: &Self) -> bool {
        let mut steady = self.continuous_current.iter().zip(&other.continuous_current);
        // Compared with the new current limit only, because the new limit may be below the old continuous current.
        let rest = Self { continuous_current: self.current, ..*self };
        steady.all(|(value, bound)| *value > 0.0 && value <= bound) && rest.is_within(other)
    }
}
