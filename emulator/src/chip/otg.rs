//! The USB OTG full-speed core at its addresses, with a computer at the cable's other end. The transactions of [`Host`]
//! reach the endpoints at their own times.

use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::time::EventId;

use super::map::otg_table;
use crate::otg_core::{BLOCK_OFFSETS, Core, FIFOS, GRXSTSP};
use crate::usb::Host;

/// The core, connected to the host.
#[derive(Debug, Default)]
pub struct Otg {
    core: Core,
    /// Computer at the cable's other end.
    pub host: Host,
    block: usize,
    line: Level,
}

impl Otg {
    /// Returns the model for accesses to `block`, one of the core's four blocks.
    pub fn model_of_block(&mut self, block: usize) -> &mut dyn ErasedDevice {
        self.block = block;
        self
    }

    /// Resets the core after a restart of the chip. The pull-up goes off, so the host sees the device disconnect.
    pub fn chip_reset(&mut self) {
        self.core = Core::default();
        self.line = Level::Low;
        self.host.device_disconnected();
    }

    /// Lets the host process new requests and the state of the device.
    pub fn update_host(&mut self, context: &mut DeviceContext<'_>) {
        self.advance(context);
    }

    fn advance(&mut self, context: &mut DeviceContext<'_>) {
        if std::mem::take(&mut self.core.soft_reset) {
            self.host.device_disconnected();
        }
        if let Some(at) = self.host.advance(&mut self.core, context.now()) {
            context.schedule(at);
        }
        let line = self.core.line();
        if line != self.line {
            self.line = line;
            context.interrupt(0, line);
        }
    }

    fn offset(&self, row: usize) -> u32 {
        let within = otg_table(self.block)[row].offset;
        BLOCK_OFFSETS[self.block] + within
    }
}

impl ErasedDevice for Otg {
    fn layout(&self) -> &'static [RegisterSpec] {
        otg_table(self.block)
    }

    fn read(&mut self, row: usize, _: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        let offset = self.offset(row);
        let value = self.core.read(offset, context.now());
        if matches!(offset, GRXSTSP | FIFOS..) {
            self.advance(context);
        }
        Some(u64::from(value))
    }

    fn write(&mut self, row: usize, value: u64, _: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.core.write(self.offset(row), value as u32);
        self.advance(context);
    }

    fn on_event(&mut self, _: EventId, _: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.advance(context);
    }

    fn on_request(&mut self, _: RequestChange, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    fn on_clock(&mut self, _: u64, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    fn poll(&mut self, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    fn reset(&mut self) {
        self.chip_reset();
    }

    fn on_access(&mut self, _: u64, _: u64, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    fn on_refused(&mut self, _: u64, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}
}
