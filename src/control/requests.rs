//! The requests to the control loop between two steps, and its answers.

use super::{ControlLoop, Rules, watch};
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::controller::Gains;
use crate::render::step_result::StepResult;
use crate::render::velocity::{Coefficients, Washout};
use crate::safety::fault::{FaultRecord, State};
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Speed below which a device counts as at rest, rad/s.
pub const REST_SPEED: f32 = 0.2;

/// A change between two control steps. `P` holds a [`Program`]: a box on the PC, a static buffer on the board.
#[derive(Debug)]
pub enum Command<P> {
    /// Replaces device and scene; what was there before comes back in the reply.
    Program(P),
    /// Gains of one wall, with its washout designed.
    Gains(Gains<f32>, Washout<f32>),
    /// Coefficients of the velocity estimators.
    Coefficients(Coefficients<f32>),
    /// Rules and limits.
    Rules(Rules),
    /// The present pose is the home pose.
    Home,
    /// Motors on.
    Arm,
    /// Motors on, for as long as this key is held.
    ArmHeld(Press),
    /// Answers as [`Command::Arm`] would, and changes nothing: what readies the power stage asks first.
    MayArm,
    /// The same for [`Command::ArmHeld`].
    MayArmHeld(Press),
    /// Motors off.
    Disarm,
    /// Moves each joint by a small torque to see that it turns the right way.
    CheckPolarity,
    /// Answers as [`Command::CheckPolarity`] would, and changes nothing.
    MayCheckPolarity,
    /// The polarity of this device is known from an earlier check.
    PolarityKnown,
    /// Clears a latched fault.
    Clear,
    /// The host is there, and says how it is with the key that its user holds.
    Beat(Beat),
    /// Latches a fault found elsewhere.
    Fault(FaultRecord),
    /// Counts the walls' energy from now on because telemetry shows it, or no longer; the passivity controller counts it
    /// anyway.
    ShowEnergy(bool),
}

/// A dead man's key that somebody saw down, and not before when. Motors that it holds go off
/// [`KEY_SECONDS`](super::KEY_SECONDS) after `seen`, however late it comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Press {
    /// Who holds it: a number that a tool draws. One key has one holder.
    pub holder: u32,
    /// The newest control step that whoever sees the key had been told of before: in the answer to a [`Beat`], for example.
    pub seen: u32,
}

/// A sign of life of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Beat {
    /// It is there. This neither feeds a key that is held nor lets it go.
    Here,
    /// A key is down. It feeds the one that holds the motors on; motors that are on without a key are held by it from now
    /// on.
    Held(Press),
    /// The key was let go: motors off, as by [`Command::Disarm`].
    Released,
}

/// The answer to a command, with the program it replaced.
pub type Reply<P> = (Result<(), Refusal>, Option<P>);

/// The state that a tool may ask for at any time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// Disarmed, armed, fault.
    pub state: State,
    /// True if the device is homed.
    pub homed: bool,
    /// True if its polarity is known.
    pub polarity: bool,
    /// The latched fault.
    pub fault: Option<FaultRecord>,
    /// Control steps since boot.
    pub step: u32,
    /// Bus voltage, V; 0 where it is not sensed.
    pub bus_voltage: f32,
    /// Joint angles, rad.
    pub q: [f32; MAX_JOINTS],
    /// Tip, m.
    pub tip: [f32; MAX_JOINTS],
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// The state as a tool sees it.
    pub fn status(&self) -> Status {
        Status {
            state: self.state,
            homed: self.homed,
            polarity: self.polarity_known,
            fault: self.fault,
            step: self.now.step,
            bus_voltage: self.now.motors.bus_voltage,
            q: self.now.found.at.q,
            tip: self.now.found.at.tip,
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

    /// Carries out a [`Command::Program`]: [`ControlLoop::accepts`], then [`ControlLoop::install`]. With the motors on, the control
    /// interrupt has no time for both at once, and leaves the second to the next carrier period.
    pub fn replace(&mut self, mut program: P) -> Reply<P> {
        match self.accepts(&mut program) {
            Ok(()) => (Ok(()), self.install(program)),
            Err(refusal) => (Err(refusal), Some(program)),
        }
    }

    /// Carries out any other command, of which new rules are in force for all joints only after [`ControlLoop::settle_next`] has
    /// been called until it says so.
    pub fn obey(&mut self, command: &Command<P>) -> Result<(), Refusal> {
        let result = self.carry_out(command);
        self.see_what_is_usual();
        result
    }

    #[inline(always)]
    fn carry_out(&mut self, command: &Command<P>) -> Result<(), Refusal> {
        match command {
            // It takes its program along: [`ControlLoop::replace`].
            Command::Program(_) => Err(Refusal::Busy),
            Command::Gains(gains, washout) => self.with_program(|p| p.controller.set_gains(gains, washout)),
            Command::Coefficients(coefficients) => self.with_program(|p| p.controller.set_coefficients(coefficients)),
            Command::Rules(rules) => self.set_rules(rules),
            Command::Home => self.home(),
            Command::Arm => self.arm(None),
            Command::ArmHeld(press) => self.arm(Some(*press)),
            Command::MayArm => self.may_arm(None),
            Command::MayArmHeld(press) => self.may_arm(Some(*press)),
            Command::MayCheckPolarity => self.ready().map(drop),
            Command::Disarm => {
                self.disarm();
                Ok(())
            }
            Command::CheckPolarity => self.start_polarity_check(),
            Command::PolarityKnown => {
                self.know_polarity();
                Ok(())
            }
            Command::Clear => {
                self.fault = None;
                if self.state == State::Fault {
                    self.state = State::Disarmed;
                }
                // Only the host: what else has been summed up while armed stays, or clearing would lift a limit.
                self.hear_host();
                Ok(())
            }
            Command::Beat(beat) => {
                match beat {
                    Beat::Here => {}
                    Beat::Held(press) => self.hear_key(*press),
                    Beat::Released => self.disarm(),
                }
                self.hear_host();
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

    /// Checks if a program may come. While armed it must be of the same device and rate, and its walls must not be
    /// touched.
    pub fn accepts(&self, program: &mut P) -> Result<(), Refusal> {
        if !self.state.drives() {
            return Ok(());
        }
        let Some(old) = &self.program else { return Err(Refusal::NoDevice) };
        if !program.same_device || old.rate_hz != program.rate_hz || self.state == State::CheckingPolarity {
            return Err(Refusal::Armed);
        }
        program.controller.set_zero(&old.controller.zero());
        if program.controller.inside_a_wall(&self.now.counts) {
            return Err(Refusal::InsideWall);
        }
        if let Some(refusal) = program.arming_refused {
            return Err(refusal);
        }
        Ok(())
    }

    /// Puts a program in force that was accepted; what it takes the place of. Another device, or another rate, has bounds
    /// and stages of its own, which take long to make ready; with the motors on neither changes.
    pub fn install(&mut self, mut program: P) -> Option<P> {
        let period = 1.0 / program.rate_hz.max(1.0);
        // Rates that differ by a rounding may have the same period, and carriers of their own.
        let same_carrier = self.program.as_ref().is_some_and(|old| old.carrier_hz == program.carrier_hz);
        let same_rate = period == self.period && same_carrier;
        // The time without a program is unknown, and it had no step at which a host could have seen its device.
        if period != self.period || self.program.is_none() {
            (self.period, self.rate_since) = (period, self.now.step);
        }
        program.controller.set_passivity(self.rules.passivity, self.shows_energy);
        let same_device = self.program.is_some() && program.same_device;
        match &self.program {
            Some(old) if same_device => program.controller.set_zero(&old.controller.zero()),
            _ => {
                self.homed = false;
                self.polarity_known = false;
                (self.first_index, self.marks) = ([None; MAX_JOINTS], None);
                // Of what a device with more joints found, nothing would be written over.
                self.now.found = StepResult::default();
                self.now.found.parallel = 1.0;
            }
        }
        self.begin_fade();
        (self.count, self.weighs) = (program.joints.min(MAX_JOINTS) as u8, program.weighs);
        if !(same_device && same_rate) {
            // The currents that flow go on.
            for (axis, joint) in program.axes.iter().zip(&mut self.joints) {
                let before = core::mem::replace(&mut joint.stage, *axis);
                joint.stage.inherit(&before);
            }
        }
        let old = self.program.replace(program);
        if !(same_device && same_rate) {
            self.set_bounds();
        }
        self.see_what_is_usual();
        old
    }

    fn set_rules(&mut self, rules: &Rules) -> Result<(), Refusal> {
        if self.state.drives() && !rules.no_looser_than(&self.rules) {
            return Err(Refusal::Armed);
        }
        self.rules = *rules;
        self.hear_host();
        if let Some(program) = self.program.as_mut() {
            program.controller.set_passivity(rules.passivity, self.shows_energy);
        }
        self.begin_bounds();
        Ok(())
    }

    fn home(&mut self) -> Result<(), Refusal> {
        self.must_be_off()?;
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        let home = program.home.ok_or(Refusal::NoHome)?;
        if !self.slower_than(REST_SPEED) {
            return Err(Refusal::Moving);
        }
        let program = self.program.as_mut().ok_or(Refusal::NoDevice)?;
        program.controller.home(&self.now.counts, &home);
        self.homed = true;
        self.keep_polarity_near_its_home();
        self.first_index = [None; MAX_JOINTS];
        self.set_bounds();
        Ok(())
    }

    /// Returns true if none of the device's joints turns faster than `speed`, rad/s.
    fn slower_than(&self, speed: f32) -> bool {
        self.joints.iter().take(self.count()).all(|joint| joint.speed().abs() <= speed)
    }

    fn must_be_off(&self) -> Result<(), Refusal> {
        match self.fault {
            _ if self.state.drives() => Err(Refusal::Armed),
            Some(record) => Err(Refusal::Faulted(record.fault)),
            None => Ok(()),
        }
    }

    /// The conditions that arming and the polarity check share.
    pub(super) fn ready(&self) -> Result<&P, Refusal> {
        self.must_be_off()?;
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        if let Some(refusal) = program.arming_refused {
            return Err(refusal);
        }
        if self.hardware.real && !self.homed {
            return Err(Refusal::NotHomed);
        }
        let bus = self.now.motors.bus_voltage;
        if self.hardware.bus_sensed && !(self.rules.limits.bus_min..=self.rules.limits.bus_max).contains(&bus) {
            return Err(Refusal::BusVoltage);
        }
        if self.now.found.parallel < watch::TRIPPING_SINE {
            return Err(Refusal::Singular);
        }
        for (i, limits) in program.limits.iter().enumerate().take(program.joints) {
            if let Some((low, high)) = limits
                && !(*low..=*high).contains(&self.now.found.at.q[i])
            {
                return Err(Refusal::OutsideLimits(i as u8));
            }
        }
        Ok(program)
    }

    fn may_arm(&self, key: Option<Press>) -> Result<(), Refusal> {
        let program = self.ready()?;
        if self.hardware.real && !self.polarity_known {
            return Err(Refusal::PolarityUnchecked);
        }
        if program.controller.inside_a_wall(&self.now.counts) {
            return Err(Refusal::InsideWall);
        }
        if key.is_some_and(|key| !self.is_fresh(key)) {
            return Err(Refusal::KeyTooOld);
        }
        Ok(())
    }

    fn disarm(&mut self) {
        self.off();
        if self.state != State::Fault {
            self.state = State::Disarmed;
        }
    }

    fn arm(&mut self, key: Option<Press>) -> Result<(), Refusal> {
        self.may_arm(key)?;
        self.find_stray()?;
        self.fade.start_from_nothing();
        self.key = key;
        self.watch_anew();
        self.state = State::Armed;
        Ok(())
    }

    /// Starts everything that is summed up while the motors are on.
    pub(super) fn watch_anew(&mut self) {
        self.hear_host();
        self.joints.iter_mut().for_each(|joint| joint.sums.reset());
        self.crests.reset();
        self.flow.reset();
        self.allow();
    }
}
