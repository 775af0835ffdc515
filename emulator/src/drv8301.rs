//! A DRV8301 gate driver as its SPI bus sees it (Texas Instruments SLOS719F section 7.5): two status and two control
//! registers, a reading's answer in the frame after its request, and nothing at all while EN_GATE is low.

use rigless::chip::Timeline;
use rigless::chip::spi::Peer;
use rigless::snapshot::Store;

/// Bit of a frame that asks for a register instead of writing it.
const READ: u32 = 1 << 15;
/// The device's identity in status register 2.
const DEVICE_ID: u16 = 1;
/// FAULT in status register 1.
const FAULT: u16 = 1 << 10;
/// The gain of the shunt amplifiers by control register 2, bits 3:2.
const GAINS: [f64; 4] = [10.0, 20.0, 40.0, 80.0];

/// Control register 2, bits 5:4: inputs of the amplifiers shorted.
const CALIBRATE: u16 = 0b11 << 4;

/// One gate driver.
#[derive(Debug, Default)]
pub struct Drv8301 {
    on: bool,
    control: [u16; 2],
    fault: u16,
    answer: u16,
    stuck: bool,
}

/// No snapshots: a run starts at power-on.
impl Store for Drv8301 {}

impl Drv8301 {
    /// EN_GATE's level: low puts every register back and clears the faults.
    pub fn enable(&mut self, on: bool) {
        if self.on != on {
            *self = Self { on, stuck: self.stuck, ..Self::default() };
        }
    }

    /// Latches fault bits of status register 1, which pull the fault line down; 0 clears them.
    pub fn fail(&mut self, bits: u16) {
        self.fault = bits & 0x3FF;
    }

    /// Returns true if it pulls the fault line.
    #[must_use]
    pub fn pulls_fault(&self) -> bool {
        self.on && self.fault != 0
    }

    /// Makes its control registers forget what is written: a driver that is not there, or broken.
    pub fn stick(&mut self, stuck: bool) {
        self.stuck = stuck;
    }

    /// Puts its registers where power-on puts them, as a dip of its supply does.
    pub fn forget(&mut self) {
        self.control = [0; 2];
    }

    /// Returns the gain of its shunt amplifiers (zero while their inputs are shorted), or `None` while they are off.
    #[must_use]
    pub fn gain(&self) -> Option<f64> {
        let shorted = self.control[1] & CALIBRATE != 0;
        self.on.then(|| if shorted { 0.0 } else { GAINS[usize::from(self.control[1] >> 2) & 3] })
    }

    /// The control registers as written.
    #[must_use]
    pub fn control(&self) -> [u16; 2] {
        self.control
    }

    fn register(&self, address: u32) -> u16 {
        match address {
            0 => self.fault | if self.fault != 0 { FAULT } else { 0 },
            1 => DEVICE_ID,
            2 | 3 => self.control[address as usize - 2],
            _ => 0,
        }
    }
}

impl Peer for Drv8301 {
    fn transfer(&mut self, mosi: u32, bits: u8, _: &mut Timeline<'_, '_>) -> u32 {
        // Off, or in frames it does not know, it leaves the line to the pull-up.
        if !self.on || bits != 16 {
            return (1 << bits) - 1;
        }
        let answer = u32::from(self.answer);
        let address = (mosi >> 11) & 0xF;
        if mosi & READ != 0 {
            self.answer = (address << 11) as u16 | self.register(address);
        } else {
            if matches!(address, 2 | 3) && !self.stuck {
                self.control[address as usize - 2] = (mosi & 0x7FF) as u16;
            }
            self.answer = 0;
        }
        answer
    }
}
