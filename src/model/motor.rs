//! The data of a motor, for device files and boards.

use crate::math::{Real, cast};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The windings of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub enum Winding<T> {
    /// One winding behind brushes, on two legs of a bridge.
    #[default]
    Brushed,
    /// Three phases with surface magnets, on three legs.
    ThreePhase {
        /// Electrical turns per turn of the motor's shaft.
        pole_pairs: u8,
        /// Turns of the shaft per turn of the joint.
        ratio: T,
    },
}

/// A motor, referred to the joint.
///
/// Resistance and inductance of a three-phase motor are those between a phase and the neutral point. Its current is the
/// quadrature current, amplitude-invariant: 1 A is 1 A peak in a phase. Its back-EMF is the peak of a phase.
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
    /// Windings.
    #[serde(default = "brushed")]
    pub winding: Winding<T>,
    /// True if a person or a calibration has verified these numbers. A real board refuses to arm unverified motors.
    pub verified: bool,
}

/// Returns the winding of motors in backups that name none.
fn brushed<T>() -> Winding<T> {
    Winding::Brushed
}

impl<T: Real> Motor<T> {
    /// Returns the electrical turns per turn of the joint, of a three-phase motor.
    pub fn electrical_ratio(&self) -> Option<T> {
        match self.winding {
            Winding::Brushed => None,
            Winding::ThreePhase { pole_pairs, ratio } => Some(T::from_i32(pole_pairs.into()) * ratio),
        }
    }

    /// Returns the turns of the motor's shaft per turn of the joint. The shaft of a brushed motor counts as the joint's.
    pub fn shaft_ratio(&self) -> T {
        match self.winding {
            Winding::Brushed => T::one(),
            Winding::ThreePhase { ratio, .. } => ratio,
        }
    }

    /// Returns the supply voltage that drives this current (A) through the motor at rest, V. Space-vector modulation
    /// gives a phase at most 1/√3 of the supply.
    pub fn supply_at_rest(&self, current: T) -> T {
        let line_to_phase = if matches!(self.winding, Winding::Brushed) { 1.0 } else { 1.732_050_807_568_877_2 };
        self.resistance * current * T::from_f64(line_to_phase)
    }

    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Motor<U> {
        Motor {
            torque_constant: cast(self.torque_constant),
            resistance: cast(self.resistance),
            inductance: cast(self.inductance),
            back_emf: cast(self.back_emf),
            max_current: cast(self.max_current),
            winding: match self.winding {
                Winding::Brushed => Winding::Brushed,
                Winding::ThreePhase { pole_pairs, ratio } => Winding::ThreePhase { pole_pairs, ratio: cast(ratio) },
            },
            verified: self.verified,
        }
    }
}
