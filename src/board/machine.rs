//! The board around the service: control loop, timer and flash.

use crate::board::protocol::{ForceAnswer, ForceRequest};
use crate::board::settings::{Entry, Key};
use crate::control::program::Program;
use crate::control::{Command, Reply, Status};
use crate::math::Math;
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;
use heapless::Vec;

/// The parts of the board that the service uses.
pub trait Machine {
    /// Trigonometry of the control loop.
    type Math: Math<f32>;
    /// Storage of a program on this machine: a box, or a static buffer.
    type StoredProgram: DerefMut<Target = Program<Self::Math>>;
    /// Carries out a command between two control steps and waits for the reply.
    fn execute(&mut self, command: Command<Self::StoredProgram>) -> Reply<Self::StoredProgram>;
    /// Returns the control loop's state.
    fn status(&mut self) -> Status;
    /// Carries out a host's force request between two control steps, see
    /// [`ControlLoop::force`](crate::control::ControlLoop::force).
    fn force(&mut self, request: &ForceRequest) -> ForceAnswer;
    /// Stores a program for the control loop. Refused while the spare place is in use.
    fn place(&mut self, program: Program<Self::Math>) -> Result<Self::StoredProgram, Refusal>;
    /// Takes back a program that the control loop no longer uses.
    fn release(&mut self, held: Self::StoredProgram);
    /// Sets carrier and divider for a control rate (Hz). Called with the motors off.
    fn retime(&mut self, rate_hz: f32);
    /// Stages the next entry of a setting, which becomes valid with [`Machine::commit`].
    fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal>;
    /// Returns the entry staged for a setting since the start or the last commit.
    fn staged(&mut self, key: Key) -> Option<Entry>;
    /// Makes the staged entries of these settings valid. After a power cut, either all are valid or none.
    fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal>;
    /// Reads a setting. Returns an empty entry if the stored entry is damaged.
    fn load(&mut self, key: Key) -> Option<Entry>;
}

/// Parts of [`Details`](crate::board::protocol::Details) that only the machine can measure.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// Carrier frequency at the present control rate, Hz.
    pub carrier_hz: f32,
    /// Computation delay from sampling to duty, in control periods.
    pub delay_samples: f32,
    /// Codes of the faults that this board cannot detect with its wiring.
    pub unsensed: Vec<u8, 16>,
    /// Number of control interrupts since boot that lasted past the next crest.
    pub overruns: u32,
    /// Longest control interrupt, core cycles; 0 if it is not measured.
    pub longest_cycles: u32,
    /// Stack that was never used so far, bytes; 0 if it is not measured.
    pub stack_free: u32,
}

/// Returns [`Refusal::Armed`] while the motors are on.
pub fn check_motors_off(machine: &mut impl Machine) -> Result<(), Refusal> {
    if machine.status().state.drives() { Err(Refusal::Armed) } else { Ok(()) }
}
