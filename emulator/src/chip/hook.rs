//! A model of rigless with an addition. Every call goes to the model and then to the hook.

use std::fmt::Debug;

use rigless::device::{Device, DeviceContext, ErasedDevice, RegisterFile, RequestChange};
use rigless::soc::{Layout, RegisterSpec, Width};
use rigless::time::{EventId, VirtualNanos};

/// An addition to the model `D`.
pub trait Hook<D>: Debug {
    /// Acts after every call of the model.
    fn after_call(&mut self, _: &mut D, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    /// Handles a request from another instance, before the model does.
    fn request(&mut self, _: RequestChange, _: &mut D, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}

    /// Handles the reply to an access. Returns true if the access belongs to the hook.
    fn handle_reply(&mut self, _token: u64, _value: u64, _: &mut DeviceContext<'_>) -> bool {
        false
    }

    /// Handles a store of `value` to memory that the instance programs. Returns true if the hook accepted it.
    fn handle_store(&mut self, _: (u64, Width, u64), _: &mut RegisterFile, _: &mut DeviceContext<'_>) -> bool {
        false
    }
}

/// A model and its hook.
#[derive(Debug)]
pub struct Hooked<D, H> {
    /// The model.
    pub inner: D,
    /// The addition.
    pub hook: H,
}

impl<D: Device + 'static, H: Hook<D>> ErasedDevice for Hooked<D, H> {
    fn layout(&self) -> &'static [RegisterSpec] {
        Device::layout(&self.inner)
    }

    fn read(&mut self, row: usize, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        let register = D::Register::from_index(row)?;
        let answer = self.inner.read(register, registers, context);
        self.hook.after_call(&mut self.inner, registers, context);
        answer
    }

    fn peek(&self, row: usize, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        self.inner.peek(D::Register::from_index(row)?, registers, now)
    }

    fn write(&mut self, row: usize, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if let Some(register) = D::Register::from_index(row) {
            self.inner.write(register, value, registers, context);
            self.hook.after_call(&mut self.inner, registers, context);
        }
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.on_event(event, registers, context);
        self.hook.after_call(&mut self.inner, registers, context);
    }

    fn on_request(&mut self, request: RequestChange, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.hook.request(request, &mut self.inner, registers, context);
        self.inner.on_request(request, registers, context);
        self.hook.after_call(&mut self.inner, registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.on_clock(hz, registers, context);
    }

    fn poll(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.poll(registers, context);
    }

    fn reset(&mut self) {
        self.inner.reset();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.reset_line(registers, context);
    }

    fn on_access(&mut self, token: u64, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if !self.hook.handle_reply(token, value, context) {
            self.inner.on_access(token, value, registers, context);
        }
    }

    fn write_region(
        &mut self,
        address: u64,
        width: Width,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        self.hook.handle_store((address, width, value), registers, context)
    }

    fn on_refused(&mut self, token: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.on_refused(token, registers, context);
    }
}
