//! The tasks' requests to the control interrupt: one at a time, handed over by address, and answered at a valley.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicPtr, Ordering};

use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::servo::compiled::BoardProgram;
use haptic_bridge::servo::host_force::{ForceAnswer, ForceRequest};
use haptic_bridge::servo::{Command, Reply, Status};

/// A request of the tasks to the control interrupt, one at a time.
pub enum Request {
    /// Something for the servo.
    Command(Command<BoardProgram>),
    /// Only the status.
    Status,
    /// Another carrier; motors off.
    Retime(Carrier),
    /// The rest of a command that has been obeyed: of new rules, valley by valley, and the answer.
    Settle,
    /// The rest of a command that brings a program: it was accepted.
    Install(BoardProgram),
    /// Nothing: it has been taken.
    None,
}

/// The outcome of a request.
pub struct Answer {
    /// Of a command.
    pub reply: Reply<BoardProgram>,
    /// The servo's state after it.
    pub status: Status,
}

/// A request and its answer, both with the task that asks: it waits.
pub(super) enum Exchange<'t> {
    /// A request of the tasks.
    Request(Request, &'t mut Option<Answer>),
    /// A force request of the host, thousands of times a second.
    Force(&'t ForceRequest, &'t mut Option<ForceAnswer>),
}

/// The tasks' end of the requests.
pub struct Requests(pub(super) &'static AtomicPtr<Exchange<'static>>);

impl Requests {
    /// Hands a request to the control interrupt and waits for its answer: at most one carrier period, 50 us; one more for a
    /// command, and another for each joint where rules change.
    pub fn ask(&mut self, request: Request) -> Answer {
        let mut answer = None;
        self.exchange(&UnsafeCell::new(Exchange::Request(request, &mut answer)));
        // The interrupt answers whatever it takes.
        answer.unwrap_or_else(|| cortex_m::peripheral::SCB::sys_reset())
    }

    /// The same, of what the host asks the motors for.
    pub fn ask_force(&mut self, request: &ForceRequest) -> ForceAnswer {
        let mut answer = None;
        self.exchange(&UnsafeCell::new(Exchange::Force(request, &mut answer)));
        answer.unwrap_or_else(|| cortex_m::peripheral::SCB::sys_reset())
    }

    /// Hands an exchange over and waits until the interrupt has let go of it, which is why the interrupt may take what is
    /// borrowed there for `'static`. One that does not has stopped, and then the watchdog ends the wait.
    #[inline(always)]
    fn exchange(&mut self, exchange: &UnsafeCell<Exchange>) {
        self.0.store(exchange.get().cast(), Ordering::Release);
        while !self.0.load(Ordering::Acquire).is_null() {}
    }
}
