//! The data of a motor, for device files and boards.

use crate::math::{Real, cast};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A brushed motor, referred to the joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Motor<T> {
    /// Torque constant, N m/A at the joint.
    pub torque_constant: T,
    /// Resistance, ohm.
    pub resistance: T,
    /// Inductance, H.
    pub inductance: T,
    /// Back-EMF constant, V s/rad at the joint.
    pub back_emf: T,
    /// Maximum current, A.
    pub max_current: T,
    /// True if a person or a calibration has verified these numbers. A real board refuses to arm unverified motors.
    pub verified: bool,
}

impl<T: Real> Motor<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Motor<U> {
        Motor {
            torque_constant: cast(self.torque_constant),
            resistance: cast(self.resistance),
            inductance: cast(self.inductance),
            back_emf: cast(self.back_emf),
            max_current: cast(self.max_current),
            verified: self.verified,
        }
    }
}
