//! Requests to the control loop between two steps, and their replies.

use super::sensed::SensedEncoders;
use super::{ControlLoop, Rules, watch};
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::cogging::Compensation;
use crate::model::description::Homing;
use crate::render::controller::Gains;
use crate::render::step_result::StepResult;
use crate::render::velocity::{Coefficients, Washout};
use crate::safety::fault::{FaultRecord, State};
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Speed below which a device counts as at rest, rad/s; of a slide times its lever.
pub const REST_SPEED: f32 = 0.2;

/// A change between two control steps. `P` holds a [`Program`]: a box on the PC, a static buffer on the board.
#[derive(Debug)]
pub enum Command<P> {
    /// Replaces device and scene; the reply returns the previous program.
    Program(P),
    /// Gains of one wall, with the washout for these gains.
    Gains(Gains<f32>, Washout<f32>),
    /// Coefficients of the velocity estimators.
    Coefficients(Coefficients<f32>),
    /// Rules and limits.
    Rules(Rules),
    /// Takes the present pose as the home pose, or homes by index marks that the joints have passed.
    Home,
    /// Turns the motors on.
    Arm,
    /// Turns the motors on while this key is held.
    ArmHeld(Press),
    /// Returns the reply to [`Command::Arm`] without changing anything, before the power stage is made ready.
    MayArm,
    /// Returns the reply to [`Command::ArmHeld`] without changing anything.
    MayArmHeld(Press),
    /// Turns the motors off.
    Disarm,
    /// Swings each joint by a small torque to check its direction.
    CheckPolarity,
    /// Returns the reply to [`Command::CheckPolarity`] without changing anything.
    MayCheckPolarity,
    /// Marks the polarity of this device as known from an earlier check.
    PolarityKnown,
    /// Clears a latched fault.
    Clear,
    /// Compensation of the cogging of one joint's motor, and true if it was learnt at the present home.
    Cogging(u8, Compensation, bool),
    /// Reports a live host and the state of its user's key.
    Beat(Beat),
    /// Latches a fault that was detected elsewhere.
    Fault(FaultRecord),
    /// Computes the walls' energy if telemetry needs it. The passivity controller computes it in any case.
    ShowEnergy(bool),
    /// Pushes each joint to its stop while this key is held, and homes the device.
    FindStops(Press),
    /// Returns the reply to [`Command::FindStops`] without changing anything.
    MayFindStops(Press),
}

/// A press of a dead man's key, made at an unknown time after step `seen`. Motors that depend on the key go off
/// [`KEY_SECONDS`](super::KEY_SECONDS) after `seen`, even if the press arrives late.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Press {
    /// Random number of the tool that holds the key. A key has one holder.
    pub holder: u32,
    /// Newest control step that the tool knew before the press, for example from the reply to a [`Beat`].
    pub seen: u32,
}

/// A sign of life of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Beat {
    /// The host is alive. Does not change the state of a key.
    Here,
    /// A key is down. Confirms the key that keeps the motors on. Motors that are on without a key now depend on it.
    Held(Press),
    /// The key was released: turns the motors off, as [`Command::Disarm`] does.
    Released,
}

/// Result of a command, with the program that it replaced.
pub type Reply<P> = (Result<(), Refusal>, Option<P>);

/// State that a tool may request at any time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// State of the control loop.
    pub state: State,
    /// True if the device is homed. A device with stops is homed once its joints have touched them.
    pub homed: bool,
    /// True if the device's polarity is known.
    pub polarity: bool,
    /// Latched fault; `None` without a fault.
    pub fault: Option<FaultRecord>,
    /// Control steps since boot.
    pub step: u32,
    /// Bus voltage, V; 0 if it is not measured.
    pub bus_voltage: f32,
    /// Joint angles, rad; travels of slides, m.
    pub q: [f32; MAX_JOINTS],
    /// Tip position, m.
    pub tip: [f32; MAX_JOINTS],
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Returns the state for a tool.
    pub fn status(&self) -> Status {
        Status {
            state: self.state,
            homed: self.homed,
            polarity: self.polarity_known,
            fault: self.fault,
            step: self.now.step,
            bus_voltage: self.now.motors.bus_voltage,
            q: self.now.result.at.q,
            tip: self.now.result.at.tip,
        }
    }

    /// Carries out a command between two steps.
    pub fn execute(&mut self, command: Command<P>) -> Reply<P> {
        let reply = match command {
            Command::Program(program) => self.replace(program),
            command => (self.obey(&command), None),
        };
        self.finish_bounds();
        reply
    }

    /// Carries out a [`Command::Program`]: [`ControlLoop::accepts`], then [`ControlLoop::install`]. The control
    /// interrupt calls the two in separate carrier periods, because a period has no time for both.
    pub fn replace(&mut self, mut program: P) -> Reply<P> {
        match self.accepts(&mut program) {
            Ok(()) => (Ok(()), self.install(program)),
            Err(refusal) => (Err(refusal), Some(program)),
        }
    }

    /// Carries out any command other than [`Command::Program`]. New rules apply to all joints only after
    /// [`ControlLoop::settle_next`] has returned false.
    pub fn obey(&mut self, command: &Command<P>) -> Result<(), Refusal> {
        let result = self.carry_out(command);
        self.update_fast_path();
        result
    }

    #[inline(always)]
    fn carry_out(&mut self, command: &Command<P>) -> Result<(), Refusal> {
        match command {
            // A program must be moved in: see [`ControlLoop::replace`].
            Command::Program(_) => Err(Refusal::Busy),
            Command::Gains(gains, washout) => self.with_program(|p| p.controller.set_gains(gains, washout)),
            Command::Coefficients(coefficients) => self.with_program(|p| p.controller.set_coefficients(coefficients)),
            Command::Rules(rules) => self.set_rules(rules),
            Command::Home => self.home(),
            Command::Arm => self.arm(None),
            Command::ArmHeld(press) => self.arm(Some(*press)),
            Command::MayArm => self.may_arm(None),
            Command::MayArmHeld(press) => self.may_arm(Some(*press)),
            Command::MayCheckPolarity => self.check_ready().map(drop),
            Command::Disarm => {
                self.disarm();
                Ok(())
            }
            Command::CheckPolarity => self.start_polarity_check(),
            Command::FindStops(press) => self.find_stops(*press),
            Command::MayFindStops(press) => self.may_find_stops(*press),
            Command::PolarityKnown => {
                self.record_known_polarity();
                Ok(())
            }
            Command::Cogging(joint, compensation, learnt_here) => {
                self.set_cogging(*joint, compensation, *learnt_here);
                Ok(())
            }
            Command::Clear => {
                self.fault = None;
                if self.state == State::Fault {
                    self.state = State::Disarmed;
                }
                // Resets only the host's silence, because clearing must keep the other sums of the armed time.
                self.record_host();
                Ok(())
            }
            Command::Beat(beat) => {
                match beat {
                    Beat::Here => {}
                    Beat::Held(press) => self.record_key(*press),
                    Beat::Released => self.disarm(),
                }
                self.record_host();
                Ok(())
            }
            Command::Fault(record) => {
                self.trip(record.fault, record.axis, record.value);
                Ok(())
            }
            Command::ShowEnergy(shown) => {
                self.shows_energy = *shown;
                if let Some(program) = self.program.as_mut() {
                    program.controller.set_passivity(self.rules.passivity, *shown);
                }
                Ok(())
            }
        }
    }

    fn with_program(&mut self, change: impl FnOnce(&mut Program<K, S>)) -> Result<(), Refusal> {
        self.program.as_mut().map(|program| change(program)).ok_or(Refusal::NoDevice)
    }

    /// Returns an error if a program may not be installed. While armed, it must have the same device and rate, and the
    /// tip must not touch a wall of its scene.
    pub fn accepts(&self, program: &mut P) -> Result<(), Refusal> {
        if !self.state.drives() {
            return Ok(());
        }
        let Some(old) = &self.program else { return Err(Refusal::NoDevice) };
        if !program.same_device || old.rate_hz != program.rate_hz || self.state != State::Armed {
            return Err(Refusal::Armed);
        }
        program.controller.set_zero(&old.controller.zero());
        if program.controller.is_inside_wall(&self.now.counts) {
            return Err(Refusal::InsideWall);
        }
        if let Some(refusal) = program.arming_refused {
            return Err(refusal);
        }
        Ok(())
    }

    /// Installs an accepted program and returns the previous one. Takes longer for another device or rate, which are
    /// accepted only while the motors are off.
    pub fn install(&mut self, mut program: P) -> Option<P> {
        let period = 1.0 / program.rate_hz.max(1.0);
        // Rates that differ by a rounding error may have the same period but different carriers.
        let same_carrier = self.program.as_ref().is_some_and(|old| old.carrier_hz == program.carrier_hz);
        let same_rate = period == self.period && same_carrier;
        // Without a program no steps were counted, so a host cannot have read a step.
        if period != self.period || self.program.is_none() {
            (self.period, self.rate_since) = (period, self.now.step);
        }
        program.controller.set_passivity(self.rules.passivity, self.shows_energy);
        let same_device = self.program.is_some() && program.same_device;
        match &self.program {
            Some(old) if same_device => program.controller.set_zero(&old.controller.zero()),
            _ => {
                (self.homed, self.placed) = (false, false);
                self.polarity_known = false;
                self.marks = None;
                self.forget_marks();
                self.sensed = SensedEncoders::default();
                self.absolute.restart();
                // A device with fewer joints would not overwrite all results of the previous device.
                self.now.result = StepResult::default();
                self.now.result.parallel = 1.0;
            }
        }
        self.begin_fade();
        (self.joint_count, self.compensates_weight) =
            (program.joints.min(MAX_JOINTS) as u8, program.compensates_weight);
        if !(same_device && same_rate) {
            // The present currents continue.
            for (axis, joint) in program.axes.iter().zip(&mut self.joints) {
                let before = core::mem::replace(&mut joint.stage, *axis);
                joint.stage.inherit(&before);
            }
        }
        let old = self.program.replace(program);
        if !same_device {
            self.forget_cogging();
        }
        if !(same_device && same_rate) {
            self.set_bounds();
        }
        self.update_fast_path();
        old
    }

    fn set_rules(&mut self, rules: &Rules) -> Result<(), Refusal> {
        if self.state.drives() && !rules.is_no_looser_than(&self.rules) {
            return Err(Refusal::Armed);
        }
        self.rules = *rules;
        self.record_host();
        if let Some(program) = self.program.as_mut() {
            program.controller.set_passivity(rules.passivity, self.shows_energy);
        }
        self.begin_bounds();
        Ok(())
    }

    /// Returns true if every joint of the device moves at most at `speed`, rad/s; of a slide times its lever.
    pub(super) fn is_slower_than(&self, speed: f32) -> bool {
        self.joints.iter().enumerate().take(self.count()).all(|(i, joint)| joint.speed().abs() <= speed * self.lever(i))
    }

    /// Returns the lever of joint `i`, see [`JointUnits::lever`](crate::model::units::JointUnits::lever).
    pub(super) fn lever(&self, i: usize) -> f32 {
        self.program.as_ref().and_then(|program| program.lever.get(i).copied()).unwrap_or(1.0)
    }

    pub(super) fn check_motors_off(&self) -> Result<(), Refusal> {
        match self.fault {
            _ if self.state.drives() => Err(Refusal::Armed),
            Some(record) => Err(Refusal::Faulted(record.fault)),
            None => Ok(()),
        }
    }

    /// Checks the conditions that arming and the polarity check share.
    pub(super) fn check_ready(&self) -> Result<&P, Refusal> {
        self.check_motors_off()?;
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        if let Some(refusal) = program.arming_refused {
            return Err(refusal);
        }
        self.check_encoders_read()?;
        if self.hardware.real && !self.placed {
            let by_index = program.homing == Homing::Index;
            return Err(self.angles_by_index().err().filter(|_| by_index).unwrap_or(Refusal::NotHomed));
        }
        let bus = self.now.motors.bus_voltage;
        if self.hardware.bus_sensed && !(self.rules.limits.bus_min..=self.rules.limits.bus_max).contains(&bus) {
            return Err(Refusal::BusVoltage);
        }
        if self.now.result.parallel < watch::MIN_PARALLEL_SINE {
            return Err(Refusal::Singular);
        }
        for (i, limits) in program.limits.iter().enumerate().take(program.joints) {
            if let Some((low, high)) = limits
                && !(*low..=*high).contains(&self.now.result.at.q[i])
            {
                return Err(Refusal::OutsideLimits(i as u8));
            }
        }
        Ok(program)
    }

    fn may_arm(&self, key: Option<Press>) -> Result<(), Refusal> {
        let program = self.check_ready()?;
        if self.hardware.real && !self.polarity_known {
            return Err(Refusal::PolarityUnchecked);
        }
        if self.hardware.real && !self.homed {
            return Err(Refusal::StopsUntouched);
        }
        if program.controller.is_inside_wall(&self.now.counts) {
            return Err(Refusal::InsideWall);
        }
        if key.is_some_and(|key| !self.is_fresh(key)) {
            return Err(Refusal::KeyTooOld);
        }
        Ok(())
    }

    fn disarm(&mut self) {
        self.turn_motors_off();
        if self.state != State::Fault {
            self.state = State::Disarmed;
        }
    }

    fn arm(&mut self, key: Option<Press>) -> Result<(), Refusal> {
        self.may_arm(key)?;
        self.refuse_stray_current()?;
        self.fade.start_from_zero();
        self.key = key;
        self.restart_checks();
        self.state = State::Armed;
        Ok(())
    }

    /// Resets all sums of the armed time.
    pub(super) fn restart_checks(&mut self) {
        self.record_host();
        self.joints.iter_mut().for_each(|joint| joint.sums.reset());
        self.crests.reset();
        self.flow.reset();
        self.update_force_bounds();
    }
}
