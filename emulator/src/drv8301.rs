//! A DRV8301 gate driver on its SPI bus (Texas Instruments SLOS719F section 7.5), with two status and two control
//! registers. The reply to a read follows in the next frame. While EN_GATE is low, the driver does not reply.

use rigless::chip::Timeline;
use rigless::chip::spi::Peer;
use rigless::snapshot::Store;

const READ_BIT: u32 = 1 << 15;
/// Identity of the device, in status register 2.
const DEVICE_ID: u16 = 1;
const FAULT_BIT: u16 = 1 << 10;
/// Gains of the shunt amplifiers, selected by bits 3:2 of control register 2.
const GAINS: [f64; 4] = [10.0, 20.0, 40.0, 80.0];

/// Bits 5:4 of control register 2, which short the amplifiers' inputs.
const SHORTED_INPUTS: u16 = 0b11 << 4;

/// One gate driver.
#[derive(Debug, Default)]
pub struct Drv8301 {
    is_enabled: bool,
    control: [u16; 2],
    fault: u16,
    next_reply: u16,
    ignores_writes: bool,
}

/// Not stored in snapshots, because a run starts at power-on.
impl Store for Drv8301 {}

impl Drv8301 {
    /// Sets the level of EN_GATE. A low level resets every register and clears the faults.
    pub fn enable(&mut self, enabled: bool) {
        if self.is_enabled != enabled {
            *self = Self { is_enabled: enabled, ignores_writes: self.ignores_writes, ..Self::default() };
        }
    }

    /// Latches fault bits of status register 1, which pull the fault line low. A value of 0 clears them.
    pub fn latch_fault(&mut self, bits: u16) {
        self.fault = bits & 0x3FF;
    }

    /// Returns true if the driver pulls the fault line low.
    #[must_use]
    pub fn pulls_fault(&self) -> bool {
        self.is_enabled && self.fault != 0
    }

    /// Makes the control registers ignore writes, as in a missing or broken driver.
    pub fn ignore_writes(&mut self, ignores_writes: bool) {
        self.ignores_writes = ignores_writes;
    }

    /// Resets the control registers, like a dip of the driver's supply.
    pub fn reset_control_registers(&mut self) {
        self.control = [0; 2];
    }

    /// Returns the gain of the shunt amplifiers (0 while their inputs are shorted), or `None` while the driver is off.
    #[must_use]
    pub fn gain(&self) -> Option<f64> {
        let shorted = self.control[1] & SHORTED_INPUTS != 0;
        self.is_enabled.then(|| if shorted { 0.0 } else { GAINS[usize::from(self.control[1] >> 2) & 3] })
    }

    /// Returns the control registers.
    #[must_use]
    pub fn control(&self) -> [u16; 2] {
        self.control
    }

    fn register(&self, address: u32) -> u16 {
        match address {
            0 => self.fault | if self.fault != 0 { FAULT_BIT } else { 0 },
            1 => DEVICE_ID,
            2 | 3 => self.control[address as usize - 2],
            _ => 0,
        }
    }
}

impl Peer for Drv8301 {
    fn transfer(&mut self, mosi: u32, bits: u8, _: &mut Timeline<'_, '_>) -> u32 {
        // While off, and in frames of unknown length, the driver leaves the line to the pull-up.
        if !self.is_enabled || bits != 16 {
            return (1 << bits) - 1;
        }
        let reply = u32::from(self.next_reply);
        let address = (mosi >> 11) & 0xF;
        if mosi & READ_BIT != 0 {
            self.next_reply = (address << 11) as u16 | self.register(address);
        } else {
            if matches!(address, 2 | 3) && !self.ignores_writes {
                self.control[address as usize - 2] = (mosi & 0x7FF) as u16;
            }
            self.next_reply = 0;
        }
        reply
    }
}
