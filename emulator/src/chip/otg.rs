//! The USB OTG full-speed core at its addresses, with the cable's far end attached: a [`Host`] whose transactions reach
//! the endpoints at their own instants.

use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::time::EventId;

use super::map::otg_table;
use crate::otg_core::{BLOCK_OFFSETS, Core, FIFOS, GRXSTSP};
use crate::usb::Host;

/// The core with the host on its cable.
#[derive(Debug, Default)]
pub struct Otg {
    core: Core,
    /// The far end of the cable.
    pub host: Host,
    block: usize,
    line: Level,
}

impl Otg {
    /// The model as it answers for one of the core's four blocks.
    pub fn answering_for(&mut self, block: usize) -> &mut dyn ErasedDevice {
        self.block = block;
        self
    }

    /// The chip restarted: the pull-up is gone and the host sees a device leave.
    pub fn chip_reset(&mut self) {
        self.core = Core::default();
        self.line = Level::Low;
        self.host.device_left();
    }

    /// Lets the host look at what was handed to it, and at the device.
    pub fn look_outside(&mut self, context: &mut DeviceContext<'_>) {
        self.advance(context);
    }

    fn advance(&mut self, context: &mut DeviceContext<'_>) {
        if std::mem::take(&mut self.core.soft_reset) {
            self.host.device_left();
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
