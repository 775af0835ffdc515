//! The DRV8301 gate driver of an axis: configuration by two control registers, read-back, status.
//!
//! Texas Instruments SLOS719F, section 7.5. Frames are 16 bits, with the clock idle low and data sampled at the falling
//! edge. The value of a read comes with the next frame. A low EN_GATE resets the registers.

use crate::angle_sensors::{Select, exchange_in_task};
use crate::gate::GateError;

/// Gain of the shunt amplifiers, V/V (control register 2, bits 3:2 = 3).
pub const AMPLIFIER_GAIN: f32 = 80.0;

const STATUS_1: u16 = 0;
const STATUS_2: u16 = 1;
const CONTROL_1: u16 = 2;
const CONTROL_2: u16 = 3;
/// Gate current 1.7 A, six independent gate signals, latched shutdown at an over-current of 0.730 V across a switch.
const CONTROL_1_VALUE: u16 = (21 << 6) | (1 << 4);
/// Amplifier gain 80 V/V, inputs connected, over-temperature and over-current both reported.
const CONTROL_2_VALUE: u16 = 3 << 2;
/// Bits that disconnect both amplifiers' inputs from the shunts and short the inputs.
const SHORTED_INPUTS: u16 = 0b11 << 4;

/// The connection of the shunt amplifiers' inputs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Inputs {
    /// Shorted: the output is the amplifier's offset.
    Shorted,
    /// Connected to the shunts.
    Shunts,
}

impl Inputs {
    fn control_2(self) -> u16 {
        CONTROL_2_VALUE | if self == Self::Shorted { SHORTED_INPUTS } else { 0 }
    }
}

/// One gate driver, addressed by its chip select.
pub struct Drv8301 {
    select: Select,
}

impl Drv8301 {
    /// Creates the driver with this chip select line (active low, and idle).
    pub fn new(select: Select) -> Self {
        Self { select }
    }

    fn transfer(&mut self, frame: u16) -> Result<u16, GateError> {
        let reply = exchange_in_task(self.select, frame);
        // SLOS719F requires 400 ns of idle select between frames; this delay is 600 ns.
        cortex_m::asm::delay(100);
        reply.ok_or(GateError::Bus)
    }

    fn write(&mut self, register: u16, value: u16) -> Result<(), GateError> {
        self.transfer((register << 11) | (value & 0x7FF))?;
        Ok(())
    }

    fn read(&mut self, register: u16) -> Result<u16, GateError> {
        let request = 0x8000 | (register << 11);
        self.transfer(request)?;
        Ok(self.transfer(request)? & 0x7FF)
    }

    /// Writes the control registers, reads them back, and clears and checks the status. Call 10 ms after EN_GATE rises.
    pub fn configure(&mut self, inputs: Inputs) -> Result<(), GateError> {
        self.write(CONTROL_1, CONTROL_1_VALUE)?;
        self.write(CONTROL_2, inputs.control_2())?;
        self.read_back(inputs)?;
        let (status_1, status_2) = self.status()?;
        // Bit 10 of status 1 is FAULT, bit 7 of status 2 is GVDD_OV.
        if status_1 & (1 << 10) != 0 || status_2 & (1 << 7) != 0 {
            return Err(GateError::Fault(status_1, status_2));
        }
        Ok(())
    }

    /// Checks that the control registers hold the values that [`Drv8301::configure`] wrote.
    pub fn read_back(&mut self, inputs: Inputs) -> Result<(), GateError> {
        let control_1 = self.read(CONTROL_1)?;
        let control_2 = self.read(CONTROL_2)?;
        let is_kept = control_1 == CONTROL_1_VALUE && control_2 == inputs.control_2();
        if is_kept { Ok(()) } else { Err(GateError::Readback) }
    }

    pub fn status(&mut self) -> Result<(u16, u16), GateError> {
        Ok((self.read(STATUS_1)?, self.read(STATUS_2)?))
    }
}
