//! The simulated board: the firmware's servo, service and protocol around a simulated device.
//!
//! Time is a count of carrier periods, so a run is the same on every machine. A period goes as on the chip: sample at
//! the carrier's crest, control at every `divider`-th crest, duties in force half a carrier period later.

use super::around::Around;
use super::broken::Broken;
use super::device::{DeviceError, Options, SimulatedDevice, Support};
use super::hand::{Hand, HandSettings};
use super::machine::LocalMachine;
use super::motor::{MotorInput, PowerStage};
use super::port::Port;
use haptic_bridge::board::dispatch::{self, After};
use haptic_bridge::board::protocol::{FaultSeen, Info, MAX_FRAME, PROTOCOL, Telemetry};
use haptic_bridge::board::service::Service;
use haptic_bridge::board::telemetry::Packer;
use haptic_bridge::drive::brushed::UNKNOWN_WINDING;
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, FaultRecord, State};
use haptic_bridge::safety::limits::{Limits, MOST_TIP_FORCE};
use haptic_bridge::safety::refusal::Refusal;
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::joints::{Counts, Currents};
use haptic_bridge::servo::program::Hardware;
use haptic_bridge::servo::{ARM_SECONDS, HostAction, Rules, Servo, Status};

/// Frequency that the PWM timers count at, as those of the real boards do, Hz.
pub const TIMER_HZ: u32 = 168_000_000;

/// The model of the motor drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriveModel {
    /// Duty, bus, winding: the current loop runs and is as good as it is.
    #[default]
    Electric,
    /// The commanded torque acts at once; what linear theory and the golden values assume.
    Ideal,
}

/// The options of a simulated board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardOptions {
    /// The device behind it.
    pub device: Options,
    /// The model of its motor drives.
    pub drive: DriveModel,
    /// From sampling to the duty in force, in carrier periods, 0 to 1. The boards have 0.5.
    pub delay: f64,
    /// Asks of a user what a real board asks: verified motors, limits, homing, polarity check. Its encoders then
    /// start at zero wherever the device stands; otherwise they know their angle.
    pub strict: bool,
    /// Help by a user from power-on until the motors carry the device, as docs/bring-up.md asks: its weight is carried
    /// while a polarity check moves it; after that it is carried back; and it is held while the torque ramps up after
    /// arming.
    pub support: Support,
    /// Motor axes.
    pub axes: usize,
    /// The faults present at power-on.
    pub broken: Broken,
    /// Bytes that wait for a host to read them; what comes on top of it is dropped and counted.
    pub send_buffer: usize,
    /// Serial number.
    pub serial: String,
}

impl Default for BoardOptions {
    fn default() -> Self {
        Self {
            device: Options::default(),
            drive: DriveModel::Electric,
            delay: 0.5,
            strict: false,
            support: Support::None,
            axes: 3,
            broken: Broken::default(),
            send_buffer: 256 * 1024,
            serial: "SIM0001".into(),
        }
    }
}

/// Speed of the joint that has the longest way while a moved device is carried back to where it is held, rad/s:
/// so fast that the board does not take it for one at rest.
const BACK_SPEED: f64 = 1.0;

/// Interval at which the service looks at the servo, s.
const POLL_SECONDS: f64 = 0.02;

/// The name of a board with torque that acts at once: whoever predicts its range must know.
pub const IDEAL_BOARD: &str = "simulated-ideal";

/// The identification of a board with these options.
fn info(options: &BoardOptions) -> Info {
    let board = match options.drive {
        DriveModel::Electric => "simulated",
        DriveModel::Ideal => IDEAL_BOARD,
    };
    // Longer text is cut; these are short names of this tool's own.
    Info {
        protocol: PROTOCOL,
        firmware: env!("CARGO_PKG_VERSION").chars().take(16).collect(),
        board: board.chars().take(16).collect(),
        serial: options.serial.chars().take(24).collect(),
    }
}

/// The limits that no setting can raise: those of a simulation fed with `supply` (V), with a real board's tip force
/// where its motors count as real.
fn most(hardware: Hardware, supply: f64) -> Limits {
    let limits = Limits::default();
    // As far below and above the supply as the usual limits are of the usual supply.
    let share = (supply / PowerStage::default().bus_voltage) as f32;
    let (bus_min, bus_max) = (limits.bus_min * share.min(1.0), limits.bus_max * share.max(1.0));
    let tip_force = if hardware.real { MOST_TIP_FORCE } else { limits.tip_force };
    Limits { bus_min, bus_max, tip_force, ..limits }
}

/// A board with a device on it.
#[derive(Debug)]
pub struct SimulatedBoard {
    service: Service,
    machine: LocalMachine,
    options: BoardOptions,
    device: SimulatedDevice,
    hardware: Hardware,
    countdown: u32,
    /// Number of times that the encoders were read.
    looks: u64,
    /// Counts at the last crest.
    seen: Counts,
    drive: [MotorInput; 3],
    bridges: bool,
    injected: Option<(Fault, Option<u8>, f32)>,
    since_poll: f64,
    packer: Packer,
    dropped: u32,
    link: Port,
    /// The path of the hand while the motors are on, and whether the hand follows it now.
    rounds: Option<Around>,
    going: bool,
    /// Since when the motors are armed, s.
    armed: Option<f64>,
    /// From where and since when (s) the device is carried back to where it stood at power-on.
    carried_back: Option<([f64; 3], f64)>,
}

impl SimulatedBoard {
    /// A board fresh from the factory, with the device of `description` wired to it.
    pub fn new(description: &Description, options: BoardOptions) -> Result<Self, DeviceError> {
        let device = SimulatedDevice::new(
            description,
            &Options { absolute_encoders: options.device.absolute_encoders || !options.strict, ..options.device },
        )?;
        let bridge = options.device.bridge;
        let wound = description.joints.iter().filter_map(|joint| joint.motor).any(|motor| motor.inductance > 0.0);
        let hardware = Hardware {
            axes: options.axes,
            real: options.strict,
            bus_sensed: true,
            bridge: Bridge {
                carrier_hz: bridge.carrier_hz as f32,
                dead_time: bridge.dead_time as f32,
                // The drive is slower where it knows no inductance; a simulated winding then really has none.
                bandwidth_hz: if wound { 1_500.0 } else { 1_500.0 / UNKNOWN_WINDING },
                // An ideal drive has neither voltage nor winding that a model could be held against.
                current_sensed: options.drive == DriveModel::Electric,
            },
            timer_hz: TIMER_HZ,
        };
        let seen = Counts(device.counts());
        let mut board = Self {
            service: Service::new(hardware, most(hardware, bridge.bus_voltage)),
            machine: LocalMachine::new(hardware, info(&options), options.delay),
            options: options.clone(),
            device,
            link: Port::new(options.send_buffer),
            hardware,
            countdown: 0,
            looks: 0,
            seen,
            drive: [MotorInput::Floating; 3],
            bridges: false,
            injected: None,
            since_poll: 0.0,
            packer: Packer::default(),
            dropped: 0,
            rounds: None,
            going: false,
            armed: None,
            carried_back: None,
        };
        board.support_anew();
        board.service.boot(&mut board.machine);
        Ok(board)
    }

    /// Loads a device and a scene as the tool would, so that the board is ready to arm.
    pub fn load(&mut self, name: &str, description: &Description, scene: Option<Scene<f32>>) -> Result<(), Refusal> {
        let device = Device::new(name, description).map_err(|_| Refusal::BadDevice)?;
        self.service.set_device(&mut self.machine, device)?;
        match scene {
            Some(scene) => self.service.set_scene(&mut self.machine, scene),
            None => Ok(()),
        }
    }

    /// Lets one carrier period pass; call it alone, without [`SimulatedBoard::control_period`], while a control period
    /// is under way.
    pub fn carrier(&mut self) {
        self.carrier_period(1);
    }

    /// Frequency of the carrier, Hz.
    pub fn carrier_hz(&self) -> f64 {
        self.machine.carrier.carrier_hz().into()
    }

    /// Lets one control period pass.
    pub fn control_period(&mut self) {
        match self.options.drive {
            DriveModel::Electric => {
                for _ in 0..self.machine.carrier.divider {
                    self.carrier_period(1);
                }
            }
            DriveModel::Ideal => self.carrier_period(self.machine.carrier.divider.into()),
        }
    }

    /// `carriers` periods of the carrier as one, with one sample and one set of duties.
    fn carrier_period(&mut self, carriers: u32) {
        let carrier = 1.0 / f64::from(self.machine.carrier.carrier_hz());
        let period = carrier * f64::from(carriers);
        let flowing = self.device.currents();
        let broken = &self.options.broken;
        let currents = Currents::from_fn(|axis| broken.current(&flowing, axis, axis) as f32);
        let bus_voltage = broken.bus_shown.unwrap_or(self.device.bus_voltage()) as f32;
        let due = self.countdown == 0;
        let counts = Counts(broken.counts(self.device.counts(), self.looks));
        self.looks += 1;
        let samples = Samples { counts, bus_voltage, currents, ..Samples::default() };
        self.guard_before(&samples, carriers);
        if due {
            self.countdown = self.machine.carrier.divider.into();
            let index = self.device.index();
            let marks = core::array::from_fn(|axis| index[axis].then_some(counts[axis]));
            if index.contains(&true) {
                self.machine.servo.mark(marks);
            }
            if let Some((fault, axis, value)) = self.injected.take() {
                self.machine.servo.trip(fault, axis, value);
            }
        }
        let (outputs, duties) = self.machine.servo.crest(&samples, &currents, due);
        self.bridges = outputs.bridges;
        if due {
            self.send_around();
            self.support();
        }
        self.countdown = self.countdown.saturating_sub(carriers);
        for _ in 0..carriers {
            self.bridges &= self.machine.servo.check_slow_faults(&samples).bridges;
        }
        if due {
            self.record();
        }
        let torques = self.machine.servo.frame().motors.torque;
        let mut next = [MotorInput::Floating; 3];
        for (axis, input) in next.iter_mut().enumerate() {
            *input = match (self.bridges, self.options.drive) {
                (false, _) => MotorInput::Floating,
                (true, DriveModel::Electric) => MotorInput::Duty(f64::from(f32::from(duties[axis]))),
                (true, DriveModel::Ideal) => MotorInput::Torque(f64::from(torques[axis])),
            };
        }
        let delay = (carrier * self.options.delay).min(period);
        if delay > 0.0 {
            self.device.step(&self.drive, delay);
        }
        self.drive = self.options.broken.drives(next);
        if period > delay {
            self.device.step(&self.drive, period - delay);
        }
        self.since_poll += period;
        if self.since_poll >= POLL_SECONDS {
            self.since_poll = 0.0;
            self.poll();
        }
    }

    /// Puts a hand on the tip that goes around whenever the motors are armed, from its start on. While they are not, it
    /// waits out of the walls: a board whose tip is inside one does not arm.
    pub fn set_rounds(&mut self, settings: HandSettings, around: Around) {
        let hand = Hand::new(settings, around.wait(), self.device.tip(), self.device.time());
        self.device.set_hand(hand);
        (self.rounds, self.going) = (Some(around), false);
    }

    fn send_around(&mut self) {
        let armed = self.machine.servo.frame().state == State::Armed;
        if let Some(around) = &self.rounds
            && armed != self.going
        {
            self.going = armed;
            let now = self.device.time();
            self.device.hand_mut().turn_to(if armed { around.intent() } else { around.wait() }, now);
        }
    }

    /// The device as it is supported when the board starts; held, where it is to be homed.
    fn support_anew(&mut self) {
        let support = self.options.support;
        if support == Support::Held {
            self.device.place(self.device.start());
            self.seen = Counts(self.device.counts());
        }
        self.carried_back = None;
        self.device.set_support(support);
    }

    /// Gives the device the user's help that this state of the board calls for.
    fn support(&mut self) {
        let now = self.device.support();
        let state = self.machine.servo.frame().state;
        let time = self.device.time();
        self.armed = (state == State::Armed).then(|| self.armed.unwrap_or(time));
        let ramped = self.armed.is_some_and(|armed| time >= armed + f64::from(ARM_SECONDS));
        // The user of a device that need not be homed also brings it back.
        let stays = self.options.support == Support::Held && !self.options.strict;
        let wanted = match (now, state) {
            (Support::None, _) if !stays => Support::None,
            (_, State::Armed) if ramped => Support::None,
            (_, State::Armed) => Support::Held,
            (_, State::CheckingPolarity) => Support::Carried,
            (_, State::Disarmed | State::Fault) => self.options.support,
        };
        if wanted != now {
            self.device.set_support(wanted);
        }
        let off = !state.drives();
        if (now == Support::Carried || stays && now == Support::None) && wanted == Support::Held && off {
            // The check has moved it, and homing again would take that for home.
            self.carried_back = Some((self.device.q(), time));
        }
        self.carried_back = self.carried_back.filter(|_| off);
        if let Some((from, since)) = self.carried_back {
            let to = self.device.start();
            let way: [f64; 3] = core::array::from_fn(|i| to[i] - from[i]);
            let longest = way.iter().fold(0.0_f64, |longest, way| longest.max(way.abs()));
            let share = (time - since) * BACK_SPEED / longest.max(1e-9);
            if share < 1.0 {
                self.device.place(core::array::from_fn(|i| from[i] + share * way[i]));
            } else {
                self.device.place(to);
                self.carried_back = None;
            }
        }
    }

    /// Shows the servo the crests of `carriers` periods but the last, between which the joints have turned evenly.
    fn guard_before(&mut self, seen: &Samples, carriers: u32) {
        let moved: [i64; 3] = core::array::from_fn(|axis| i64::from(seen.counts[axis].wrapping_sub(self.seen[axis])));
        for nth in 1..carriers {
            let counts = Counts::from_fn(|axis| {
                self.seen[axis].wrapping_add((moved[axis] * i64::from(nth) / i64::from(carriers)) as i32)
            });
            self.machine.servo.guard(&Samples { counts, ..*seen });
        }
        self.seen = seen.counts;
    }

    /// Adds the step to the stream. A row that the host is too slow for is dropped before it is packed, as on the
    /// chip, so that a batch once numbered is also sent.
    fn record(&mut self) {
        let frame = self.machine.servo.frame();
        if !self.packer.wants(frame.step) {
            return;
        }
        if !self.link.has_room() {
            self.dropped = self.dropped.wrapping_add(1);
        } else if let Some(batch) = self.packer.push(&frame, self.dropped) {
            self.link.publish::<Telemetry>(batch);
        }
    }

    fn poll(&mut self) {
        if let Some(record) = self.service.poll(&mut self.machine) {
            self.link.publish::<FaultSeen>(&record);
        }
        if let Some(batch) = self.packer.flush() {
            self.link.publish::<Telemetry>(batch);
        }
    }

    /// Lets simulated time pass up to `until` (s since power-on).
    pub fn run_until(&mut self, until: f64) {
        while self.device.time() < until {
            self.control_period();
        }
    }

    /// Lets `seconds` pass.
    pub fn run(&mut self, seconds: f64) {
        self.run_until(self.device.time() + seconds);
    }

    /// Takes bytes from a host. Every request they complete is answered between two control periods; as on a real
    /// link, control goes on while it is on its way.
    pub fn receive(&mut self, bytes: &[u8]) {
        for frame in self.link.take_in(bytes) {
            self.control_period();
            self.control_period();
            self.answer(&frame);
        }
    }

    /// Bytes for the host, as many as fit; returns how many.
    pub fn take_bytes(&mut self, buffer: &mut [u8]) -> usize {
        self.link.take_out(buffer)
    }

    /// Returns true if bytes wait for the host.
    pub fn has_bytes(&self) -> bool {
        !self.link.is_empty()
    }

    /// Forgets bytes that will never be read and stops the stream: the host is gone.
    pub fn hang_up(&mut self) {
        self.packer = Packer::default();
        self.link.clear();
    }

    /// Lets the hardware report a fault at the next sample.
    pub fn inject(&mut self, fault: Fault, axis: Option<u8>, value: f32) {
        self.injected = Some((fault, axis, value));
    }

    /// For how long the host has sent no heartbeat, or how long ago the key that it tells of was seen down, and for how
    /// long that may be before the board acts, s; none while the board would not.
    pub fn host_silence(&self) -> Option<(f64, f64)> {
        let (rules, servo) = (self.service.rules(), &self.machine.servo);
        let host = (rules.host_action != HostAction::Ignore).then(|| (servo.host_silent(), rules.host_seconds));
        let (silent, allowed) = servo.key_age().or(host).filter(|_| self.status().state.drives())?;
        Some((f64::from(silent), f64::from(allowed)))
    }

    /// The faults, to be added or repaired.
    pub fn broken_mut(&mut self) -> &mut Broken {
        &mut self.options.broken
    }

    /// Number of times that the encoders were read: once each carrier period.
    pub fn looks(&self) -> u64 {
        self.looks
    }

    /// The device behind the board.
    pub fn device(&self) -> &SimulatedDevice {
        &self.device
    }
    /// The device behind the board, to put a hand on it or move it.
    pub fn device_mut(&mut self) -> &mut SimulatedDevice {
        &mut self.device
    }
    /// Seconds since power-on.
    pub fn time(&self) -> f64 {
        self.device.time()
    }
    /// The servo's state.
    pub fn status(&self) -> Status {
        self.machine.servo.status()
    }

    fn answer(&mut self, frame: &[u8]) {
        let mut out = [0; MAX_FRAME];
        let (answer, after) = dispatch::answer(&mut self.service, &mut self.machine, frame, &mut out);
        // Rows of the stream so far go out before the answer that ends it.
        if matches!(after, After::Stream(..))
            && let Some(batch) = self.packer.flush()
        {
            self.link.publish::<Telemetry>(batch);
        }
        if let Some(answer) = answer {
            self.link.send(answer);
        }
        match after {
            After::Nothing => {}
            After::Stream(request, axes) => {
                self.packer.start(&request, axes);
                self.dropped = 0;
            }
            // There is no boot loader here to enter: what comes after one is a restart.
            After::BootLoader | After::Restart => self.restart(),
        }
    }

    /// Acts as the reset button does: flash stays, everything else starts again, motors off.
    fn restart(&mut self) {
        self.machine.flash.restart();
        // RAM is not cleared, and motors do not cool by a reset.
        let heat = *self.machine.servo.heat();
        self.machine.servo = Servo::new(self.hardware, Rules::default());
        self.machine.servo.start_heat(heat);
        self.service = Service::new(self.hardware, most(self.hardware, self.device.bus_voltage()));
        self.drive = [MotorInput::Floating; 3];
        self.bridges = false;
        self.packer = Packer::default();
        self.support_anew();
        self.service.boot(&mut self.machine);
    }

    /// Reports a fault from before a reset, as the chip does after a watchdog bite or a panic.
    pub fn note_fault(&mut self, record: FaultRecord) {
        self.service.note_fault(record);
    }
}
