//! A board made of the control loop, the service and the dispatcher, with one call per control step. Requests and
//! replies are frames. After every step and every request the board asserts the safety invariants.
#![allow(dead_code, reason = "the library's tests, the tool's tests and the fuzzer each use a part")]

use haptic_bridge::board::dispatch::{self, AfterReply, Described};
use haptic_bridge::board::machine::{Machine, Measurements};
use haptic_bridge::board::protocol::{ForceAnswer, ForceRequest, Info, MAX_FRAME, PROTOCOL};
use haptic_bridge::board::service::Service;
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::board::telemetry::Packer;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Command, ControlLoop, HostAction, Reply, Rules, Status};
use haptic_bridge::drive::motor_stage::MotorStage;
use haptic_bridge::drive::stage::{Bridge, MAX_DUTY, Stage as _};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::safety::refusal::Refusal;
use postcard_rpc::Endpoint;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use postcard_rpc::standard_icd::{ERROR_KEY, WireError};
use serde::{Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;

#[derive(Default)]
pub struct Flash {
    /// Committed settings, which the next start reads.
    pub committed: BTreeMap<u8, Entry>,
    pub fails: bool,
    staged: BTreeMap<u8, Entry>,
}

/// The service's machine: the control loop, and settings in memory. Panics if the service writes flash or sets the
/// timer while the motors are on.
pub struct RigMachine {
    pub control_loop: ControlLoop<Box<Program<BoardMath>>>,
    pub flash: Flash,
}

impl RigMachine {
    fn check_writable(&self) -> Result<(), Refusal> {
        assert!(!self.control_loop.status().state.drives(), "flash is written while the motors are on");
        if self.flash.fails { Err(Refusal::Flash) } else { Ok(()) }
    }
}

impl Machine for RigMachine {
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
    fn retime(&mut self, _rate_hz: f32) {
        assert!(!self.control_loop.status().state.drives(), "the timer is set while the motors are on");
    }
    fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal> {
        self.check_writable()?;
        self.flash.staged.insert(key as u8, Entry::from_slice(entry).map_err(|_| Refusal::Flash)?);
        Ok(())
    }
    fn staged(&mut self, key: Key) -> Option<Entry> {
        self.flash.staged.get(&(key as u8)).cloned()
    }
    fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal> {
        self.check_writable()?;
        let mut staged = core::mem::take(&mut self.flash.staged);
        let entries: Option<Vec<_>> = keys.iter().map(|key| staged.remove_entry(&(*key as u8))).collect();
        self.flash.committed.extend(entries.ok_or(Refusal::Flash)?);
        Ok(())
    }
    fn load(&mut self, key: Key) -> Option<Entry> {
        self.flash.committed.get(&(key as u8)).cloned()
    }
}

impl Described for RigMachine {
    fn info(&self) -> Info {
        Info {
            protocol: PROTOCOL,
            firmware: "0.0.0".chars().collect(),
            board: "bench".chars().collect(),
            serial: "B1".chars().collect(),
        }
    }
    fn measurements(&mut self) -> Measurements {
        Measurements::default()
    }
}

/// Returns true if any protection is weaker in `now` than in `before`.
fn is_looser(now: &Rules, before: &Rules) -> bool {
    let higher = |now: &[f32; MAX_JOINTS], before: &[f32; MAX_JOINTS]| now.iter().zip(before).any(|(a, b)| a > b);
    let (limits, old) = (&now.limits, &before.limits);
    let watch = |rules: &Rules| match rules.host_action {
        HostAction::Ignore => (0, f32::INFINITY),
        HostAction::Hold => (1, rules.host_seconds),
        HostAction::Disarm => (2, rules.host_seconds),
    };
    let (watched, watched_before) = (watch(now), watch(before));
    higher(&limits.torque, &old.torque)
        || higher(&limits.current, &old.current)
        || higher(&limits.continuous_current, &old.continuous_current)
        || higher(&limits.speed, &old.speed)
        || limits.power > old.power
        || limits.tip_force > old.tip_force
        || limits.bus_min < old.bus_min
        || limits.bus_max > old.bus_max
        || watched.0 < watched_before.0
        || watched.1 > watched_before.1
        || (before.passivity && !now.passivity)
        || now.index_period.iter().zip(&before.index_period).any(|(now, before)| *before != 0 && now != before)
}

pub struct Board {
    pub machine: RigMachine,
    pub service: Service,
    pub samples: Samples,
    /// Index pulses that arrive before the next control step.
    pub marks: Option<[Option<i32>; MAX_JOINTS]>,
    /// Fault that the firmware reports at the next control step.
    pub reported_fault: Option<(Fault, Option<u8>, f32)>,
    pub bridges: bool,
    pub duties: [f32; MAX_JOINTS],
    pub packer: Packer,
    hardware: Hardware,
    board_limits: Limits,
    /// State of [`Board::renders_forces_only`].
    forces_only: bool,
}

impl Board {
    /// Creates a board without settings. Motors that are `real` are armed under all conditions of a real device.
    pub fn new(real: bool) -> Self {
        Self::with_flash(real, BTreeMap::new())
    }

    /// Creates a board that boots from these settings.
    pub fn with_flash(real: bool, flash: BTreeMap<u8, Entry>) -> Self {
        let bridge =
            Bridge { carrier_hz: 20_000.0, dead_time: 200e-9, bandwidth_hz: 1_000.0, current_sensed: true, legs: 2 };
        let hardware =
            Hardware { axes: MAX_JOINTS, encoders: 3, real, bus_sensed: true, bridge, timer_hz: 168_000_000 };
        let board_limits = Limits::default();
        let mut board = Self {
            machine: RigMachine {
                control_loop: ControlLoop::new(hardware, Rules::default()),
                flash: Flash { committed: flash, ..Flash::default() },
            },
            service: Service::new(hardware, board_limits),
            samples: Samples { bus_voltage: 24.0, ..Samples::default() },
            marks: None,
            reported_fault: None,
            bridges: false,
            duties: [0.0; MAX_JOINTS],
            packer: Packer::default(),
            hardware,
            board_limits,
            forces_only: false,
        };
        board.service.boot(&mut board.machine);
        board.tick();
        board
    }

    /// Creates a board with a device and a scene, not armed.
    pub fn with_device(real: bool, device: &Device<f32>, scene: &Scene<f32>) -> Self {
        let mut board = Self::new(real);
        board.service.set_device(&mut board.machine, device.clone()).expect("a device that fits");
        board.service.set_scene(&mut board.machine, scene.clone()).expect("a scene that fits");
        (0..20).for_each(|_| board.tick());
        board
    }

    pub fn state(&self) -> State {
        self.machine.control_loop.status().state
    }

    pub fn tick(&mut self) {
        let samples = self.measured_samples();
        if let Some((fault, axis, value)) = self.reported_fault.take() {
            self.machine.control_loop.trip(fault, axis, value);
        }
        if let Some(marks) = self.marks.take() {
            self.machine.control_loop.mark(marks);
        }
        let (outputs, duties) = self.machine.control_loop.crest(&samples, &samples.currents, true);
        (self.bridges, self.duties) = (outputs.bridges, duties.map(MotorStage::duty));
        assert!(!self.bridges || self.state().drives(), "bridges drive while {:?}", self.state());
        let frame = self.machine.control_loop.frame();
        if self.packer.wants(frame.step) {
            let _ = self.packer.push(&frame, 0);
        }
        self.check_invariants();
        self.check_slow_faults(&samples);
        // The torques are checked here and not after a request, because a lowered limit acts at the next control step.
        let (torque, limits) = (frame.motors.torque, self.service.rules().limits);
        let within = torque.iter().zip(&limits.torque).all(|(torque, limit)| torque.abs() <= limit * 1.000_01);
        assert!(within, "torque {torque:?} above {limits:?}");
        if self.renders_forces_only() {
            let mechanism = self.service.device().map(|device| device.mechanism);
            let force = mechanism.map_or(0.0, |it| it.leverage::<BoardMath>(&frame.at.q).force_squared(&torque).sqrt());
            // In a stretched pose only rounding error is left of the force.
            let rounding = 1.0e-3 * limits.tip_force + 1.0e-3;
            assert!(force <= limits.tip_force + rounding, "{force} N at the tip, {torque:?} N m, above {limits:?}");
        }
    }

    /// Returns true if all torques since arming come from rendered forces, without weight or feed-forward.
    fn renders_forces_only(&mut self) -> bool {
        let (device, scene) = (self.service.device(), self.service.scene());
        let forces_only = device.is_some_and(|device| !device.weight)
            && scene.is_some_and(|scene| {
                let mut walls = scene.walls.iter();
                walls.all(|wall| wall.feed_forward == FeedForward::Off && !wall.damping_compensation)
            });
        self.forces_only = forces_only && (self.forces_only || self.state() != State::Armed);
        self.forces_only && self.state() == State::Armed
    }

    /// Returns samples in which every current is the commanded current plus the sensor's offset.
    fn measured_samples(&self) -> Samples {
        let mut samples = self.samples;
        let torque = self.machine.control_loop.frame().motors.torque;
        for (axis, joint) in self.service.device().iter().flat_map(|device| &device.joints).enumerate() {
            if let Some(motor) = joint.motor.filter(|motor| motor.torque_constant != 0.0) {
                samples.currents[axis] += torque[axis] / motor.torque_constant;
            }
        }
        samples
    }

    /// Runs the valley after a crest. A fault found at the valley turns the bridges off, whatever the duties are.
    fn check_slow_faults(&mut self, samples: &Samples) {
        self.bridges &= self.machine.control_loop.check_slow_faults(samples).bridges;
        assert!(!self.bridges || self.state().drives(), "bridges drive while {:?}", self.state());
    }

    /// Asserts the conditions that hold after every control step and every request.
    pub fn check_invariants(&self) {
        let state = self.state();
        let limits = self.service.rules().limits;
        assert!(limits.is_within(&self.board_limits), "limits above the board's own: {limits:?}");
        let duties = self.duties;
        assert!(duties.iter().all(|duty| duty.abs() <= MAX_DUTY), "{duties:?} with {:?}", self.samples);
        if !state.drives() {
            let torque = self.machine.control_loop.frame().motors.torque;
            assert_eq!(duties, [0.0; MAX_JOINTS], "duty while {state:?}");
            assert_eq!(*torque, [0.0; MAX_JOINTS], "torque while {state:?}");
        }
        if state == State::Fault {
            assert!(self.machine.control_loop.status().fault.is_some(), "a fault has a cause");
        }
    }

    /// Replies to a frame decoded from COBS, and carries out the action that the request leaves to the firmware.
    pub fn answer(&mut self, frame: &[u8]) -> Option<Vec<u8>> {
        let mut out = [0; MAX_FRAME];
        let before = (self.state(), *self.service.rules());
        let (answer, after) = dispatch::answer(&mut self.service, &mut self.machine, frame, &mut out);
        let answer = answer.map(<[u8]>::to_vec);
        if before.0.drives() && self.state().drives() {
            let now = self.service.rules();
            assert!(!is_looser(now, &before.1), "rules loosened while the motors are on: {:?} to {now:?}", before.1);
        }
        let samples = self.measured_samples();
        self.duties =
            self.machine.control_loop.duties(samples.bus_voltage, &samples.currents, false).map(MotorStage::duty);
        self.check_invariants();
        self.check_slow_faults(&samples);
        match after {
            AfterReply::Nothing => {}
            AfterReply::Stream(request, shape) => self.packer.start(&request, shape),
            AfterReply::BootLoader | AfterReply::Restart => {
                assert!(!self.state().drives(), "the board restarts with its motors on");
                *self = Self::with_flash(self.hardware.real, core::mem::take(&mut self.machine.flash.committed));
            }
        }
        answer
    }

    /// Sends one request of the protocol. Returns the reply or the dispatcher's error.
    pub fn ask<E: Endpoint>(&mut self, request: &E::Request) -> Result<E::Response, WireError>
    where
        E::Request: Serialize + Sized,
        E::Response: DeserializeOwned,
    {
        let body = postcard::to_stdvec(request).expect("a request has bytes");
        let answer = self.answer(&frame(E::REQ_KEY, &body)).expect("every request has a reply");
        let (header, body) = VarHeader::take_from_slice(&answer).expect("a reply has a header");
        if header.key == VarKey::Key8(ERROR_KEY) {
            return Err(postcard::from_bytes(body).expect("a readable error"));
        }
        assert_eq!(header.key, VarKey::Key8(E::RESP_KEY));
        Ok(postcard::from_bytes(body).expect("a readable reply"))
    }
}

/// Returns a frame with this key and body, before COBS encoding.
pub fn frame(key: postcard_rpc::Key, body: &[u8]) -> Vec<u8> {
    let header = VarHeader { key: VarKey::Key8(key), seq_no: VarSeq::Seq2(7) };
    let mut head = [0; 16];
    let used = header.write_to_slice(&mut head).map_or(0, |(used, _)| used.len());
    [&head[..used], body].concat()
}
