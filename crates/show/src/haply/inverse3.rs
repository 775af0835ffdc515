//! A board as the device of Haply's that programs take it for: what its frames say, and what becomes of their wishes.

use super::wish::{Basis, Wish};
use haptic_bridge::board::protocol::{ForceAnswer, ForceDone, ForceRequest};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{CLEARING, Fault, FaultRecord, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::frame::Axes;
use haptic_host::link::{Board, BoardError, LinkError, Session};
use haptic_host::words::{fault_and_remedy, for_a_program};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// The handle that programs ask for: it does not turn, and its buttons are not pressed.
const GRIP: &str = "HB00";
/// Number of an Inverse3 in the `device_type` of Haply's service.
const INVERSE3: u32 = 4;
/// Most simulated time that passes at once.
const MOST_AT_ONCE: Duration = Duration::from_millis(100);
/// Commands that a person would type, and what a program sends instead.
const CALLS: [(&str, &str); 1] = [(CLEARING, "`clear_fault`")];

/// A board that programs take for a device of Haply's.
pub struct Inverse3 {
    session: Session,
    axes: Axes,
    id: String,
    simulated: bool,
    looked: Instant,
    last: ForceAnswer,
    /// True if `last` answers the latest request.
    answered: bool,
    /// The fault that is latched.
    fault: Option<FaultRecord>,
    /// The board is homed and its motors' polarity is known, or it needs neither.
    calibrated: bool,
    /// The board's reason not to turn the motors on for this program.
    refusal: Option<String>,
    /// The step from which on a force arms, after a fault was cleared.
    arms_from: Option<u32>,
    armed: bool,
    /// True if the next force arms: the first of a program. Motors that go off meanwhile were turned off on purpose.
    may_arm: bool,
    /// The axes of the program that is connected.
    basis: Basis,
    /// Number of programs that have used it.
    sessions: u32,
    told: Vec<String>,
}

impl Inverse3 {
    /// Of a board that is open and has a device; a board without a scene gets free space. `axes` are CHAI3D's, as
    /// [`Axes::of`] knows them.
    pub fn new(mut session: Session, axes: Option<Axes>, simulated: bool) -> Result<Self, BoardError> {
        let device = session.device()?.ok_or(Refusal::NoDevice)?;
        let task = device.mechanism.kind().spec().task;
        if session.scene()?.is_none() {
            session.set_scene(&Scene { task: task as u8, ..Scene::default() })?;
        }
        let axes = axes.unwrap_or_else(|| Axes::of(device.mechanism.kind(), device.weight));
        let id = session.info().serial.to_string();
        let last = session.look()?;
        let mut device = Self {
            fault: session.fault(),
            session,
            axes,
            id,
            simulated,
            looked: Instant::now(),
            last,
            answered: true,
            calibrated: false,
            refusal: None,
            arms_from: None,
            armed: false,
            may_arm: true,
            basis: Basis::default(),
            sessions: 0,
            told: Vec::new(),
        };
        device.read_calibration()?;
        Ok(device)
    }

    /// The device's id in messages: the board's serial number.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Says something to whoever runs the server, once.
    pub(super) fn tell(&mut self, words: String) {
        if !self.told.contains(&words) {
            haptic_host::tell!("{words}");
            self.told.push(words);
        }
    }

    /// Another program has it from now on.
    pub(super) fn begin(&mut self) {
        self.sessions += 1;
    }

    /// Time since the board was last asked something. A simulated one in this process forgets no silent program.
    pub(super) fn idle(&self) -> Duration {
        if self.simulated { Duration::ZERO } else { self.looked.elapsed() }
    }

    fn read_calibration(&mut self) -> Result<(), LinkError> {
        let status = self.session.status()?;
        self.calibrated = status.homed && status.polarity || !self.session.details()?.real;
        Ok(())
    }

    /// Motors off.
    pub(super) fn let_go(&mut self) {
        (self.armed, self.may_arm, self.basis, self.refusal) = (false, true, Basis::default(), None);
        self.told.clear();
        let _ = self.session.disarm();
    }

    /// Does what a message asks for, and reads how the device is then. An answer that does not come is told, and the next
    /// message goes on; the error is a board that is gone.
    pub(super) fn obey(&mut self, wish: &Wish) -> Result<(), BoardError> {
        for other in &wish.others {
            self.tell(format!("`{other}` is left alone: a board takes forces at the tip, and a basis for them"));
        }
        if wish.elsewhere {
            self.tell(format!("what is not for `device_id` {} is left alone", self.id));
        }
        self.basis = wish.basis.unwrap_or(self.basis);
        let done = self.exchange(wish);
        self.heard(done)
    }

    /// Reads how the device is for somebody who does not use it: this is no sign of the program that does.
    pub(super) fn glance(&mut self) -> Result<(), BoardError> {
        let look = |device: &mut Self| {
            device.let_pass()?;
            device.last = Board::force(&mut device.session, &ForceRequest::default())?;
            device.fault = match (device.last.state, device.fault) {
                (State::Fault, None) => device.session.status()?.fault,
                (State::Fault, known) => known,
                _ => None,
            };
            Ok(device.read_calibration()?)
        };
        let done = look(self);
        self.heard(done)
    }

    fn heard(&mut self, done: Result<(), BoardError>) -> Result<(), BoardError> {
        self.answered = done.is_ok();
        match done {
            Err(BoardError::Link(lost @ (LinkError::Unanswered { .. } | LinkError::Silent { .. }))) => {
                self.tell(lost.to_string());
                Ok(())
            }
            Err(BoardError::Refused(refusal)) => {
                self.tell(format!("the board refuses: {refusal}"));
                Ok(())
            }
            done => done,
        }
    }

    /// Lets the time pass that has passed: a simulated board's does so only while somebody waits for it.
    fn let_pass(&mut self) -> Result<(), LinkError> {
        if self.simulated {
            self.session.rows(self.looked.elapsed().min(MOST_AT_ONCE))?;
        }
        self.looked = Instant::now();
        Ok(())
    }

    fn exchange(&mut self, wish: &Wish) -> Result<(), BoardError> {
        self.let_pass()?;
        if wish.clear_fault {
            self.clear()?;
        }
        self.last = match wish.force {
            None => self.session.look()?,
            Some(force) => {
                if !self.armed && self.may_arm && !wish.clear_fault {
                    self.arm()?;
                }
                let [right, away, up] = self.basis.to_haply(force);
                let force = self.axes.to_task([-away, right, up]);
                self.session.force(force.map(|newtons| newtons as f32))?
            }
        };
        if let ForceDone::Bad(_) = self.last.done {
            let [x, y, z] = wish.force.unwrap_or_default();
            self.tell(format!("a force of ({x:e}, {y:e}, {z:e}) N is {}", self.last.done));
        }
        let before = self.fault;
        self.notice();
        if wish.full || before != self.fault {
            self.read_calibration()?;
        }
        Ok(())
    }

    /// Tells why the motors went off while the program had them on.
    fn notice(&mut self) {
        self.fault = self.session.fault();
        if self.armed && self.last.state != State::Armed {
            self.armed = false;
            let why = self.fault.map_or_else(|| "another tool did it".into(), |fault| words(&fault));
            let anew = self.fault.is_none_or(|fault| fault.fault == Fault::HostLost);
            let on = if anew { "connects anew arms them" } else { "clears that arms them" };
            self.tell(format!("the motors are off: {why}; a program that {on}"));
        }
    }

    /// Clears the latched fault. A force arms a second later at the earliest: a fault stays a fault for a person's hand, also
    /// where a program clears it in every message.
    fn clear(&mut self) -> Result<(), BoardError> {
        self.last = self.session.look()?;
        self.notice();
        let rate = self.session.scene()?.map_or(0.0, |scene| scene.rate_hz);
        self.session.clear()?;
        self.arms_from = Some(self.last.step.wrapping_add(rate as u32));
        (self.fault, self.refusal, self.may_arm) = (None, None, true);
        self.tell("the fault is cleared: a force arms from a second on".into());
        Ok(())
    }

    fn arm(&mut self) -> Result<(), BoardError> {
        // Half the counter's range is hours ahead.
        if self.arms_from.is_some_and(|from| (self.last.step.wrapping_sub(from) as i32) < 0) {
            return Ok(());
        }
        self.arms_from = None;
        // A program that connects has lost whatever fell silent before it; a person has to look at any other fault.
        if self.fault.is_some_and(|fault| fault.fault == Fault::HostLost) {
            self.session.clear()?;
            self.fault = None;
        }
        match self.session.arm() {
            Ok(()) => (self.armed, self.may_arm, self.refusal) = (true, false, None),
            Err(BoardError::Refused(refusal)) => {
                let refusal = for_a_program(&refusal.to_string(), &CALLS);
                self.tell(format!("the motors stay off: {refusal}"));
                self.refusal = Some(refusal);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// A frame; `full` with what does not change.
    pub(super) fn frame(&self, full: bool) -> Value {
        let vector = |task: [f32; 3]| {
            let [toward, right, up] = self.axes.to_chai3d(task.map(f64::from));
            let [x, y, z] = self.basis.to_program([right, -toward, up]);
            json!({"x": x, "y": y, "z": z})
        };
        let each = |[a0, a1, a2]: [f64; 3]| json!({"a0": a0, "a1": a1, "a2": a2});
        let degrees = |radians: [f32; 3]| each(radians.map(|angle| f64::from(angle).to_degrees()));
        let upright = json!({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0});
        let zero = json!({"x": 0.0, "y": 0.0, "z": 0.0});
        let here = json!({"position": zero, "rotation": upright, "scale": {"x": 1.0, "y": 1.0, "z": 1.0}});
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
                "transform": here,
            },
            "status": {
                "calibrated": self.calibrated,
                "in_use": armed,
                "power_supply": true,
                "ready": self.answered && self.fault.is_none() && self.calibrated && self.refusal.is_none(),
                "started": armed,
            },
        });
        if let Some(FaultRecord { fault, axis, value, .. }) = self.fault {
            device["fault"] = json!({
                "code": fault.code(), "name": fault.name(), "what": fault.what(), "joint": axis, "value": value,
                "remedy": for_a_program(fault.remedy(), &CALLS),
            });
        }
        if let Some(refusal) = &self.refusal {
            device["refusal"] = json!(refusal);
        }
        let mut grip = json!({
            "device_id": GRIP,
            "state": {
                "battery_level": 1.0,
                "battery_voltage": 3.7,
                "buttons": {"a": false, "b": false, "c": false},
                "hall": 0,
                "orientation": upright,
            },
            "status": {"ready": true, "connected": true, "awake": true},
        });
        if full {
            let basis = json!({"permutation": self.basis.to_string()});
            device["config"] = json!({
                "id": self.id,
                "type": "inverse3",
                "device_info": {
                    "id": self.id, "major_version": 0, "minor_version": 1, "device_type": INVERSE3, "uuid": self.id,
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
                "mount": here,
                "filters": {"force_gate": {"gain": 0.0}, "damping": {"scalar": 0.0}},
                "streaming_mode": "USB",
            });
            grip["config"] = json!({
                "id": GRIP,
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

fn words(fault: &FaultRecord) -> String {
    for_a_program(&fault_and_remedy(fault), &CALLS)
}
