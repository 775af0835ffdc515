//! The tasks' side of a board's power stage: they ready it before the motors may be armed, and check that it stays
//! ready.

use haptic_bridge::safety::fault::Fault;

/// The power stage of a board as its tasks own it: gate drivers with registers, or an enable line alone.
pub trait Gate {
    /// Readies the power stage and learns the current sensors' zeros while no current flows: some 10 ms. On an error
    /// everything is off again.
    fn raise(&mut self) -> Result<(), GateError>;

    /// Returns true if it still is as [`Gate::raise`] left it.
    fn check(&mut self) -> Result<(), GateError>;
}

/// Errors while the power stage is readied.
#[derive(Clone, Copy, PartialEq, Debug, defmt::Format)]
#[allow(dead_code, reason = "a board without gate drivers has fewer ways to fail")]
pub enum GateError {
    /// The transfer itself failed.
    Bus,
    /// A control register did not read back as written: no driver there, or no supply.
    Readback,
    /// The driver reports a fault; its status registers.
    Fault(u16, u16),
    /// The current sensors' zero is this far from the middle of their range, A.
    Offset(f32),
    /// This current flows though the bridges are off, A.
    Stray(f32),
}

impl GateError {
    /// The number that a fault record keeps of it.
    pub fn value(self) -> f32 {
        match self {
            Self::Bus | Self::Readback => 0.0,
            Self::Fault(status, _) => f32::from(status),
            Self::Offset(current) | Self::Stray(current) => current,
        }
    }

    /// Which fault it is.
    pub fn fault(self) -> Fault {
        match self {
            Self::Bus | Self::Readback | Self::Fault(..) => Fault::GateDriver,
            Self::Offset(_) | Self::Stray(_) => Fault::StrayCurrent,
        }
    }
}
