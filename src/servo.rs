//! One control period of the board, without the board: samples in, bridge state and currents out; then, once per
//! carrier period, duties.
//!
//! The firmware's interrupt, the simulated board and the tests all run this very code. Configuration reaches it whole,
//! between two steps: a [`Program`] is built elsewhere and handed over by ownership, small changes are [`Command`]s.
//! Nothing here blocks, allocates or panics.

use crate::carrier::Carrier;
use crate::controller::{Controller, Gains, Step};
use crate::description::MAX_JOINTS;
use crate::device::Device;
use crate::drive::{Axis, Bridge};
use crate::guard::{Fault, FaultRecord, Limits, POWER_SECONDS, Refusal, State};
use crate::math::Math;
use crate::mechanism::Kind;
use crate::precomputed::{MassModel, MassModelData};
use crate::scene::Scene;
use crate::velocity::{Coefficients, Washout};
use core::ops::DerefMut;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Seconds over which torque ramps up after arming.
pub const ARM_SECONDS: f32 = 0.5;
/// Regularity of a closed loop below which its tip force is no longer defined well enough to act.
pub const SINGULAR_SINE: f32 = 2.0e-3;
/// How long torque near its limit without any encoder motion is believed, s.
pub const STALL_SECONDS: f32 = 5.0;
/// How long an encoder may stand still while the back-EMF says the joint turns, s.
pub const LOSS_SECONDS: f32 = 0.05;
/// Speed below which a device counts as at rest, rad/s.
pub const REST_SPEED: f32 = 0.2;
/// Largest share of a motor's torque that the polarity check applies.
pub const POLARITY_SHARE: f32 = 0.25;
/// Joint motion that decides the polarity check, rad.
pub const POLARITY_MOTION: f32 = 0.02;
/// Time the polarity check takes to reach its torque, s; it gives up after twice this.
pub const POLARITY_SECONDS: f32 = 1.0;

/// What the hardware saw at one sampling instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counts, extended to 32 bits, wrapping.
    pub counts: [i32; MAX_JOINTS],
    /// V; ignored where the board does not sense it.
    pub bus_voltage: f32,
    /// Motor currents, A; ignored where they are not sensed.
    pub currents: [f32; MAX_JOINTS],
    /// Count at the last index pulse seen since the last step.
    pub index: [Option<i32>; MAX_JOINTS],
    /// A fault that hardware or another part of the firmware reports.
    pub fault: Option<(Fault, Option<u8>, f32)>,
}

/// What one control step decided.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Whether the bridges may drive; false means floating.
    pub bridges: bool,
}

/// One step as telemetry records it. Vectors are padded with zeros to three entries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Control steps since boot.
    pub step: u32,
    /// The state after this step.
    pub state: State,
    /// Walls touched.
    pub contacts: u8,
    /// Encoder counts.
    pub counts: [i32; MAX_JOINTS],
    /// Joint angles, rad.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, rad/s.
    pub qd: [f32; MAX_JOINTS],
    /// Tip, m.
    pub tip: [f32; MAX_JOINTS],
    /// Joint torques after limits, N m.
    pub torque: [f32; MAX_JOINTS],
    /// Measured currents, or commanded ones where none is sensed, A.
    pub current: [f32; MAX_JOINTS],
    /// Duties of the last carrier period.
    pub duty: [f32; MAX_JOINTS],
    /// Distance to the deepest wall, m.
    pub distance: f32,
    /// Velocity along its normal, m/s.
    pub normal_velocity: f32,
    /// Sum of the walls' forces, N.
    pub wall_force: f32,
    /// Share of the feed-forward that acts.
    pub shaping: f32,
    /// Energy the walls have taken up since contact began (negative: given out), J.
    pub energy: f32,
    /// Damping the passivity controller added, N s/m.
    pub passivity_damping: f32,
    /// V
    pub bus_voltage: f32,
}

/// How the host is watched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum HostAction {
    /// A silent host is no fault.
    #[default]
    Ignore,
    /// The scene goes on; the fault is listed, and arming anew waits until it is cleared.
    Hold,
    /// The motors go off.
    Disarm,
}

/// What of the board's settings the servo obeys.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Rules {
    /// Enforced limits.
    pub limits: Limits,
    /// What a silent host means.
    pub host_action: HostAction,
    /// How long a host may be silent, s.
    pub host_seconds: f32,
    /// Whether the passivity controller damps energy that a wall gives out (Hannaford and Ryu 2002).
    pub passivity: bool,
    /// Counts between two index pulses of each encoder; 0 where there is none.
    pub index_period: [i32; MAX_JOINTS],
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            host_action: HostAction::Ignore,
            host_seconds: 0.5,
            passivity: false,
            index_period: [0; MAX_JOINTS],
        }
    }
}

/// What a board is, as far as the servo cares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hardware {
    /// Motor axes.
    pub axes: usize,
    /// Whether there are real motors, which need verified data, limits, homing and a polarity check.
    pub real: bool,
    /// Whether the bus voltage is measured.
    pub bus_sensed: bool,
    /// Its bridges.
    pub bridge: Bridge,
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        /// The controller of whichever mechanism is loaded, in the board's precision.
        #[derive(Clone, Debug)]
        pub enum AnyController<K> {
            $(
                #[doc = concat!("Controls a [`", stringify!($Variant), "`](crate::mechanism::", stringify!($Variant), ").")]
                $Variant(Controller<f32, crate::mechanism::$Variant<f32>, K, $n>),
            )*
        }

        impl<K: Math<f32>> AnyController<K> {
            /// Builds the run-time form of a device and a scene; designs filters, so not for the interrupt.
            pub fn new(device: &Device<f32>, scene: &Scene<f32>, mass: &MassModelData) -> Result<Self, Refusal> {
                match &device.mechanism {
                    $(crate::mechanism::AnyMechanism::$Variant(mechanism) => {
                        let mass = MassModel::new(mass).ok_or(Refusal::BadTable)?;
                        Controller::new(*mechanism, device, scene, mass).map(Self::$Variant).map_err(Refusal::Scene)
                    })*
                }
            }

            /// Which mechanism.
            pub fn kind(&self) -> Kind {
                match self { $(Self::$Variant(_) => Kind::$Variant,)* }
            }

            /// One control step; fills what a frame records of it and returns the distances from singularities.
            #[inline(always)]
            fn step(&mut self, counts: &[i32; MAX_JOINTS], frame: &mut Frame) -> crate::mechanism::Regularity<f32> {
                match self { $(Self::$Variant(controller) => record(controller.step(&head(counts)), frame),)* }
            }

            /// See [`Controller::home`].
            pub fn home(&mut self, counts: &[i32; MAX_JOINTS], q: &[f32; MAX_JOINTS]) {
                match self { $(Self::$Variant(controller) => controller.home(&head(counts), &head(q)),)* }
            }

            /// Counts that homing subtracts.
            pub fn zero(&self) -> [i32; MAX_JOINTS] {
                match self { $(Self::$Variant(controller) => pad(&controller.zero()),)* }
            }

            /// Takes over homing.
            pub fn set_zero(&mut self, zero: &[i32; MAX_JOINTS]) {
                match self { $(Self::$Variant(controller) => controller.set_zero(head(zero)),)* }
            }

            /// See [`Controller::inside_a_wall`].
            pub fn inside_a_wall(&self, counts: &[i32; MAX_JOINTS]) -> bool {
                match self { $(Self::$Variant(controller) => controller.inside_a_wall(&head(counts)),)* }
            }

            /// See [`Controller::set_gains`].
            pub fn set_gains(&mut self, gains: &Gains<f32>, washout: &Washout<f32>) {
                match self { $(Self::$Variant(controller) => controller.set_gains(gains, washout),)* }
            }

            /// See [`Controller::set_coefficients`].
            pub fn set_coefficients(&mut self, coefficients: &Coefficients<f32>) {
                match self { $(Self::$Variant(controller) => controller.set_coefficients(coefficients),)* }
            }

            /// See [`Controller::set_passivity`].
            pub fn set_passivity(&mut self, on: bool) {
                match self { $(Self::$Variant(controller) => controller.set_passivity(on),)* }
            }
        }
    };
}
crate::mechanisms!(define);

/// The first N of three.
#[inline(always)]
fn head<V: Copy, const N: usize>(values: &[V; MAX_JOINTS]) -> [V; N] {
    core::array::from_fn(|i| values[i.min(MAX_JOINTS - 1)])
}

/// N values padded to three.
#[inline(always)]
fn pad<V: Copy + Default, const N: usize>(values: &[V; N]) -> [V; MAX_JOINTS] {
    core::array::from_fn(|i| if i < N { values[i.min(N - 1)] } else { V::default() })
}

#[inline(always)]
fn record<const N: usize>(step: Step<f32, N>, frame: &mut Frame) -> crate::mechanism::Regularity<f32> {
    frame.q = pad(&step.q.data.0[0]);
    frame.qd = pad(&step.qd.data.0[0]);
    frame.tip = pad(&step.tip.data.0[0]);
    frame.torque = pad(&step.torque.data.0[0]);
    frame.distance = step.distance;
    frame.normal_velocity = step.normal_velocity;
    frame.wall_force = step.wall_force;
    frame.contacts = step.contacts;
    frame.shaping = step.shaping;
    frame.energy = step.energy;
    frame.passivity_damping = step.passivity_damping;
    step.regularity
}

/// A device in a scene on a board, ready to run: what is handed to the servo whole.
#[derive(Clone, Debug)]
pub struct Program<K> {
    controller: AnyController<K>,
    axes: [Axis; MAX_JOINTS],
    joints: usize,
    limits: [Option<(f32, f32)>; MAX_JOINTS],
    home: Option<[f32; MAX_JOINTS]>,
    counts_scale: [f32; MAX_JOINTS],
    /// Same device as the program before: homing and the polarity check stay valid.
    same_device: bool,
    /// Why this program may not be armed, found once.
    unarmable: Option<Refusal>,
    rate_hz: f32,
}

impl<K: Math<f32>> Program<K> {
    /// Builds a program for `hardware` under `limits`. `same_device` keeps homing across a change of scene.
    ///
    /// Errors: more joints than axes, a joint without encoder scale, or whatever the scene or the table lacks.
    pub fn new(
        hardware: &Hardware,
        limits: &Limits,
        device: &Device<f32>,
        scene: &Scene<f32>,
        mass: &MassModelData,
        same_device: bool,
    ) -> Result<Self, Refusal> {
        let joints = device.axes();
        if joints > hardware.axes {
            return Err(Refusal::TooManyJoints { joints: joints as u8, axes: hardware.axes as u8 });
        }
        let controller = AnyController::new(device, scene, mass)?;
        // The current loops run once a carrier period, and the carrier follows the control rate.
        let bridge = Bridge { carrier_hz: Carrier::for_rate(scene.rate_hz).carrier_hz(), ..hardware.bridge };
        let mut axes = [Axis::default(); MAX_JOINTS];
        let mut unarmable = if device.home.is_none() && hardware.real { Some(Refusal::NoHome) } else { None };
        for (i, joint) in device.joints.iter().enumerate().take(joints) {
            let scale = joint.radians_per_count;
            if !scale.is_finite() || scale == 0.0 {
                return Err(Refusal::BadDevice);
            }
            let index = i as u8;
            match &joint.motor {
                None => unarmable = unarmable.or(Some(Refusal::NoMotor(index))),
                Some(motor) => {
                    if hardware.real && !motor.verified {
                        unarmable = unarmable.or(Some(Refusal::MotorNotVerified(index)));
                    }
                    let (most, steady) = (limits.current[i], limits.continuous_current[i]);
                    axes[i] = Axis::new(motor, &bridge, most, steady);
                }
            }
            if hardware.real && joint.limits.is_none() {
                unarmable = unarmable.or(Some(Refusal::NoJointLimits(index)));
            }
        }
        Ok(Self {
            controller,
            axes,
            joints,
            limits: core::array::from_fn(|i| device.joints[i].limits),
            home: device.home,
            counts_scale: core::array::from_fn(|i| device.joints[i].radians_per_count.abs()),
            same_device,
            unarmable,
            rate_hz: scene.rate_hz,
        })
    }

    /// Its controller.
    pub fn controller(&self) -> &AnyController<K> {
        &self.controller
    }

    /// Control rate, Hz.
    pub fn rate_hz(&self) -> f32 {
        self.rate_hz
    }
}

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
    /// Motors off.
    Disarm,
    /// Moves each joint by a small torque to see that it turns the right way.
    CheckPolarity,
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

/// Progress of the polarity check.
#[derive(Clone, Copy, Debug, Default)]
struct Polarity {
    axis: usize,
    seconds: f32,
    from: f32,
}

/// The board's control loop.
#[derive(Debug)]
pub struct Servo<P> {
    hardware: Hardware,
    rules: Rules,
    program: Option<P>,
    state: State,
    homed: bool,
    polarity_known: bool,
    polarity: Polarity,
    fault: Option<FaultRecord>,
    frame: Frame,
    period: f32,
    ramp: f32,
    host_silent: f32,
    still: [f32; MAX_JOINTS],
    lost: [f32; MAX_JOINTS],
    last_counts: [i32; MAX_JOINTS],
    primed: bool,
    first_index: [Option<i32>; MAX_JOINTS],
    power: f32,
}

impl<P, K> Servo<P>
where
    P: DerefMut<Target = Program<K>>,
    K: Math<f32>,
{
    /// A disarmed servo without a device.
    pub fn new(hardware: Hardware, rules: Rules) -> Self {
        Self {
            hardware,
            rules,
            program: None,
            state: State::Disarmed,
            homed: false,
            polarity_known: false,
            polarity: Polarity::default(),
            fault: None,
            frame: Frame::default(),
            period: 1.0 / 20_000.0,
            ramp: 0.0,
            host_silent: 0.0,
            still: [0.0; MAX_JOINTS],
            lost: [0.0; MAX_JOINTS],
            last_counts: [0; MAX_JOINTS],
            primed: false,
            first_index: [None; MAX_JOINTS],
            power: 0.0,
        }
    }

    /// The last step's frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The state as a tool sees it.
    pub fn status(&self) -> Status {
        Status {
            state: self.state,
            homed: self.homed,
            polarity: self.polarity_known,
            fault: self.fault,
            step: self.frame.step,
            bus_voltage: self.frame.bus_voltage,
            q: self.frame.q,
            tip: self.frame.tip,
        }
    }

    /// Control rate of the loaded program, Hz.
    pub fn rate_hz(&self) -> Option<f32> {
        self.program.as_ref().map(|program| program.rate_hz)
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
                self.power = 0.0;
                self.still = [0.0; MAX_JOINTS];
                self.lost = [0.0; MAX_JOINTS];
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

    /// One control period: reads the samples, steps the controller, guards, and sets what each motor shall do.
    #[inline(always)]
    pub fn control(&mut self, samples: &Samples) -> Outputs {
        self.frame.step = self.frame.step.wrapping_add(1);
        self.frame.counts = samples.counts;
        self.frame.bus_voltage = if self.hardware.bus_sensed { samples.bus_voltage } else { 0.0 };
        if let Some((fault, axis, value)) = samples.fault {
            self.trip(fault, axis, value);
        }
        self.host_silent += self.period;
        if let Some(program) = self.program.as_mut() {
            let regularity = program.controller.step(&samples.counts, &mut self.frame);
            self.watch(samples, &regularity);
            self.drive();
        }
        self.last_counts = samples.counts;
        self.primed = true;
        self.frame.state = self.state;
        Outputs { bridges: matches!(self.state, State::Armed | State::CheckingPolarity) }
    }

    /// Duties for the next carrier period, signed, ±[`MAX_DUTY`](crate::drive::MAX_DUTY); zero unless armed.
    #[inline(always)]
    pub fn duties(&mut self, bus_voltage: f32, currents: &[f32; MAX_JOINTS]) -> [f32; MAX_JOINTS] {
        let mut duties = [0.0; MAX_JOINTS];
        if matches!(self.state, State::Armed | State::CheckingPolarity)
            && let Some(program) = self.program.as_mut()
        {
            let joints = program.joints;
            for ((duty, axis), current) in duties.iter_mut().zip(&mut program.axes).zip(currents).take(joints) {
                *duty = axis.duty(bus_voltage, *current);
            }
        }
        self.frame.duty = duties;
        duties
    }

    /// Latches the first fault and turns the motors off.
    pub fn trip(&mut self, fault: Fault, axis: Option<u8>, value: f32) {
        if self.fault.is_none() {
            self.fault = Some(FaultRecord { fault, axis, value, step: self.frame.step });
        }
        self.off();
        self.state = State::Fault;
    }

    fn off(&mut self) {
        self.ramp = 0.0;
        self.frame.torque = [0.0; MAX_JOINTS];
        if let Some(program) = self.program.as_mut() {
            program.axes.iter_mut().for_each(Axis::rest);
        }
    }

    fn with_program(&mut self, change: impl FnOnce(&mut Program<K>)) -> Result<(), Refusal> {
        self.program.as_mut().map(|program| change(program)).ok_or(Refusal::NoDevice)
    }

    /// A program may come while armed only if it is of the same device and rate and its walls are not touched.
    fn accepts(&self, program: &mut P) -> Result<(), Refusal> {
        let off = matches!(self.state, State::Disarmed | State::Fault);
        if off {
            return Ok(());
        }
        let Some(old) = &self.program else { return Err(Refusal::NoDevice) };
        if !program.same_device || old.rate_hz != program.rate_hz || self.state == State::CheckingPolarity {
            return Err(Refusal::Armed);
        }
        program.controller.set_zero(&old.controller.zero());
        if program.controller.inside_a_wall(&self.frame.counts) {
            return Err(Refusal::InsideWall);
        }
        if let Some(refusal) = program.unarmable {
            return Err(refusal);
        }
        Ok(())
    }

    fn install(&mut self, mut program: P) -> Option<P> {
        self.period = 1.0 / program.rate_hz.max(1.0);
        program.controller.set_passivity(self.rules.passivity);
        match &self.program {
            Some(old) if program.same_device => {
                program.controller.set_zero(&old.controller.zero());
                let heats = old.axes;
                for (axis, old) in program.axes.iter_mut().zip(&heats) {
                    axis.inherit_heat(old);
                }
            }
            _ => {
                self.homed = false;
                self.polarity_known = false;
                self.first_index = [None; MAX_JOINTS];
            }
        }
        self.program.replace(program)
    }

    fn set_rules(&mut self, rules: Rules) -> Result<(), Refusal> {
        let off = matches!(self.state, State::Disarmed | State::Fault);
        if !off && !rules.limits.no_higher_than(&self.rules.limits) {
            return Err(Refusal::Armed);
        }
        self.rules = rules;
        self.host_silent = 0.0;
        if let Some(program) = self.program.as_mut() {
            program.controller.set_passivity(rules.passivity);
        }
        Ok(())
    }

    fn home(&mut self) -> Result<(), Refusal> {
        self.must_be_off()?;
        let program = self.program.as_mut().ok_or(Refusal::NoDevice)?;
        let home = program.home.ok_or(Refusal::NoHome)?;
        if self.frame.qd.iter().any(|speed| speed.abs() > REST_SPEED) {
            return Err(Refusal::Moving);
        }
        program.controller.home(&self.frame.counts, &home);
        self.homed = true;
        self.first_index = [None; MAX_JOINTS];
        Ok(())
    }

    fn must_be_off(&self) -> Result<(), Refusal> {
        match (self.state, self.fault) {
            (State::Armed | State::CheckingPolarity, _) => Err(Refusal::Armed),
            (_, Some(record)) => Err(Refusal::Faulted(record.fault)),
            _ => Ok(()),
        }
    }

    /// What arming and the polarity check both need.
    fn ready(&self) -> Result<&P, Refusal> {
        self.must_be_off()?;
        let program = self.program.as_ref().ok_or(Refusal::NoDevice)?;
        if let Some(refusal) = program.unarmable {
            return Err(refusal);
        }
        if self.hardware.real && !self.homed {
            return Err(Refusal::NotHomed);
        }
        let bus = self.frame.bus_voltage;
        if self.hardware.bus_sensed && !(self.rules.limits.bus_min..=self.rules.limits.bus_max).contains(&bus) {
            return Err(Refusal::BusVoltage);
        }
        for (i, limits) in program.limits.iter().enumerate().take(program.joints) {
            if let Some((low, high)) = limits
                && !(*low..=*high).contains(&self.frame.q[i])
            {
                return Err(Refusal::OutsideLimits(i as u8));
            }
        }
        Ok(program)
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        let program = self.ready()?;
        if self.hardware.real && !self.polarity_known {
            return Err(Refusal::PolarityUnchecked);
        }
        if program.controller.inside_a_wall(&self.frame.counts) {
            return Err(Refusal::InsideWall);
        }
        self.ramp = 0.0;
        self.power = 0.0;
        self.host_silent = 0.0;
        self.still = [0.0; MAX_JOINTS];
        self.lost = [0.0; MAX_JOINTS];
        self.state = State::Armed;
        Ok(())
    }

    fn start_polarity_check(&mut self) -> Result<(), Refusal> {
        self.ready()?;
        self.polarity = Polarity { axis: 0, seconds: 0.0, from: self.frame.q[0] };
        self.polarity_known = false;
        self.host_silent = 0.0;
        self.state = State::CheckingPolarity;
        Ok(())
    }

    /// Sets each motor's current from the step's torques.
    #[inline(always)]
    fn drive(&mut self) {
        match self.state {
            State::Armed => {
                self.ramp = (self.ramp + self.period * (1.0 / ARM_SECONDS)).min(1.0);
                let ramp = self.ramp;
                self.command(|_, torque| torque * ramp);
            }
            State::CheckingPolarity => self.check_polarity(),
            State::Disarmed | State::Fault => self.frame.torque = [0.0; MAX_JOINTS],
        }
    }

    /// Commands `torque(axis, what the controller wants)` within limits, and records what is left of it.
    #[inline(always)]
    fn command(&mut self, torque: impl Fn(usize, f32) -> f32) {
        let Some(program) = self.program.as_mut() else { return };
        let joints = program.joints;
        for (i, axis) in program.axes.iter_mut().enumerate().take(joints) {
            let bound = self.rules.limits.torque[i];
            let wanted = torque(i, self.frame.torque[i]).max(-bound).min(bound);
            let current = axis.command(wanted, self.frame.qd[i]);
            self.frame.torque[i] = axis.torque_of(current);
            if !self.hardware.bridge.current_sensed {
                self.frame.current[i] = current;
            }
        }
    }

    fn check_polarity(&mut self) {
        let Some((joints, most)) = self.program.as_ref().map(|p| (p.joints, p.axes.map(|axis| axis.max_torque())))
        else {
            return;
        };
        let i = self.polarity.axis.min(MAX_JOINTS - 1);
        let moved = self.frame.q[i] - self.polarity.from;
        if moved > POLARITY_MOTION {
            if i + 1 >= joints {
                self.off();
                self.state = State::Disarmed;
                self.polarity_known = true;
            } else {
                self.polarity = Polarity { axis: i + 1, seconds: 0.0, from: self.frame.q[i + 1] };
                self.command(|_, _| 0.0);
            }
            return;
        }
        if moved < -POLARITY_MOTION {
            return self.trip(Fault::PolarityWrong, Some(i as u8), moved);
        }
        self.polarity.seconds += self.period;
        if self.polarity.seconds > 2.0 * POLARITY_SECONDS {
            return self.trip(Fault::PolarityNoMotion, Some(i as u8), moved);
        }
        let share = POLARITY_SHARE * (self.polarity.seconds * (1.0 / POLARITY_SECONDS)).min(1.0);
        self.command(|axis, _| if axis == i { share * most[i] } else { 0.0 });
    }

    /// Looks for everything that must turn the motors off.
    #[inline(always)]
    fn watch(&mut self, samples: &Samples, regularity: &crate::mechanism::Regularity<f32>) {
        let Some(program) = self.program.as_mut() else { return };
        let joints = program.joints;
        let mut found: Option<(Fault, Option<u8>, f32)> = None;
        let mut note = |fault: Fault, axis: Option<usize>, value: f32| {
            if found.is_none() {
                found = Some((fault, axis.map(|i| i as u8), value));
            }
        };
        let active = matches!(self.state, State::Armed | State::CheckingPolarity);
        let mut power = 0.0;
        let mut sum = self.frame.wall_force + self.frame.normal_velocity + samples.bus_voltage;
        for i in 0..joints.min(MAX_JOINTS) {
            let (q, qd, torque) = (self.frame.q[i], self.frame.qd[i], self.frame.torque[i]);
            sum += q + qd + torque + samples.currents[i];
            power += torque * qd;
            let moved = samples.counts[i].wrapping_sub(self.last_counts[i]);
            let speed_limit = self.rules.limits.speed[i];
            // A jump is a step that even five times the speed limit cannot explain, and more than noise of a count.
            let jump = (moved.unsigned_abs() as f32) * program.counts_scale[i];
            if self.primed && moved.unsigned_abs() > 4 && jump > 5.0 * speed_limit * self.period {
                note(Fault::EncoderJump, Some(i), moved as f32);
            }
            if active {
                if qd.abs() > speed_limit {
                    note(Fault::SpeedLimit, Some(i), qd);
                }
                if let Some((low, high)) = program.limits[i]
                    && (q < low || q > high)
                {
                    note(Fault::JointLimit, Some(i), q);
                }
                let axis = &mut program.axes[i];
                let current = if self.hardware.bridge.current_sensed {
                    self.frame.current[i] = samples.currents[i];
                    samples.currents[i]
                } else {
                    self.frame.current[i]
                };
                // The loop may overshoot a little; half again as much as the limit is not the loop.
                if current.abs() > 1.5 * axis.max_current() + 1.0 {
                    note(Fault::OverCurrent, Some(i), current);
                }
                if axis.heat(current, self.period) {
                    note(Fault::ThermalBudget, Some(i), current);
                }
                if moved != 0 {
                    self.still[i] = 0.0;
                } else if torque.abs() > 0.8 * axis.max_torque() && axis.max_torque() > 0.0 {
                    self.still[i] += self.period;
                    if self.still[i] > STALL_SECONDS {
                        note(Fault::EncoderStall, Some(i), self.still[i]);
                    }
                }
                // Voltage across the motor less R i is its back-EMF: when that says several rad/s, counts must move.
                if self.hardware.bridge.current_sensed {
                    let turning = axis.speed_of(self.frame.duty[i], samples.bus_voltage, current);
                    let suspicious = moved == 0 && turning.abs() > 0.25 * speed_limit;
                    self.lost[i] = if suspicious { self.lost[i] + self.period } else { 0.0 };
                    if self.lost[i] > LOSS_SECONDS {
                        note(Fault::EncoderLoss, Some(i), turning);
                    }
                }
            }
            let period = self.rules.index_period[i];
            if let (Some(count), true) = (samples.index[i], period > 0) {
                match self.first_index[i] {
                    None => self.first_index[i] = Some(count),
                    Some(first) => {
                        let off = count.wrapping_sub(first).checked_rem(period).unwrap_or(0);
                        let off = off.abs().min(period - off.abs());
                        // An index pulse is up to four counts wide.
                        if off > 4 {
                            note(Fault::IndexMismatch, Some(i), off as f32);
                        }
                    }
                }
            }
        }
        if active {
            // Mean power into the hand: what the torques do on the joints, smoothed over POWER_SECONDS.
            self.power += (power - self.power) * (self.period * (1.0 / POWER_SECONDS));
            if self.power > self.rules.limits.power {
                note(Fault::PowerLimit, None, self.power);
            }
            if regularity.parallel < SINGULAR_SINE {
                note(Fault::Singularity, None, regularity.parallel);
            }
            if self.hardware.bus_sensed {
                if samples.bus_voltage < self.rules.limits.bus_min {
                    note(Fault::BusUnderVoltage, None, samples.bus_voltage);
                }
                if samples.bus_voltage > self.rules.limits.bus_max {
                    note(Fault::BusOverVoltage, None, samples.bus_voltage);
                }
            }
            if self.rules.host_action != HostAction::Ignore && self.host_silent > self.rules.host_seconds {
                if self.rules.host_action == HostAction::Disarm {
                    note(Fault::HostLost, None, self.host_silent);
                } else if self.fault.is_none() {
                    let record = FaultRecord {
                        fault: Fault::HostLost,
                        axis: None,
                        value: self.host_silent,
                        step: self.frame.step,
                    };
                    self.fault = Some(record);
                }
            }
        }
        // One check for all: a sum of finite numbers this small can only be infinite or NaN if one of them is.
        if !sum.is_finite() {
            found = Some((Fault::NotFinite, None, sum));
        }
        if let Some((fault, axis, value)) = found {
            // While the motors are off only lost counts and broken numbers matter; they end homing as well.
            self.trip(fault, axis, value);
            if matches!(fault, Fault::EncoderJump | Fault::EncoderLoss | Fault::IndexMismatch) {
                self.homed = false;
            }
        }
    }
}
