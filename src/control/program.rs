//! A device and a scene, ready to run: the controller of the loaded mechanism, and the drives of its motors.

use crate::control::frame::Now;
use crate::control::joints::{Counts, Torques};
use crate::drive::brushless::resolves;
use crate::drive::carrier::Carrier;
use crate::drive::motor_stage::MotorStage;
use crate::drive::stage::{Bridge, Stage};
use crate::math::Math;
use crate::model::catalogue::{Kind, MAX_JOINTS};
use crate::model::description::{Homing, MAX_SENSED};
use crate::model::device::{Device, Sensed};
use crate::model::mechanism::AnyMechanism;
use crate::model::motor::Motor;
use crate::model::padding::{as_joints, pad, to_joints};
use crate::model::units::JointUnits;
use crate::render::controller::{Controller, Gains, Push};
use crate::render::scene::Scene;
use crate::render::step_result::StepResult;
use crate::render::velocity::{Coefficients, Washout};
use crate::safety::limits::Limits;
use crate::safety::refusal::Refusal;
use heapless::Vec;

/// Properties of a board that the control loop needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hardware {
    /// Number of motor axes.
    pub axes: usize,
    /// Number of encoder inputs, those of the motor axes included.
    pub encoders: u8,
    /// True for real motors, which need verified data, limits, homing and a polarity check.
    pub real: bool,
    /// True if the bus voltage is measured.
    pub bus_sensed: bool,
    /// Bridges of the motors.
    pub bridge: Bridge,
    /// Clock frequency of the PWM timers, Hz.
    pub timer_hz: u32,
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        /// Controller of the loaded mechanism, in the board's precision.
        #[derive(Clone, Debug)]
        #[allow(clippy::large_enum_variant, reason = "a program is stored in place, with room for the largest")]
        pub enum AnyController<K> {
            $(
                #[doc = concat!("Controls a [`", stringify!($Variant), "`](crate::model::mechanism::", stringify!($Variant), ").")]
                $Variant(Controller<f32, crate::model::mechanism::$Variant<f32>, K, $n>),
            )*
        }

        impl<K: Math<f32>> AnyController<K> {
            /// Builds the run-time form of a device and a scene. Designs filters, so it is too slow for the interrupt.
            pub fn new(device: &Device<f32>, scene: &Scene<f32>) -> Result<Self, Refusal> {
                match &device.mechanism {
                    $(crate::model::mechanism::AnyMechanism::$Variant(mechanism) => {
                        Controller::new(*mechanism, device, scene).map(Self::$Variant).map_err(Refusal::Scene)
                    })*
                }
            }

            /// Returns the kind of mechanism.
            pub fn kind(&self) -> Kind {
                match self { $(Self::$Variant(_) => Kind::$Variant,)* }
            }

            /// Runs one control step and writes all of `found` except joint angles. `acted` holds the last torques, N
            /// m.
            #[inline(always)]
            pub(crate) fn render(&mut self, counts: &Counts, acted: &Torques, found: &mut StepResult<f32>) {
                match self {
                    // No device has more joints than `counts` has entries.
                    $(Self::$Variant(controller) => {
                        controller.render(as_joints(counts).unwrap_or(&[0; $n]), acted, found);
                    })*
                }
            }

            /// Writes the joint angles, see [`Controller::angles`].
            pub(crate) fn angles(&self, counts: &Counts, found: &mut StepResult<f32>) {
                match self { $(Self::$Variant(controller) => controller.angles(as_joints(counts).unwrap_or(&[0; $n]), found),)* }
            }

            /// Sets the home pose, see [`Controller::home`].
            pub fn home(&mut self, counts: &Counts, q: &[f32; MAX_JOINTS]) {
                match self { $(Self::$Variant(controller) => controller.home(&to_joints(counts), &to_joints(q)),)* }
            }

            /// Returns the counts that homing subtracts.
            pub fn zero(&self) -> Counts {
                match self { $(Self::$Variant(controller) => Counts(pad(&controller.zero())),)* }
            }

            /// Sets the counts that homing subtracts.
            pub fn set_zero(&mut self, zero: &Counts) {
                match self { $(Self::$Variant(controller) => controller.set_zero(to_joints(zero)),)* }
            }

            /// Returns true if the tip is inside a wall, see [`Controller::is_inside_wall`].
            pub fn is_inside_wall(&self, counts: &Counts) -> bool {
                match self {
                    $(Self::$Variant(controller) => controller.is_inside_wall(&to_joints(counts)),)*
                }
            }

            /// Sets the host's push, see [`Controller::set_push`].
            pub fn set_push(&mut self, push: Option<&Push<f32>>) {
                match self { $(Self::$Variant(controller) => controller.set_push(push),)* }
            }

            /// Returns the tip velocity (m/s) and the force of the host's push (N) at the last step, see
            /// [`Controller::velocity_and_push`].
            pub(crate) fn velocity_and_push(&self, now: &Now) -> ([f32; MAX_JOINTS], [f32; MAX_JOINTS]) {
                match self {
                    $(Self::$Variant(controller) => {
                        let (velocity, force) = controller.velocity_and_push(&to_joints(&now.counts), &to_joints(&now.result.at.qd).into());
                        (pad(&velocity.data.0[0]), pad(&force.data.0[0]))
                    })*
                }
            }

            /// Sets the gains of a wall, see [`Controller::set_gains`].
            pub fn set_gains(&mut self, gains: &Gains<f32>, washout: &Washout<f32>) {
                match self { $(Self::$Variant(controller) => controller.set_gains(gains, washout),)* }
            }

            /// Sets the coefficients of the velocity estimators, see [`Controller::set_coefficients`].
            pub fn set_coefficients(&mut self, coefficients: &Coefficients<f32>) {
                match self { $(Self::$Variant(controller) => controller.set_coefficients(coefficients),)* }
            }

            /// Sets the passivity controller, see [`Controller::set_passivity`].
            pub fn set_passivity(&mut self, on: bool, shown: bool) {
                match self { $(Self::$Variant(controller) => controller.set_passivity(on, shown),)* }
            }
        }
    };
}
crate::mechanisms!(define);

/// Returns an error if a board cannot commutate the three-phase motor of joint `index`.
fn commutation_refusal(bridge: &Bridge, motor: &Motor<f32>, scale: f32, index: u8) -> Result<(), Refusal> {
    if bridge.legs < 3 {
        return Err(Refusal::BridgeHasTwoLegs(index));
    }
    if !bridge.current_sensed {
        return Err(Refusal::NoCurrentSensor(index));
    }
    // Written so that NaN is an error.
    match motor.electrical_ratio().is_some_and(|ratio| resolves(ratio * scale)) {
        true => Ok(()),
        false => Err(Refusal::EncoderTooCoarse(index)),
    }
}

/// A device and a scene compiled for the control loop. `S` is the motor stage between a joint's torque and its motor.
#[derive(Clone, Debug)]
pub struct Program<K, S = MotorStage> {
    pub(crate) controller: AnyController<K>,
    pub(crate) mechanism: AnyMechanism<f32>,
    /// Initial state of the motor stages.
    pub(crate) axes: [S; MAX_JOINTS],
    /// True if gravity is compensated.
    pub(crate) compensates_weight: bool,
    pub(crate) joints: usize,
    pub(crate) limits: [Option<(f32, f32)>; MAX_JOINTS],
    pub(crate) home: Option<[f32; MAX_JOINTS]>,
    pub(crate) homing: Homing<f32>,
    pub(crate) radians_per_count: [f32; MAX_JOINTS],
    /// [`JointUnits::lever`] of each joint.
    pub(crate) lever: [f32; MAX_JOINTS],
    /// Coulomb friction, N m.
    pub(crate) coulomb: [f32; MAX_JOINTS],
    /// Angles at count zero, rad.
    pub(crate) offsets: [f32; MAX_JOINTS],
    /// True for each joint with an absolute encoder.
    pub(crate) absolute: [bool; MAX_JOINTS],
    /// True if absolute encoders tell all joint angles at power-on.
    pub(crate) homes_itself: bool,
    /// Angle (rad) nearest to which an absolute encoder's angle is at power-on: the middle of limits that settle it,
    /// otherwise home.
    pub(crate) nearest: [f32; MAX_JOINTS],
    /// Encoders without motors.
    pub(crate) sensed: Vec<Sensed<f32>, MAX_SENSED>,
    /// True if the device is the previous program's device, so that homing and the polarity check stay valid.
    pub(crate) same_device: bool,
    /// Reason why this program may not be armed, determined when the program is built.
    pub(crate) arming_refused: Option<Refusal>,
    pub(crate) rate_hz: f32,
    pub(crate) carrier_hz: f32,
}

impl<K: Math<f32>, S: Stage> Program<K, S> {
    /// Builds a program for `hardware` under `limits`. `same_device` keeps homing across a change of scene.
    ///
    /// Returns an error for more joints than axes, for more encoders than inputs, for a joint without encoder scale, or for an unusable scene.
    pub fn new(
        hardware: &Hardware,
        limits: &Limits,
        device: &Device<f32>,
        scene: &Scene<f32>,
        same_device: bool,
    ) -> Result<Self, Refusal> {
        let joints = device.axes();
        if joints > hardware.axes {
            return Err(Refusal::TooManyJoints { joints: joints as u8, axes: hardware.axes as u8 });
        }
        let (sensed, inputs) = (device.sensed.len() as u8, hardware.encoders);
        let left = inputs.saturating_sub(joints as u8);
        if sensed > left {
            return Err(Refusal::TooManySensed { sensed, inputs, left });
        }
        let controller = AnyController::new(device, scene)?;
        // The current loops run once per carrier period, and the carrier follows the control rate.
        let bridge =
            Bridge { carrier_hz: Carrier::for_rate(hardware.timer_hz, scene.rate_hz).carrier_hz(), ..hardware.bridge };
        let mut axes = [S::default(); MAX_JOINTS];
        let homes_itself = device.homes_itself();
        let has_home = device.home.is_some() || homes_itself;
        let mut arming_refused = if !has_home && hardware.real { Some(Refusal::NoHome) } else { None };
        for (i, joint) in device.joints.iter().enumerate().take(joints) {
            let scale = joint.radians_per_count;
            if !scale.is_finite() || scale == 0.0 {
                return Err(Refusal::BadDevice);
            }
            let index = i as u8;
            match &joint.motor {
                None => arming_refused = arming_refused.or(Some(Refusal::NoMotor(index))),
                Some(motor) => {
                    // Without an inductance the current loop and the motor's checks are not safe for a hand.
                    if hardware.real && !(motor.verified && motor.inductance > 0.0) {
                        arming_refused = arming_refused.or(Some(Refusal::MotorNotVerified(index)));
                    }
                    axes[i] = S::new(motor, &bridge, limits.current[i]);
                    axes[i].set_encoder(scale);
                    if axes[i].is_three_phase() && hardware.real {
                        commutation_refusal(&bridge, motor, scale, index)?;
                    }
                    if !hardware.real {
                        axes[i].assume_alignment(joint.offset);
                    }
                }
            }
            if hardware.real && joint.limits.is_none() {
                arming_refused = arming_refused.or(Some(Refusal::NoJointLimits(index)));
            }
        }
        Ok(Self {
            controller,
            mechanism: device.mechanism,
            axes,
            compensates_weight: scene.gravity_compensation && device.weight,
            joints,
            limits: core::array::from_fn(|i| device.joints[i].limits),
            home: device.home,
            homing: device.homing,
            radians_per_count: core::array::from_fn(|i| device.joints[i].radians_per_count),
            lever: core::array::from_fn(|i| JointUnits::of(device.mechanism.is_prismatic(i)).lever),
            coulomb: core::array::from_fn(|i| device.joints[i].coulomb),
            offsets: core::array::from_fn(|i| device.joints[i].offset),
            absolute: core::array::from_fn(|i| device.joints[i].absolute.is_some()),
            homes_itself,
            nearest: core::array::from_fn(|i| device.nearest_angle(i)),
            sensed: device.sensed.clone(),
            same_device,
            arming_refused,
            rate_hz: scene.rate_hz,
            carrier_hz: bridge.carrier_hz,
        })
    }

    /// Returns the program's controller.
    pub fn controller(&self) -> &AnyController<K> {
        &self.controller
    }

    /// Returns the control rate, Hz.
    pub fn rate_hz(&self) -> f32 {
        self.rate_hz
    }
}
