//! What reaches the servo between two steps, and what it answers.

use super::{Rules, Servo, fade, watch};
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::controller::Gains;
use crate::render::found::Found;
use crate::render::velocity::{Coefficients, Washout};
use crate::safety::fault::{FaultRecord, State};
use crate::safety::refusal::Refusal;
use crate::servo::program::Program;
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
    /// Answers as [`Command::Arm`] would, and changes nothing: what readies the power stage asks first.
    MayArm,
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
    /// The host is there.
    HostAlive,
    /// Latches a fault found elsewhere.
    Fault(FaultRecord),
}

/// The answer to a command, with the program it replaced.
pub type Reply<P> = (Result<(), Refusal>, Option<P>);

/// What a tool wants to know at any time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// Disarmed, armed, fault.
    pub state: State,
    /// Whether the device is homed.
    pub homed: bool,
    /// Whether its polarity is known.
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

impl<P, K, S> Servo<P>
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
        let mut returned = None;
        let result = match command {
            Command::Program(mut program) => match self.accepts(&mut program) {
                Ok(()) => {
                    returned = self.install(program);
                    Ok(())
                }
                Err(refusal) => {
                    returned = Some(program);
                    Err(refusal)
                }
            },
            Command::Gains(gains, washout) => self.with_program(|p| p.controller.set_gains(&gains, &washout)),
            Command::Coefficients(coefficients) => self.with_program(|p| p.controller.set_coefficients(&coefficients)),
            Command::Rules(rules) => self.set_rules(rules),
            Command::Home => self.home(),
            Command::Arm => self.arm(),
            Command::MayArm => self.may_arm(),
            Command::MayCheckPolarity => self.ready().map(drop),
            Command::Disarm => {
                self.off();
                if self.state != State::Fault {
                    self.state = State::Disarmed;
                }
                Ok(())
            }
            Command::CheckPolarity => self.start_polarity_check(),
            Command::PolarityKnown => {
                self.polarity_known = true;
                Ok(())
            }
            Command::Clear => {
                self.fault = None;
                if self.state == State::Fault {
                    self.state = State::Disarmed;
                }
                // Only the host: what else has been summed up while armed stays, or clearing would lift a limit.
                self.host_silent = 0.0;
                Ok(())
            }
            Command::HostAlive => {
                self.host_silent = 0.0;
                Ok(())
            }
            Command::Fault(record) => {
                self.trip(record.fault, record.axis, record.value);
                Ok(())
            }
        };
        (result, returned)
    }

    fn with_program(&mut self, change: impl FnOnce(&mut Program<K, S>)) -> Result<(), Refusal> {
        self.program.as_mut().map(|program| change(program)).ok_or(Refusal::NoDevice)
    }

    /// A program may come while armed only if it is of the same device and rate and its walls are not touched.
    fn accepts(&self, program: &mut P) -> Result<(), Refusal> {
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

    fn install(&mut self, mut program: P) -> Option<P> {
        let period = 1.0 / program.rate_hz.max(1.0);
        if period != self.period {
            (self.period, self.rate_since) = (period, self.now.step);
        }
        program.controller.set_passivity(self.rules.passivity);
        match &self.program {
            Some(old) if program.same_device => program.controller.set_zero(&old.controller.zero()),
            _ => {
                self.homed = false;
                self.polarity_known = false;
                self.first_index = [None; MAX_JOINTS];
                // Of what a device with more joints found, nothing would be written over.
                self.now.found = Found::default();
                self.now.found.regularity.parallel = 1.0;
            }
        }
        // The currents that flow go on.
        if let Some(old) = &self.program {
            for (axis, old) in program.axes.iter_mut().zip(&old.axes) {
                axis.inherit(old);
            }
        }
        self.begin_fade();
        let old = self.program.replace(program);
        self.limit_currents();
        self.set_bounds();
        old
    }

    /// Puts the rules' currents in force; the motors' own limits still count.
    fn limit_currents(&mut self) {
        let (limits, Some(program)) = (&self.rules.limits, self.program.as_mut()) else { return };
        for (i, (axis, heat)) in program.axes.iter_mut().zip(&mut self.heat).enumerate() {
            axis.limit(limits.current[i]);
            heat.limit(axis.max_current(), limits.continuous_current[i]);
        }
    }

    fn set_rules(&mut self, rules: Rules) -> Result<(), Refusal> {
        if self.state.drives() && !rules.no_looser_than(&self.rules) {
            return Err(Refusal::Armed);
        }
        self.rules = rules;
        self.host_silent = 0.0;
        if let Some(program) = self.program.as_mut() {
            program.controller.set_passivity(rules.passivity);
        }
        self.limit_currents();
        self.set_bounds();
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
        self.first_index = [None; MAX_JOINTS];
        self.set_bounds();
        Ok(())
    }

    /// Whether none of the device's joints turns faster than `speed`, rad/s.
    fn slower_than(&self, speed: f32) -> bool {
        (0..self.joints()).all(|i| self.crests.speed(i).abs() <= speed)
    }

    fn must_be_off(&self) -> Result<(), Refusal> {
        match self.fault {
            _ if self.state.drives() => Err(Refusal::Armed),
            Some(record) => Err(Refusal::Faulted(record.fault)),
            None => Ok(()),
        }
    }

    /// What arming and the polarity check both need.
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
        if self.now.found.regularity.parallel < watch::TRIPPING_SINE {
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

    fn may_arm(&self) -> Result<(), Refusal> {
        let program = self.ready()?;
        if self.hardware.real && !self.polarity_known {
            return Err(Refusal::PolarityUnchecked);
        }
        if program.controller.inside_a_wall(&self.now.counts) {
            return Err(Refusal::InsideWall);
        }
        Ok(())
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        self.may_arm()?;
        self.fade = fade::Fade::default();
        self.watch_anew();
        self.state = State::Armed;
        Ok(())
    }

    /// Starts everything that is summed up while the motors are on.
    pub(super) fn watch_anew(&mut self) {
        self.host_silent = 0.0;
        self.budgets.anew();
        self.crests.anew();
    }
}
