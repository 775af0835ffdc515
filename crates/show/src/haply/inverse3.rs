//! A board as a Haply device: the contents of its frames, and the effect of programs' requests.

use super::request::{Basis, ProgramRequest};
use haptic_bridge::board::protocol::{ForceAnswer, ForceDone, ForceRequest};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{CLEARING, Fault, FaultRecord, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::frame::{Axes, rotation};
use haptic_host::link::{Board, BoardError, LinkError, Session};
use haptic_host::words::{commands_to_calls, fault_and_remedy};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// Id of the grip that programs expect; its buttons are never pressed.
const GRIP_ID: &str = "HB00";
/// `device_type` of an Inverse3 in Haply's service.
const DEVICE_TYPE: u32 = 4;
/// Maximum simulated time to catch up in one call.
const MAX_CATCH_UP: Duration = Duration::from_millis(100);
/// Commands in remedies for people, each with the request that a program sends instead.
const COMMAND_REPLACEMENTS: [(&str, &str); 1] = [(CLEARING, "`clear_fault`")];

/// A board that appears to programs as a Haply device.
pub struct Inverse3 {
    session: Session,
    axes: Axes,
    id: String,
    simulated: bool,
    polled: Instant,
    last: ForceAnswer,
    /// True if `last` is the reply to the latest request.
    is_answered: bool,
    /// The latched fault; `None` without one.
    fault: Option<FaultRecord>,
    /// True if the board is homed and its motors' polarity is known, or if it needs neither.
    calibrated: bool,
    /// Reason for which the board refused to turn the motors on for this program.
    refusal: Option<String>,
    /// Control step from which a force may arm again after a fault was cleared.
    arms_from: Option<u32>,
    armed: bool,
    /// True if the next force arms: only a program's first, because later the motors went off on purpose.
    may_arm: bool,
    /// Axes of the connected program.
    basis: Basis,
    /// Number of programs that have used the device.
    sessions: u32,
    notices: Vec<String>,
}

impl Inverse3 {
    /// Creates the device for a board with a device, and gives it free space if it has no scene. `axes` are CHAI3D's
    /// ([`Axes::of`]).
    pub fn new(mut session: Session, axes: Option<Axes>, simulated: bool) -> Result<Self, BoardError> {
        let device = session.device()?.ok_or(Refusal::NoDevice)?;
        let task = device.mechanism.kind().spec().task;
        if session.scene()?.is_none() {
            session.set_scene(&Scene { task: task as u8, ..Scene::default() })?;
        }
        let axes = axes.unwrap_or_else(|| Axes::of(device.mechanism.kind(), device.weight));
        let id = session.info().serial.to_string();
        let last = session.read_state()?;
        let mut device = Self {
            fault: session.fault(),
            session,
            axes,
            id,
            simulated,
            polled: Instant::now(),
            last,
            is_answered: true,
            calibrated: false,
            refusal: None,
            arms_from: None,
            armed: false,
            may_arm: true,
            basis: Basis::default(),
            sessions: 0,
            notices: Vec::new(),
        };
        device.read_calibration()?;
        Ok(device)
    }

    /// Returns the device's id in messages: the board's serial number.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Prints a notice for the operator of the server, each text once.
    pub(super) fn notify(&mut self, words: String) {
        if !self.notices.contains(&words) {
            haptic_host::tell!("{words}");
            self.notices.push(words);
        }
    }

    pub(super) fn begin_session(&mut self) {
        self.sessions += 1;
    }

    /// Returns the time since the last poll of the board; zero for a simulated board, which does not time out programs.
    pub(super) fn idle_time(&self) -> Duration {
        if self.simulated { Duration::ZERO } else { self.polled.elapsed() }
    }

    fn read_calibration(&mut self) -> Result<(), LinkError> {
        let status = self.session.status()?;
        self.calibrated = status.homed && status.polarity || !self.session.details()?.real;
        Ok(())
    }

    /// Turns the motors off and resets the state of the program.
    pub(super) fn release(&mut self) {
        (self.armed, self.may_arm, self.basis, self.refusal) = (false, true, Basis::default(), None);
        self.notices.clear();
        let _ = self.session.disarm();
    }

    /// Carries out a message and reads the device's state. A missing reply is reported, and the session continues.
    /// Returns an error only if the board is lost.
    pub(super) fn execute(&mut self, request: &ProgramRequest) -> Result<(), BoardError> {
        for other in &request.others {
            self.notify(format!("`{other}` is ignored: a board accepts forces at the tip, and a basis for them"));
        }
        if request.for_other_device {
            self.notify(format!("messages for a `device_id` other than {} are ignored", self.id));
        }
        self.basis = request.basis.unwrap_or(self.basis);
        let result = self.exchange(request);
        self.report_failure(result)
    }

    /// Reads the state for a client that does not use the device, without counting it as activity of the user.
    pub(super) fn poll(&mut self) -> Result<(), BoardError> {
        let read = |device: &mut Self| {
            device.catch_up()?;
            device.last = Board::force(&mut device.session, &ForceRequest::default())?;
            device.fault = match (device.last.state, device.fault) {
                (State::Fault, None) => device.session.status()?.fault,
                (State::Fault, known) => known,
                _ => None,
            };
            Ok(device.read_calibration()?)
        };
        let result = read(self);
        self.report_failure(result)
    }

    fn report_failure(&mut self, result: Result<(), BoardError>) -> Result<(), BoardError> {
        self.is_answered = result.is_ok();
        match result {
            Err(BoardError::Link(lost @ (LinkError::Unanswered { .. } | LinkError::Silent { .. }))) => {
                self.notify(lost.to_string());
                Ok(())
            }
            Err(BoardError::Refused(refusal)) => {
                self.notify(format!("the board refuses: {refusal}"));
                Ok(())
            }
            result => result,
        }
    }

    /// Lets simulated time catch up with real time, because a simulated board runs only while a request waits.
    fn catch_up(&mut self) -> Result<(), LinkError> {
        if self.simulated {
            self.session.rows(self.polled.elapsed().min(MAX_CATCH_UP))?;
        }
        self.polled = Instant::now();
        Ok(())
    }

    fn exchange(&mut self, request: &ProgramRequest) -> Result<(), BoardError> {
        self.catch_up()?;
        if request.clear_fault {
            self.clear()?;
        }
        self.last = match request.force {
            None => self.session.read_state()?,
            Some(force) => {
                if !self.armed && self.may_arm && !request.clear_fault {
                    self.arm()?;
                }
                let [right, away, up] = self.basis.to_haply(force);
                let force = self.axes.to_task([-away, right, up]);
                self.session.force(force.map(|newtons| newtons as f32))?
            }
        };
        if let ForceDone::Bad(_) = self.last.done {
            let [x, y, z] = request.force.unwrap_or_default();
            self.notify(format!("a force of ({x:e}, {y:e}, {z:e}) N is {}", self.last.done));
        }
        let before = self.fault;
        self.check_motors();
        if request.full || before != self.fault {
            self.read_calibration()?;
        }
        Ok(())
    }

    /// Reports the reason if the motors went off while the program had them on.
    fn check_motors(&mut self) {
        self.fault = self.session.fault();
        if self.armed && self.last.state != State::Armed {
            self.armed = false;
            let why = self.fault.map_or_else(|| "another tool turned them off".into(), |fault| describe_fault(&fault));
            let reconnect = self.fault.is_none_or(|fault| fault.fault == Fault::HostLost);
            let action = if reconnect { "connects again" } else { "clears the fault" };
            self.notify(format!("the motors are off: {why}; a program that {action} arms them"));
        }
    }

    /// Clears the latched fault. A force arms at the earliest 1 s later, so that a person notices the fault.
    fn clear(&mut self) -> Result<(), BoardError> {
        self.last = self.session.read_state()?;
        self.check_motors();
        let rate = self.session.scene()?.map_or(0.0, |scene| scene.rate_hz);
        self.session.clear()?;
        self.arms_from = Some(self.last.step.wrapping_add(rate as u32));
        (self.fault, self.refusal, self.may_arm) = (None, None, true);
        self.notify("the fault is cleared: a force arms after one second".into());
        Ok(())
    }

    fn arm(&mut self) -> Result<(), BoardError> {
        // The counter wraps around: the sign of the difference tells which step is later.
        if self.arms_from.is_some_and(|from| (self.last.step.wrapping_sub(from) as i32) < 0) {
            return Ok(());
        }
        self.arms_from = None;
        // A new program clears a HostLost fault, which an earlier program caused; any other fault needs a person.
        if self.fault.is_some_and(|fault| fault.fault == Fault::HostLost) {
            self.session.clear()?;
            self.fault = None;
        }
        match self.session.arm() {
            Ok(()) => (self.armed, self.may_arm, self.refusal) = (true, false, None),
            Err(BoardError::Refused(refusal)) => {
                let refusal = commands_to_calls(&refusal.to_string(), &COMMAND_REPLACEMENTS);
                self.notify(format!("the motors stay off: {refusal}"));
                self.refusal = Some(refusal);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Returns a frame; `full` adds the constant data.
    pub(super) fn frame(&self, full: bool) -> Value {
        let vector = |task: [f32; 3]| {
            let [toward, right, up] = self.axes.to_chai3d(task.map(f64::from));
            let [x, y, z] = self.basis.to_program([right, -toward, up]);
            json!({"x": x, "y": y, "z": z})
        };
        let each = |[a0, a1, a2]: [f64; 3]| json!({"a0": a0, "a1": a1, "a2": a2});
        let degrees = |radians: [f32; 3]| each(radians.map(|angle| f64::from(angle).to_degrees()));
        // The grip's rotation in the program's axes.
        let columns = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let axes = Matrix3::from_columns(&columns.map(|axis| Vector3::from(self.basis.to_program(axis))));
        let axes = axes * self.axes.matrix();
        let turned = Rotation3::from_matrix_unchecked(axes * rotation(&self.last.sensed) * axes.transpose());
        let grip_orientation = UnitQuaternion::from_rotation_matrix(&turned);
        let upright = json!({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0});
        let zero = json!({"x": 0.0, "y": 0.0, "z": 0.0});
        let origin = json!({"position": zero, "rotation": upright, "scale": {"x": 1.0, "y": 1.0, "z": 1.0}});
        let armed = self.last.state == State::Armed;
        let mode = if armed { "force" } else { "idle" };
        let mut device = json!({
            "device_id": self.id,
            "state": {
                "cursor_position": vector(self.last.tip),
                "cursor_velocity": vector(self.last.velocity),
                "angular_position": degrees(self.last.q),
                "angular_velocity": degrees(self.last.qd),
                "body_orientation": upright,
                "current_cursor_force": vector(self.last.force),
                "current_cursor_position": vector(self.last.tip),
                "current_angular_torques": each(self.last.torque.map(f64::from)),
                "current_angular_position": degrees(self.last.q),
                "mode": mode,
                "control_domain": "cartesian",
                "control_mode": mode,
                "transform": origin,
            },
            "status": {
                "calibrated": self.calibrated,
                "in_use": armed,
                "power_supply": true,
                "ready": self.is_answered && self.fault.is_none() && self.calibrated && self.refusal.is_none(),
                "started": armed,
            },
        });
        if let Some(FaultRecord { fault, axis, value, .. }) = self.fault {
            device["fault"] = json!({
                "code": fault.code(), "name": fault.name(), "what": fault.what(), "joint": axis, "value": value,
                "remedy": commands_to_calls(fault.remedy(), &COMMAND_REPLACEMENTS),
            });
        }
        if let Some(refusal) = &self.refusal {
            device["refusal"] = json!(refusal);
        }
        let mut grip = json!({
            "device_id": GRIP_ID,
            "state": {
                "battery_level": 1.0,
                "battery_voltage": 3.7,
                "buttons": {"a": false, "b": false, "c": false},
                "hall": 0,
                "orientation": {
                    "w": grip_orientation.w, "x": grip_orientation.i, "y": grip_orientation.j, "z": grip_orientation.k,
                },
            },
            "status": {"ready": true, "connected": true, "awake": true},
        });
        if full {
            let basis = json!({"permutation": self.basis.to_string()});
            device["config"] = json!({
                "id": self.id,
                "type": "inverse3",
                "device_info": {
                    "id": self.id, "major_version": 0, "minor_version": 1, "device_type": DEVICE_TYPE, "uuid": self.id,
                },
                "port": self.session.port(),
                "extended_device_id": self.id,
                "extended_firmware_version": self.session.info().firmware.as_str(),
                "gravity_compensation": {"enabled": true, "scaling_factor": 1.0},
                "handedness": "right",
                "torque_scaling": {"enabled": false},
                "home_return": {"enabled": false},
                "preset": "defaults",
                "coordinate_origin": "device_base",
                "basis": basis,
                "mount": origin,
                "filters": {"force_gate": {"gain": 0.0}, "damping": {"scalar": 0.0}},
                "streaming_mode": "USB",
            });
            grip["config"] = json!({
                "id": GRIP_ID,
                "type": "wireless_verse_grip",
                "port": "",
                "major_version": 0,
                "minor_version": 0,
                "hardware_version": 0,
                "streaming_mode": "Radio",
                "basis": basis,
            });
        }
        json!({"session_id": self.sessions, "inverse3": [device], "verse_grip": [], "wireless_verse_grip": [grip]})
    }
}

fn describe_fault(fault: &FaultRecord) -> String {
    commands_to_calls(&fault_and_remedy(fault), &COMMAND_REPLACEMENTS)
}
