//! The machine of a board without a chip: a control loop, and settings in memory.

use super::flash::SettingsFlash;
use haptic_bridge::board::dispatch::Described;
use haptic_bridge::board::machine::{Machine, Measurements};
use haptic_bridge::board::protocol::{ForceAnswer, ForceRequest, Info};
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Command, ControlLoop, Reply, Rules, Status};
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};
use haptic_bridge::safety::refusal::Refusal;

/// The machine of a board that is a program on this computer. With debug assertions, it panics if the service sets the
/// timer or writes flash while the motors are on.
#[derive(Debug)]
pub struct LocalMachine {
    /// The control loop.
    pub control_loop: ControlLoop<Box<Program<BoardMath>>>,
    /// The settings.
    pub flash: SettingsFlash,
    /// The carrier for the control rate.
    pub carrier: Carrier,
    /// Number of changes of the carrier, one for every new program.
    pub carrier_changes: u32,
    info: Info,
    /// Time from sampling to the effect of the duty, carrier periods.
    delay: f64,
}

impl LocalMachine {
    /// Creates a machine without settings that reports `info` and has the delay `delay`, carrier periods.
    pub fn new(hardware: Hardware, info: Info, delay: f64) -> Self {
        Self {
            control_loop: ControlLoop::new(hardware, Rules::default()),
            flash: SettingsFlash::default(),
            carrier: Carrier::for_rate(hardware.timer_hz, CARRIER_MIN_HZ as f32),
            carrier_changes: 0,
            info,
            delay,
        }
    }

    fn motors_are_off(&self) -> bool {
        !self.control_loop.status().state.drives()
    }
}

impl Machine for LocalMachine {
    type Math = BoardMath;
    type StoredProgram = Box<Program<BoardMath>>;

    fn execute(&mut self, command: Command<Self::StoredProgram>) -> Reply<Self::StoredProgram> {
        self.control_loop.execute(command)
    }
    fn status(&mut self) -> Status {
        self.control_loop.status()
    }
    fn force(&mut self, request: &ForceRequest) -> ForceAnswer {
        self.control_loop.force(request)
    }
    fn place(&mut self, program: Program<BoardMath>) -> Result<Self::StoredProgram, Refusal> {
        Ok(Box::new(program))
    }
    fn release(&mut self, _held: Self::StoredProgram) {}
    fn retime(&mut self, rate_hz: f32) {
        debug_assert!(self.motors_are_off(), "the timer is set while the motors are on");
        self.carrier = Carrier::for_rate(self.carrier.timer_hz, rate_hz);
        self.carrier_changes = self.carrier_changes.wrapping_add(1);
    }
    fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal> {
        debug_assert!(self.motors_are_off(), "flash is written while the motors are on");
        self.flash.stage(key, entry)
    }
    fn staged(&mut self, key: Key) -> Option<Entry> {
        self.flash.staged(key)
    }
    fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal> {
        debug_assert!(self.motors_are_off(), "flash is written while the motors are on");
        self.flash.commit(keys)
    }
    fn load(&mut self, key: Key) -> Option<Entry> {
        self.flash.load(key)
    }
}

impl Described for LocalMachine {
    fn info(&self) -> Info {
        self.info.clone()
    }
    fn measurements(&mut self) -> Measurements {
        let delay = self.delay / f64::from(self.carrier.divider);
        Measurements { carrier_hz: self.carrier.carrier_hz(), delay_samples: delay as f32, ..Measurements::default() }
    }
}
