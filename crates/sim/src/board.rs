//! The simulated board: the firmware's control loop, service and protocol around a simulated device.
//!
//! Time is a count of carrier periods, so that a run is the same on every machine. As on the chip, the board samples at
//! every crest, evaluates the controller at every `divider`-th crest, and applies the duties half a carrier period
//! later.

use super::device::{DeviceError, Options, SimulatedDevice, Support};
use super::faults::BoardFaults;
use super::hand::{Hand, HandSettings};
use super::hand_loop::HandLoop;
use super::machine::LocalMachine;
use super::motor::{MotorInput, PowerStage};
use super::port::Port;
use haptic_bridge::board::dispatch::{self, AfterReply};
use haptic_bridge::board::protocol::{FaultSeen, Info, MAX_FRAME, PROTOCOL, Telemetry};
use haptic_bridge::board::service::Service;
use haptic_bridge::board::telemetry::Packer;
use haptic_bridge::control::absolute::frame_of;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::{Counts, Currents};
use haptic_bridge::control::program::Hardware;
use haptic_bridge::control::{ARM_SECONDS, ControlLoop, HostAction, Rules, Status};
use haptic_bridge::drive::brushed::UNKNOWN_INDUCTANCE_SHARE;
use haptic_bridge::drive::motor_stage::MotorDrive;
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, MAX_SENSED};
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, FaultRecord, State};
use haptic_bridge::safety::limits::{Limits, MAX_TIP_FORCE};
use haptic_bridge::safety::refusal::Refusal;
use std::collections::VecDeque;

/// Frequency of the PWM timers, as on the real boards, Hz.
pub const TIMER_HZ: u32 = 168_000_000;

/// The model of the motor drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriveModel {
    /// Duty, bus and winding are simulated, and the current loop has its real performance.
    #[default]
    Electric,
    /// The commanded torque acts without delay, as linear theory and the golden values assume.
    Ideal,
}

/// The options of a simulated board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardOptions {
    /// The device.
    pub device: Options,
    /// The model of the motor drives.
    pub drive: DriveModel,
    /// Time from sampling to the duty in force, in carrier periods, 0 to 1. The real boards have 0.5.
    pub delay: f64,
    /// True if the board requires verified motors, limits, homing and a polarity check, as a real board does. The
    /// encoders then start at zero in any pose of the device; otherwise they start at the joint angles.
    pub strict: bool,
    /// Support by a user from power-on until the motors carry the device (docs/bring-up.md). The user carries the
    /// device's weight during a polarity check, then returns the device and holds it while the torque ramps up after
    /// arming.
    pub support: Support,
    /// Number of motor axes.
    pub axes: usize,
    /// Number of encoder inputs.
    pub encoders: u8,
    /// The faults present at power-on.
    pub faults: BoardFaults,
    /// Size of the send buffer, bytes. A full buffer drops telemetry and counts the dropped rows.
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
            encoders: (MAX_JOINTS + MAX_SENSED) as u8,
            faults: BoardFaults::default(),
            send_buffer: 256 * 1024,
            serial: "SIM0001".into(),
        }
    }
}

/// Speed of the fastest joint while a user returns the device to its power-on pose, rad/s: so fast that the board does
/// not consider the device at rest.
const RETURN_SPEED_RAD_S: f64 = 1.0;

/// Interval at which the service polls the control loop, s.
const POLL_SECONDS: f64 = 0.02;

/// Name of a board with an ideal drive. Predictions of stable gains recognise the drive by this name.
pub const IDEAL_BOARD: &str = "simulated-ideal";

/// Returns the identification of a board with these options.
fn info(options: &BoardOptions) -> Info {
    let board = match options.drive {
        DriveModel::Electric => "simulated",
        DriveModel::Ideal => IDEAL_BOARD,
    };
    // These names are shorter than the limits of the protocol at which `take` cuts.
    Info {
        protocol: PROTOCOL,
        firmware: env!("CARGO_PKG_VERSION").chars().take(16).collect(),
        board: board.chars().take(16).collect(),
        serial: options.serial.chars().take(24).collect(),
    }
}

/// Returns the hard limits of a simulated board with this supply, V. If `hardware` counts as real, the tip force is
/// limited as on a real board.
fn hard_limits(hardware: Hardware, supply: f64) -> Limits {
    let limits = Limits::default();
    // Scales the bus limits with the ratio of this supply to the default supply.
    let share = (supply / PowerStage::default().bus_voltage) as f32;
    let (bus_min, bus_max) = (limits.bus_min * share.min(1.0), limits.bus_max * share.max(1.0));
    let tip_force = if hardware.real { MAX_TIP_FORCE } else { limits.tip_force };
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
    /// Number of encoder readings, one each carrier period.
    readings: u64,
    /// Counts at the last crest.
    last_counts: Counts,
    /// Counts of absolute encoders at the last valleys, the newest last.
    latched: VecDeque<[i32; 3]>,
    /// Counts in the last frames of absolute encoders.
    sent: [i32; 3],
    drive: [MotorInput; 3],
    bridges_on: bool,
    injected_fault: Option<(Fault, Option<u8>, f32)>,
    since_poll: f64,
    packer: Packer,
    dropped_rows: u32,
    link: Port,
    /// Path of the hand while the motors are on.
    hand_loop: Option<HandLoop>,
    /// True if the hand follows the path now.
    follows_loop: bool,
    /// Time at which the motors were armed, s.
    armed_at: Option<f64>,
    /// Pose and time (s) at which the return of the device to its power-on pose began.
    return_from: Option<([f64; 3], f64)>,
}

impl SimulatedBoard {
    /// Creates a board without settings that is wired to the device of `description`.
    pub fn new(description: &Description, options: BoardOptions) -> Result<Self, DeviceError> {
        let device = SimulatedDevice::new(
            description,
            &Options { absolute_encoders: options.device.absolute_encoders || !options.strict, ..options.device },
        )?;
        let bridge = options.device.bridge;
        let wound = description.joints.iter().filter_map(|joint| joint.motor).any(|motor| motor.inductance > 0.0);
        let hardware = Hardware {
            axes: options.axes,
            encoders: options.encoders,
            real: options.strict,
            bus_sensed: true,
            bridge: Bridge {
                carrier_hz: bridge.carrier_hz as f32,
                dead_time: bridge.dead_time as f32,
                // Without inductances the drive is slower, because a board does not know the current's time constant.
                bandwidth_hz: if wound { 1_500.0 } else { 1_500.0 / UNKNOWN_INDUCTANCE_SHARE },
                // An ideal drive has no voltage or winding to compare with a model.
                current_sensed: options.drive == DriveModel::Electric,
                legs: 3,
            },
            timer_hz: TIMER_HZ,
        };
        let last_counts = Counts(device.counts());
        let mut board = Self {
            service: Service::new(hardware, hard_limits(hardware, bridge.bus_voltage)),
            machine: LocalMachine::new(hardware, info(&options), options.delay),
            options: options.clone(),
            device,
            link: Port::new(options.send_buffer),
            hardware,
            countdown: 0,
            readings: 0,
            last_counts,
            latched: VecDeque::new(),
            sent: *last_counts,
            drive: [MotorInput::Floating; 3],
            bridges_on: false,
            injected_fault: None,
            since_poll: 0.0,
            packer: Packer::default(),
            dropped_rows: 0,
            hand_loop: None,
            follows_loop: false,
            armed_at: None,
            return_from: None,
        };
        board.reset_support();
        board.service.boot(&mut board.machine);
        Ok(board)
    }

    /// Loads a device and a scene as the tool does, so that the board is ready to arm.
    pub fn load(&mut self, name: &str, description: &Description, scene: Option<Scene<f32>>) -> Result<(), Refusal> {
        let device = Device::new(name, description).map_err(|_| Refusal::BadDevice)?;
        self.service.set_device(&mut self.machine, device)?;
        match scene {
            Some(scene) => self.service.set_scene(&mut self.machine, scene),
            None => Ok(()),
        }
    }

    /// Advances by one carrier period. Must not be mixed with [`SimulatedBoard::control_period`] within a control
    /// period.
    pub fn carrier(&mut self) {
        self.carrier_period(1);
    }
    /// Returns the carrier frequency, Hz.
    pub fn carrier_hz(&self) -> f64 {
        self.machine.carrier.carrier_hz().into()
    }
    /// Advances by one control period.
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

    /// Advances by `carriers` carrier periods with one sample and one set of duties.
    fn carrier_period(&mut self, carriers: u32) {
        let carrier = 1.0 / f64::from(self.machine.carrier.carrier_hz());
        let period = carrier * f64::from(carriers);
        let flowing = self.device.currents();
        let faults = &self.options.faults;
        let mut currents = Currents::from_fn(|axis| faults.current(&flowing, axis, axis) as f32);
        let mut imbalance = Currents::default();
        for axis in 0..self.device.joints() {
            if let Some(phases) = self.device.phase_currents(faults.motors[axis]) {
                let [first, second] = [0, 1].map(|leg| faults.leg_current(phases, axis, leg) as f32);
                (currents[axis], imbalance[axis]) = (0.5 * (first - second), first + second);
            }
        }
        let bus_voltage = faults.bus_reading.unwrap_or(self.device.bus_voltage()) as f32;
        let due = self.countdown == 0;
        let mut counts = Counts(faults.counts(self.device.counts(), self.readings));
        self.readings += 1;
        let axes = self.machine.control_loop.absolute_axes();
        if axes.contains(&true) {
            self.read_angles(&mut counts, carriers);
        }
        let mut samples = Samples { counts, bus_voltage, currents, imbalance, late: false };
        self.machine.control_loop.read_phases(&mut samples);
        self.guard_skipped_crests(&samples, carriers);
        if due {
            self.countdown = self.machine.carrier.divider.into();
            let index = self.device.index();
            let marks = core::array::from_fn(|axis| index[axis].then_some(counts[axis]));
            if index.contains(&true) {
                self.machine.control_loop.mark(marks);
            }
            if let Some((fault, axis, value)) = self.injected_fault.take() {
                self.machine.control_loop.trip(fault, axis, value);
            }
        }
        let (outputs, duties) = self.machine.control_loop.crest(&samples, &samples.currents, due);
        self.bridges_on = outputs.bridges;
        if due {
            self.update_hand();
            self.support();
        }
        self.countdown = self.countdown.saturating_sub(carriers);
        for _ in 0..carriers {
            self.bridges_on &= self.machine.control_loop.check_slow_faults(&samples).bridges;
        }
        if due {
            self.record();
        }
        let torques = self.machine.control_loop.frame().motors.torque;
        let mut next = [MotorInput::Floating; 3];
        for (axis, input) in next.iter_mut().enumerate() {
            *input = match (self.bridges_on, self.options.drive) {
                (false, _) => MotorInput::Floating,
                (true, DriveModel::Electric) => match duties[axis] {
                    MotorDrive::Bridge(duty) => MotorInput::Duty(f32::from(duty).into()),
                    MotorDrive::ThreePhase { legs, .. } => MotorInput::Legs(legs.map(f64::from)),
                },
                (true, DriveModel::Ideal) => MotorInput::Torque(f64::from(torques[axis])),
            };
        }
        let delay = (carrier * self.options.delay).min(period);
        if delay > 0.0 {
            self.device.step(&self.drive, delay);
        }
        self.drive = self.options.faults.drives(next);
        // Absolute encoders latch their angles half a carrier period before the crest.
        let mut valley = delay;
        if axes.contains(&true) {
            valley = (period - 0.5 * carrier).max(delay);
            // Equal up to a rounding error if every crest has a control step.
            if valley > 1.001 * delay {
                self.device.step(&self.drive, valley - delay);
            }
            self.latch_angles(period);
        }
        if period > valley {
            self.device.step(&self.drive, period - valley);
        }
        self.since_poll += period;
        if self.since_poll >= POLL_SECONDS {
            self.since_poll = 0.0;
            self.poll();
        }
    }

    /// Records the counts of the device, and drops those that no frame sends any more.
    fn latch_angles(&mut self, period: f64) {
        let lag = self.service.device().map_or(0.0, |device| {
            device
                .joints
                .iter()
                .filter_map(|joint| joint.absolute)
                .fold(0.0, |lag: f64, sensor| lag.max(sensor.chip.delay()))
        });
        self.latched.push_back(self.device.counts());
        while self.latched.len() > 1 + (lag / period).round() as usize {
            self.latched.pop_front();
        }
    }

    /// Replaces the counts of absolute encoders by those in their frames of `carriers` carrier periods.
    fn read_angles(&mut self, counts: &mut Counts, carriers: u32) {
        let oldest = self.latched.front().copied().unwrap_or(**counts);
        let oldest = self.options.faults.counts(oldest, self.readings);
        for nth in 1..=carriers {
            let frames = core::array::from_fn(|axis| {
                let moved =
                    i64::from(oldest[axis].wrapping_sub(self.sent[axis])) * i64::from(nth) / i64::from(carriers);
                let frame = frame_of(self.sent[axis].wrapping_add(moved as i32));
                Some(self.options.faults.frame(axis, frame, self.readings))
            });
            self.machine.control_loop.read_angles(&frames, counts);
        }
        self.sent = oldest;
    }

    /// Puts a hand on the tip, which starts to follow `hand_loop` when the motors are armed. While the motors are off,
    /// the hand waits outside the walls, because a board does not arm with the tip inside a wall.
    pub fn set_hand_loop(&mut self, settings: HandSettings, hand_loop: HandLoop) {
        let hand = Hand::new(settings, hand_loop.wait(), self.device.tip(), self.device.time());
        self.device.set_hand(hand);
        (self.hand_loop, self.follows_loop) = (Some(hand_loop), false);
    }

    fn update_hand(&mut self) {
        let armed = self.machine.control_loop.frame().state == State::Armed;
        if let Some(hand_loop) = &self.hand_loop
            && armed != self.follows_loop
        {
            self.follows_loop = armed;
            let now = self.device.time();
            self.device.hand_mut().set_intent(if armed { hand_loop.intent() } else { hand_loop.wait() }, now);
        }
    }

    /// Resets the support of the device to the support at power-on. A held device returns to its power-on pose.
    fn reset_support(&mut self) {
        let support = self.options.support;
        if support == Support::Held {
            self.device.place(self.device.start());
            self.last_counts = Counts(self.device.counts());
        }
        self.return_from = None;
        self.device.set_support(support);
    }

    /// Updates the user's support of the device for the state of the board.
    fn support(&mut self) {
        let now = self.device.support();
        let state = self.machine.control_loop.frame().state;
        let time = self.device.time();
        self.armed_at = (state == State::Armed).then(|| self.armed_at.unwrap_or(time));
        let ramped = self.armed_at.is_some_and(|armed_at| time >= armed_at + f64::from(ARM_SECONDS));
        // If no homing is required, the user holds and returns the device also after motions with the motors on.
        let stays = self.options.support == Support::Held && !self.options.strict;
        let required = match (now, state) {
            (Support::None, _) if !stays => Support::None,
            (_, State::Armed) if ramped => Support::None,
            (_, State::Armed) => Support::Held,
            (_, State::CheckingPolarity | State::Homing) => Support::Carried,
            (_, State::Disarmed | State::Fault) => self.options.support,
        };
        if required != now {
            self.device.set_support(required);
        }
        let off = !state.drives();
        if (now == Support::Carried || stays && now == Support::None) && required == Support::Held && off {
            // Starts the return of the device, because homing would declare the present pose to be home.
            self.return_from = Some((self.device.q(), time));
        }
        self.return_from = self.return_from.filter(|_| off);
        if let Some((from, since)) = self.return_from {
            let to = self.device.start();
            let distance: [f64; 3] = core::array::from_fn(|i| to[i] - from[i]);
            let longest = distance.iter().fold(0.0_f64, |longest, distance| longest.max(distance.abs()));
            let share = (time - since) * RETURN_SPEED_RAD_S / longest.max(1e-9);
            if share < 1.0 {
                self.device.place(core::array::from_fn(|i| from[i] + share * distance[i]));
            } else {
                self.device.place(to);
                self.return_from = None;
            }
        }
    }

    /// Passes samples at all but the last crest of `carriers` periods to the guard, with interpolated encoder counts.
    fn guard_skipped_crests(&mut self, samples: &Samples, carriers: u32) {
        let moved: [i64; 3] =
            core::array::from_fn(|axis| i64::from(samples.counts[axis].wrapping_sub(self.last_counts[axis])));
        for nth in 1..carriers {
            let counts = Counts::from_fn(|axis| {
                self.last_counts[axis].wrapping_add((moved[axis] * i64::from(nth) / i64::from(carriers)) as i32)
            });
            self.machine.control_loop.guard(&Samples { counts, ..*samples });
        }
        self.last_counts = samples.counts;
    }

    /// Adds a row of this step to the stream. As on the chip, a full send buffer drops the row before it is packed, so
    /// that every numbered batch is sent.
    fn record(&mut self) {
        self.machine.control_loop.sense(&self.device.inputs());
        let frame = self.machine.control_loop.frame();
        if !self.packer.wants(frame.step) {
            return;
        }
        if !self.link.has_room() {
            self.dropped_rows = self.dropped_rows.wrapping_add(1);
        } else if let Some(batch) = self.packer.push(&frame, self.dropped_rows) {
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

    /// Advances until the time `until` since power-on, s.
    pub fn run_until(&mut self, until: f64) {
        while self.device.time() < until {
            self.control_period();
        }
    }

    /// Advances by `seconds`.
    pub fn run(&mut self, seconds: f64) {
        self.run_until(self.device.time() + seconds);
    }
    /// Receives bytes from a host. Carries out every completed request after two control periods, because control
    /// continues while a request is on its way.
    pub fn receive(&mut self, bytes: &[u8]) {
        for frame in self.link.take_in(bytes) {
            self.control_period();
            self.control_period();
            self.reply(&frame);
        }
    }

    /// Moves bytes for the host to `buffer` and returns their number.
    pub fn take_bytes(&mut self, buffer: &mut [u8]) -> usize {
        self.link.take_out(buffer)
    }
    /// Returns true if bytes wait for the host.
    pub fn has_bytes(&self) -> bool {
        !self.link.is_empty()
    }
    /// Disconnects the host: drops all bytes on the link and stops the stream.
    pub fn hang_up(&mut self) {
        self.packer = Packer::default();
        self.link.clear();
    }
    /// Injects a fault of the hardware, which the next control step reports.
    pub fn inject(&mut self, fault: Fault, axis: Option<u8>, value: f32) {
        self.injected_fault = Some((fault, axis, value));
    }
    /// Returns the time since the host's last heartbeat, or since a dead man's key was last seen down, and the time
    /// after which the board acts, s. Returns `None` while the board would not act.
    pub fn host_silence(&self) -> Option<(f64, f64)> {
        let (rules, control_loop) = (self.service.rules(), &self.machine.control_loop);
        let host = (rules.host_action != HostAction::Ignore).then(|| (control_loop.host_silence(), rules.host_seconds));
        let (silent, allowed) = control_loop.key_age().or(host).filter(|_| self.status().state.drives())?;
        Some((f64::from(silent), f64::from(allowed)))
    }

    /// Returns the injected faults of the board, to change them.
    pub fn faults_mut(&mut self) -> &mut BoardFaults {
        &mut self.options.faults
    }
    /// Returns the number of encoder readings.
    pub fn readings(&self) -> u64 {
        self.readings
    }
    /// Returns the device.
    pub fn device(&self) -> &SimulatedDevice {
        &self.device
    }
    /// Returns the device, to put a hand on it or move it.
    pub fn device_mut(&mut self) -> &mut SimulatedDevice {
        &mut self.device
    }
    /// Returns the time since power-on, s.
    pub fn time(&self) -> f64 {
        self.device.time()
    }
    /// Returns the control loop's state.
    pub fn status(&self) -> Status {
        self.machine.control_loop.status()
    }
    fn reply(&mut self, frame: &[u8]) {
        let mut out = [0; MAX_FRAME];
        let (reply, after) = dispatch::answer(&mut self.service, &mut self.machine, frame, &mut out);
        // Sends the last rows of the present stream before the reply that ends the stream.
        if matches!(after, AfterReply::Stream(..))
            && let Some(batch) = self.packer.flush()
        {
            self.link.publish::<Telemetry>(batch);
        }
        if let Some(reply) = reply {
            self.link.send(reply);
        }
        match after {
            AfterReply::Nothing => {}
            AfterReply::Stream(request, shape) => {
                self.packer.start(&request, shape);
                self.dropped_rows = 0;
            }
            // There is no boot loader to enter; a real boot loader would end with a restart.
            AfterReply::BootLoader | AfterReply::Restart => self.restart(),
        }
    }

    /// Resets the board: flash and the motors' temperatures stay, all other state starts again with the motors off.
    fn restart(&mut self) {
        self.machine.flash.restart();
        let heat = *self.machine.control_loop.heat();
        self.machine.control_loop = ControlLoop::new(self.hardware, Rules::default());
        self.machine.control_loop.start_heat(heat);
        self.service = Service::new(self.hardware, hard_limits(self.hardware, self.device.bus_voltage()));
        self.drive = [MotorInput::Floating; 3];
        self.bridges_on = false;
        self.packer = Packer::default();
        self.reset_support();
        self.service.boot(&mut self.machine);
    }

    /// Reports a fault from before a reset, as the chip does after a watchdog bite or a panic.
    pub fn record_fault(&mut self, record: FaultRecord) {
        self.service.record_fault(record);
    }
}
