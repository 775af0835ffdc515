//! The tasks' requests to the control interrupt: one at a time, passed by address, carried out at a valley.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicPtr, Ordering};

use haptic_bridge::control::compiled::BoardProgram;
use haptic_bridge::control::host_force::{ForceAnswer, ForceRequest};
use haptic_bridge::control::{Command, Reply, Status};
use haptic_bridge::drive::carrier::Carrier;

/// A request of a task to the control interrupt.
pub enum Request {
    Command(Command<BoardProgram>),
    /// A request for the status alone.
    Status,
    /// A change of the carrier, with the motors off.
    Retime(Carrier),
    /// Rest of an accepted command: new rules are applied to one joint per valley, then the reply is sent.
    Settle,
    /// Rest of an accepted command that brings a program.
    Install(BoardProgram),
    /// No request, because the interrupt has taken it.
    None,
}

pub struct Outcome {
    pub reply: Reply<BoardProgram>,
    /// Status of the control loop after the request.
    pub status: Status,
}

/// A request and the place for its outcome, both owned by the waiting task.
pub(super) enum Exchange<'t> {
    Request(Request, &'t mut Option<Outcome>),
    /// A force request of the host; up to thousands arrive per second.
    Force(&'t ForceRequest, &'t mut Option<ForceAnswer>),
}

/// The tasks' end of the channel for requests.
pub struct Requests(pub(super) &'static AtomicPtr<Exchange<'static>>);

impl Requests {
    /// Passes a request to the control interrupt and waits for its outcome: at most one carrier period (50 us), one
    /// more for a command, and one more per joint if rules change.
    pub fn send(&mut self, request: Request) -> Outcome {
        let mut outcome = None;
        self.exchange(&UnsafeCell::new(Exchange::Request(request, &mut outcome)));
        // The interrupt writes an outcome for every request, so this reset is unreachable.
        outcome.unwrap_or_else(|| cortex_m::peripheral::SCB::sys_reset())
    }

    /// Passes the host's force request to the control interrupt and waits for the reply.
    pub fn send_force(&mut self, request: &ForceRequest) -> ForceAnswer {
        let mut reply = None;
        self.exchange(&UnsafeCell::new(Exchange::Force(request, &mut reply)));
        reply.unwrap_or_else(|| cortex_m::peripheral::SCB::sys_reset())
    }

    /// Passes an exchange to the interrupt and waits until the interrupt has released it. The interrupt may therefore
    /// treat the borrows in it as `'static`. If the interrupt has stopped, the watchdog ends the wait.
    #[inline(always)]
    fn exchange(&mut self, exchange: &UnsafeCell<Exchange>) {
        self.0.store(exchange.get().cast(), Ordering::Release);
        while !self.0.load(Ordering::Acquire).is_null() {}
    }
}
