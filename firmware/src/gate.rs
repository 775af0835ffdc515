//! The power stage, which the tasks enable before the motors are armed and check while the motors are on.

use haptic_bridge::safety::fault::Fault;

/// The power stage of a board: gate drivers with registers, or only an enable line.
pub trait Gate {
    /// Enables the power stage and learns the current sensors' zeros while no current flows. Takes 10 to 40 ms. Turns
    /// the power stage off after an error.
    fn raise(&mut self) -> Result<(), GateError>;
    /// Checks that the power stage is still configured as [`Gate::raise`] left it.
    fn check(&mut self) -> Result<(), GateError>;
}

#[derive(Clone, Copy, PartialEq, Debug, defmt::Format)]
#[allow(dead_code, reason = "a board without gate drivers has fewer ways to fail")]
pub enum GateError {
    /// The SPI transfer failed.
    Bus,
    /// A control register did not read back as written: the driver is missing or has no supply.
    Readback,
    /// The driver reports a fault, with these status registers.
    Fault(u16, u16),
    /// A current sensor's zero is too far from the middle of its range; distance, A.
    Offset(f32),
    /// A current flows although the bridges are off; A.
    Stray(f32),
}

impl GateError {
    /// Returns the value for the fault record.
    pub fn value(self) -> f32 {
        match self {
            Self::Bus | Self::Readback => 0.0,
            Self::Fault(status, _) => f32::from(status),
            Self::Offset(current) | Self::Stray(current) => current,
        }
    }

    /// Returns the fault of this error.
    pub fn fault(self) -> Fault {
        match self {
            Self::Bus | Self::Readback | Self::Fault(..) => Fault::GateDriver,
            Self::Offset(_) | Self::Stray(_) => Fault::StrayCurrent,
        }
    }
}
