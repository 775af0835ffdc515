//! The board around the service: the control loop, its timer and its flash.

use crate::board::protocol::{ForceAnswer, ForceRequest};
use crate::board::settings::{Entry, Key};
use crate::control::program::Program;
use crate::control::{Command, Reply, Status};
use crate::math::Math;
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;
use heapless::Vec;

/// The board around the service.
pub trait Machine {
    /// The trigonometry it computes with.
    type Math: Math<f32>;
    /// The machine's storage for a program: a box, or a static buffer.
    type Held: DerefMut<Target = Program<Self::Math>>;

    /// Carries a command out between two control steps and waits for the answer.
    fn execute(&mut self, command: Command<Self::Held>) -> Reply<Self::Held>;
    /// The control loop's state.
    fn status(&mut self) -> Status;
    /// Carries out what the host asks the motors for between two control steps, see
    /// [`ControlLoop::force`](crate::control::ControlLoop::force).
    fn force(&mut self, request: &ForceRequest) -> ForceAnswer;
    /// Puts a program where the control loop can use it; refused while the spare place is taken.
    fn place(&mut self, program: Program<Self::Math>) -> Result<Self::Held, Refusal>;
    /// Takes back a program that the control loop no longer uses.
    fn release(&mut self, held: Self::Held);
    /// Sets carrier and divider for a control rate (Hz). Called with the motors off.
    fn retime(&mut self, rate_hz: f32);
    /// Writes the next entry of a setting aside, where it does not count yet.
    fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal>;
    /// The entry staged for a setting since the start or the last commit.
    fn staged(&mut self, key: Key) -> Option<Entry>;
    /// Makes what was staged for these settings count: all of them or, when the power goes, none.
    fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal>;
    /// Reads a setting; an entry without a byte for one that was stored and is damaged.
    fn load(&mut self, key: Key) -> Option<Entry>;
}

/// The parts of [`Details`](crate::board::protocol::Details) that only the machine itself can measure.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Carrier frequency at the present control rate, Hz.
    pub carrier_hz: f32,
    /// Computation delay from sampling to duty, in control samples.
    pub delay_samples: f32,
    /// Faults (their codes) that this board cannot sense as it is wired.
    pub unsensed: Vec<u8, 16>,
    /// Runs of the control interrupt that reached past the next crest since boot.
    pub overruns: u32,
    /// Longest control interrupt seen, in core cycles; 0 where it is not measured.
    pub longest_cycles: u32,
    /// Stack never used so far, bytes; 0 where it is not measured.
    pub stack_free: u32,
}

/// Refuses while the motors are on.
pub fn must_be_off(machine: &mut impl Machine) -> Result<(), Refusal> {
    if machine.status().state.drives() { Err(Refusal::Armed) } else { Ok(()) }
}
