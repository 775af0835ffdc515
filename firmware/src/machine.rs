//! The board behind the library's service. It builds programs in spare buffers and passes them to the control
//! interrupt, keeps settings in flash, and enables the gate drivers before arming.

use core::sync::atomic::Ordering;

use haptic_bridge::board::dispatch::Described;
use haptic_bridge::board::machine::{Machine, Measurements};
use haptic_bridge::board::protocol::{ForceAnswer, ForceRequest, Info, PROTOCOL};
use haptic_bridge::board::service::Service;
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::board::storage::StorageError;
use haptic_bridge::control::compiled::{BoardMath, BoardProgram};
use haptic_bridge::control::program::Program;
use haptic_bridge::control::{Command, Reply, Status};
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::safety::fault::{Fault, FaultRecord};
use haptic_bridge::safety::refusal::Refusal;
use heapless::{String, Vec};
use static_cell::StaticCell;

use crate::board::{Board, This};
use crate::clock::TIMER_HZ;
use crate::frames::FrameReader;
use crate::gate::Gate;
use crate::interrupt::{self, Request, Requests};
use crate::self_test;
use crate::stack;
use crate::storage::Storage;
use crate::supervisor;
use crate::watchdog;

/// Maximum number of programs: the running program and its replacement.
const PROGRAMS: usize = 2;

/// The part of the board that the tasks own.
pub struct BoardMachine {
    requests: Requests,
    pub frames: FrameReader,
    /// `None` if the image does not belong to this board.
    gate: Option<<This as Board>::Gate>,
    storage: Storage,
    serial: &'static str,
    unused_buffers: Vec<&'static StaticCell<Program<BoardMath>>, PROGRAMS>,
    spare_programs: Vec<BoardProgram, PROGRAMS>,
    carrier: Carrier,
}

impl BoardMachine {
    /// Creates the machine. Call once.
    pub fn new(
        channels: interrupt::TaskChannels,
        gate: Option<<This as Board>::Gate>,
        storage: Storage,
        serial: &'static str,
        carrier: Carrier,
    ) -> Self {
        static BUFFERS: [StaticCell<Program<BoardMath>>; PROGRAMS] = [const { StaticCell::new() }; PROGRAMS];
        Self {
            requests: channels.requests,
            frames: channels.frames,
            gate,
            storage,
            serial,
            unused_buffers: BUFFERS.iter().collect(),
            spare_programs: Vec::new(),
            carrier,
        }
    }

    /// Starts the storage and the service. Afterwards, reading a setting needs neither a write nor a search of the
    /// flash, which would outlast the watchdog while the motors are on.
    pub fn boot(&mut self, service: &mut Service) {
        while_flash_stalls(|| {
            self.storage.start();
            service.boot(self);
        });
    }

    /// Runs `work`, which writes flash.
    fn write(&mut self, work: impl FnOnce(&mut Storage) -> Result<(), StorageError>) -> Result<(), Refusal> {
        while_flash_stalls(|| work(&mut self.storage)).map_err(|error| {
            defmt::error!("the settings were not written: error {=u8}", error as u8);
            if error == StorageError::Unsettled { Refusal::Unsettled } else { Refusal::Flash }
        })
    }

    /// Enables the gate drivers. A driver that does not respond latches a fault.
    fn raise_gate(&mut self) -> Result<(), Refusal> {
        if let Some(record) = self_test::failed_test() {
            let _ = self.requests.send(Request::Command(Command::Fault(record)));
            return Err(Refusal::Faulted(record.fault));
        }
        let gate = self.gate.as_mut().ok_or(Refusal::NotSupported)?;
        // An earlier arming may have left the drivers enabled, but unchecked since the motors went off.
        lower_gate();
        let raised = gate.raise();
        interrupt::shared().gate_ready.store(raised.is_ok(), Ordering::Relaxed);
        match raised {
            Ok(()) => Ok(()),
            Err(error) => {
                defmt::error!("the gate drivers cannot be enabled: {}", error);
                let record = FaultRecord { fault: error.fault(), axis: None, value: error.value(), step: 0 };
                let _ = self.requests.send(Request::Command(Command::Fault(record)));
                Err(Refusal::Faulted(error.fault()))
            }
        }
    }

    /// Checks that enabled gate drivers still hold their configuration. Call a few times a second.
    pub fn watch_gate(&mut self) {
        if !interrupt::shared().gate_ready.load(Ordering::Relaxed) {
            return;
        }
        // An arming that ended before the control interrupt connected the bridges left the drivers enabled.
        if !self.status().state.drives() {
            return lower_gate();
        }
        let Some(Err(error)) = self.gate.as_mut().map(Gate::check) else { return };
        // A fault during the check disables the gate drivers and resets their registers, which is no driver fault.
        if interrupt::shared().gate_ready.load(Ordering::Relaxed) {
            defmt::error!("a gate driver lost its configuration: {}", error);
            let record = FaultRecord { fault: Fault::DriverReset, axis: None, value: error.value(), step: 0 };
            let _ = self.requests.send(Request::Command(Command::Fault(record)));
        }
    }
}

impl Machine for BoardMachine {
    type Math = BoardMath;
    type StoredProgram = BoardProgram;

    fn execute(&mut self, command: Command<BoardProgram>) -> Reply<BoardProgram> {
        let status = self.status();
        let question = match command {
            Command::Arm => Some(Command::MayArm),
            Command::ArmHeld(press) => Some(Command::MayArmHeld(press)),
            Command::CheckPolarity => Some(Command::MayCheckPolarity),
            Command::FindStops(press) => Some(Command::MayFindStops(press)),
            _ => None,
        };
        let powers_up = question.is_some();
        if let Some(question) = question {
            // Checks first whether the request will be refused, because a refused request must not power the gate
            // drivers, nor latch a fault if they have no supply.
            let refused = self.requests.send(Request::Command(question)).reply.0;
            // Refuses to arm while the motors are on, and right after a polarity check, when the gate drivers go off.
            let refused = if status.state.drives() { refused.and(Err(Refusal::Armed)) } else { refused };
            if let Err(refusal) = refused.and_then(|()| self.raise_gate()) {
                return (Err(refusal), None);
            }
        }
        let reply = self.requests.send(Request::Command(command)).reply;
        if powers_up && reply.0.is_err() {
            lower_gate();
        }
        reply
    }

    fn status(&mut self) -> Status {
        self.requests.send(Request::Status).status
    }

    fn force(&mut self, request: &ForceRequest) -> ForceAnswer {
        self.requests.send_force(request)
    }

    fn place(&mut self, program: Program<BoardMath>) -> Result<BoardProgram, Refusal> {
        if let Some(held) = self.spare_programs.pop() {
            *held = program;
            return Ok(held);
        }
        match self.unused_buffers.pop() {
            Some(buffer) => Ok(buffer.init(program)),
            None => Err(Refusal::Busy),
        }
    }

    fn release(&mut self, held: BoardProgram) {
        // The list has as many places as there are buffers.
        let _ = self.spare_programs.push(held);
    }

    fn retime(&mut self, rate_hz: f32) {
        let carrier = Carrier::for_rate(TIMER_HZ, rate_hz);
        if carrier != self.carrier {
            let _ = self.requests.send(Request::Retime(carrier));
            self.carrier = carrier;
            supervisor::expect_rate(carrier.rate_hz());
        }
    }

    fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal> {
        self.write(|storage| storage.stage(key as u8, entry))
    }

    fn staged(&mut self, key: Key) -> Option<Entry> {
        self.storage.staged(key as u8).ok().flatten().and_then(|entry| Entry::from_slice(entry).ok())
    }

    fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal> {
        let keys: Vec<u8, { Key::ALL.len() }> = keys.iter().map(|key| *key as u8).collect();
        self.write(|storage| storage.commit(&keys))
    }

    fn load(&mut self, key: Key) -> Option<Entry> {
        match self.storage.read(key as u8) {
            Ok(entry) => Entry::from_slice(entry?).ok(),
            Err(error) => {
                defmt::error!("setting {=u8} cannot be read: error {=u8}", key as u8, error as u8);
                Some(Entry::new())
            }
        }
    }
}

impl Described for BoardMachine {
    fn info(&self) -> Info {
        Info {
            protocol: PROTOCOL,
            firmware: truncate(env!("CARGO_PKG_VERSION")),
            board: truncate(This::NAME),
            serial: truncate(self.serial),
        }
    }

    fn measurements(&mut self) -> Measurements {
        // A few late steps (after a new program or a change of gains) do not change the delay, but many do.
        let late = supervisor::late_share() > 0.25;
        let delay = self.carrier.delay_samples();
        Measurements {
            carrier_hz: self.carrier.carrier_hz(),
            delay_samples: if late { 2.0 * delay } else { delay },
            unsensed: This::UNSENSED.iter().map(|fault| fault.code()).collect(),
            overruns: interrupt::shared().overruns.load(Ordering::Relaxed),
            longest_cycles: interrupt::shared().longest_cycles.load(Ordering::Relaxed),
            stack_free: stack::unused_bytes(),
        }
    }
}

/// Runs `work`, which may stall the program by writing flash. The watchdog waits, and overruns do not count.
fn while_flash_stalls<R>(work: impl FnOnce() -> R) -> R {
    interrupt::shared().stall_expected.store(true, Ordering::Relaxed);
    let result = watchdog::with_longest_time(work);
    interrupt::shared().stall_expected.store(false, Ordering::Relaxed);
    result
}

/// Disables the power stage. Call while the motors are off; only tasks switch them on.
fn lower_gate() {
    interrupt::shared().gate_ready.store(false, Ordering::Relaxed);
    This::turn_bridges_off();
}

/// Returns the part of `text` that fits into `N` bytes.
fn truncate<const N: usize>(text: &str) -> String<N> {
    let mut short = String::new();
    for character in text.chars() {
        if short.push(character).is_err() {
            break;
        }
    }
    short
}
