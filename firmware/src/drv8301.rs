//! The DRV8301 gate driver of an axis: configuration by two control registers, read-back, status.
//!
//! Texas Instruments SLOS719F, section 7.5. Frames are 16 bits, with the clock idle low and data sampled at the falling
//! edge. The value of a read comes with the next frame. A low EN_GATE resets the registers.

use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Blocking;
use embassy_stm32::spi::{Error, Spi, mode::Master};

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

/// The SPI bus that both drivers share.
pub type Bus = Spi<'static, Blocking, Master>;

impl From<Error> for GateError {
    fn from(_: Error) -> Self {
        Self::Bus
    }
}

/// One gate driver, addressed by its chip select.
pub struct Drv8301 {
    select: Output<'static>,
}

impl Drv8301 {
    /// Creates the driver with this chip select line (active low).
    pub fn new(select: Output<'static>) -> Self {
        Self { select }
    }

    fn transfer(&mut self, bus: &mut Bus, frame: u16) -> Result<u16, GateError> {
        let mut word = [frame];
        self.select.set_low();
        let sent = bus.blocking_transfer_in_place(&mut word);
        self.select.set_high();
        // SLOS719F requires 400 ns of idle select between frames; this delay is 600 ns.
        cortex_m::asm::delay(100);
        sent?;
        Ok(word[0])
    }

    fn write(&mut self, bus: &mut Bus, register: u16, value: u16) -> Result<(), GateError> {
        self.transfer(bus, (register << 11) | (value & 0x7FF))?;
        Ok(())
    }

    fn read(&mut self, bus: &mut Bus, register: u16) -> Result<u16, GateError> {
        let request = 0x8000 | (register << 11);
        self.transfer(bus, request)?;
        Ok(self.transfer(bus, request)? & 0x7FF)
    }

    /// Writes the control registers, reads them back, and clears and checks the status. Call 10 ms after EN_GATE rises.
    pub fn configure(&mut self, bus: &mut Bus, inputs: Inputs) -> Result<(), GateError> {
        self.write(bus, CONTROL_1, CONTROL_1_VALUE)?;
        self.write(bus, CONTROL_2, inputs.control_2())?;
        self.read_back(bus, inputs)?;
        let (status_1, status_2) = self.status(bus)?;
        // Bit 10 of status 1 is FAULT, bit 7 of status 2 is GVDD_OV.
        if status_1 & (1 << 10) != 0 || status_2 & (1 << 7) != 0 {
            return Err(GateError::Fault(status_1, status_2));
        }
        Ok(())
    }

    /// Checks that the control registers hold the values that [`Drv8301::configure`] wrote.
    pub fn read_back(&mut self, bus: &mut Bus, inputs: Inputs) -> Result<(), GateError> {
        let control_1 = self.read(bus, CONTROL_1)?;
        let control_2 = self.read(bus, CONTROL_2)?;
        let is_kept = control_1 == CONTROL_1_VALUE && control_2 == inputs.control_2();
        if is_kept { Ok(()) } else { Err(GateError::Readback) }
    }

    pub fn status(&mut self, bus: &mut Bus) -> Result<(u16, u16), GateError> {
        Ok((self.read(bus, STATUS_1)?, self.read(bus, STATUS_2)?))
    }
}
