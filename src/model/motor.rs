//! A motor as a device file gives it and as a board knows it: the same numbers, in either precision.

use crate::math::{Real, cast};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A brushed motor as seen at the joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Motor<T> {
    /// N m/A at the joint.
    pub torque_constant: T,
    /// ohm
    pub resistance: T,
    /// H
    pub inductance: T,
    /// V s/rad at the joint.
    pub back_emf: T,
    /// A
    pub max_current: T,
    /// A person or a calibration vouches for these numbers; a real board refuses to arm otherwise.
    pub verified: bool,
}

impl<T: Real> Motor<T> {
    /// The same in another precision.
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
