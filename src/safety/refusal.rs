//! Refusals of requests, each with its remedy.

use crate::safety::fault::{CLEARING, Fault};
use crate::safety::limits::BadLimit;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Reason why the board did not carry out a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// No device is loaded.
    NoDevice,
    /// No scene is loaded.
    NoScene,
    /// The device has more joints than the board has axes.
    TooManyJoints {
        /// Joints of the device.
        joints: u8,
        /// Axes of the board.
        axes: u8,
    },
    /// The device's numbers cannot be used, because a number is not finite or an encoder or inertia is missing.
    BadDevice,
    /// The scene cannot be used.
    Scene(crate::render::scene::SceneError),
    /// The device file has no `[home]`.
    NoHome,
    /// The potential of a joint's motor cannot be used.
    BadCogging(u8),
    /// The device has not been homed since power-on.
    NotHomed,
    /// A joint has no limits.
    NoJointLimits(u8),
    /// A joint has no motor.
    NoMotor(u8),
    /// A motor's data are not verified.
    MotorNotVerified(u8),
    /// A joint's motor has three phases, and the board's bridges have two legs.
    BridgeHasTwoLegs(u8),
    /// A joint's motor has three phases, and the board does not measure currents.
    NoCurrentSensor(u8),
    /// A joint's encoder is too coarse for the poles of its motor.
    EncoderTooCoarse(u8),
    /// A joint's absolute encoder has not sent its angle.
    EncoderSilent(u8),
    /// The polarity has not been checked with this device and its present home.
    PolarityUnchecked,
    /// A joint is outside its limits.
    OutsideLimits(u8),
    /// The tip is inside a wall.
    InsideWall,
    /// The device is not at rest.
    Moving,
    /// A fault is latched.
    Faulted(Fault),
    /// The motors must be off for the request.
    Armed,
    /// The bus voltage is out of range.
    BusVoltage,
    /// A limit exceeds the board's abilities.
    BadLimit(BadLimit),
    /// The pose is singular.
    Singular,
    /// The board is busy with another request of this kind.
    Busy,
    /// Another tool controls the board.
    HeldByAnother,
    /// The entry of a setting is damaged or has another version.
    BadEntry,
    /// Writing to flash failed.
    Flash,
    /// This board does not support the request.
    NotSupported,
    /// The flash failed during a change, so that the old or the new settings apply after the next start.
    Unsettled,
    /// The last press of the dead man's key is too old.
    KeyTooOld,
    /// The rules have no index period for a joint that is homed by its index mark.
    NoIndexPeriod(u8),
    /// A joint has not yet passed its index mark slowly.
    IndexUnseen(u8),
    /// The index mark of a joint fits several turns of the encoder within the joint's limits.
    IndexAmbiguous(u8),
    /// No turn of the encoder puts the index mark and all angles since within a joint's limits.
    IndexOutside(u8),
    /// The device is not homed by stops.
    NoStops,
    /// The device's joints have not touched their stops since the home pose was declared.
    StopsUntouched,
    /// The board has too few encoder inputs for the device's joints and encoders without motors.
    TooManySensed {
        /// Encoders of the device without motors.
        sensed: u8,
        /// Encoder inputs of the board.
        inputs: u8,
        /// Encoder inputs that the device's joints leave.
        left: u8,
    },
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoDevice => f.write_str("no device is loaded: `haptic device FILE` first"),
            Self::NoScene => f.write_str("no scene is loaded: `haptic scene FILE` first"),
            Self::TooManyJoints { joints, axes } => {
                write!(f, "the device has {joints} joints and the board {axes} axes: use a board with more")
            }
            Self::BadDevice => f.write_str("the device's numbers cannot be used: check encoders and inertias"),
            Self::Scene(error) => write!(f, "{error}"),
            Self::NoHome => f.write_str("the device file has no [home]: add the joint angles of the home pose"),
            Self::BadCogging(joint) => write!(
                f,
                "the cogging of joint {joint} cannot be compensated: its numbers are not finite, or its torque is more than a \
                 quarter of the motor's: check `torque_constant` and `max_current`"
            ),
            Self::NotHomed => f.write_str("the device is not homed: hold it in its home pose and run `haptic home`"),
            Self::NoJointLimits(joint) => {
                write!(f, "joint {joint} has no limits in the device file: a real device needs them")
            }
            Self::NoMotor(joint) => write!(f, "joint {joint} has no [joint.motor] or encoder in the device file"),
            Self::MotorNotVerified(joint) => write!(
                f,
                "the motor of joint {joint} is not verified: check its numbers, `inductance` among them, then set `verified = true` in the device file"
            ),
            Self::BridgeHasTwoLegs(joint) => write!(
                f,
                "the motor of joint {joint} is brushless, and this board's bridges have two legs: use a board whose bridges have three"
            ),
            Self::NoCurrentSensor(joint) => write!(
                f,
                "the motor of joint {joint} is brushless, and this board measures no current: use a board that does"
            ),
            Self::EncoderTooCoarse(joint) => write!(
                f,
                "the encoder of joint {joint} has fewer than 60 counts per electrical turn: use a finer one, or check `pole_pairs` and `ratio`"
            ),
            Self::EncoderSilent(joint) => {
                write!(f, "the absolute encoder of joint {joint} sends no valid angle: check its wires and its magnet")
            }
            Self::PolarityUnchecked => {
                f.write_str("motor polarity has not been checked with this device and this home: run `haptic polarity`")
            }
            Self::OutsideLimits(joint) => write!(f, "joint {joint} is outside its limits: move it back by hand"),
            Self::InsideWall => f.write_str("the tip is inside a wall: move it out by hand"),
            Self::Moving => f.write_str("the device is moving: hold it still"),
            Self::Faulted(fault) => {
                write!(f, "{fault}; {}", fault.remedy())?;
                // Some remedies already end with the clearing command.
                match fault.remedy().contains(CLEARING) {
                    true => Ok(()),
                    false => f.write_str("; then `haptic faults --clear`"),
                }
            }
            Self::Armed => f.write_str("the motors are armed: `haptic disarm` first"),
            Self::BusVoltage => f.write_str("the supply voltage is out of range: check the supply"),
            Self::BadLimit(bad) => write!(f, "{bad}"),
            Self::Singular => f.write_str("the linkage is in a singular pose: move it by hand"),
            Self::Busy => f.write_str("the board is busy with an earlier request: try again"),
            Self::HeldByAnother => f.write_str("another tool controls the board: close that tool first"),
            Self::BadEntry => f.write_str("this setting is damaged or of another version: use the tool's own restore"),
            Self::Flash => f.write_str("writing to flash failed: try again; the old settings are kept"),
            Self::Unsettled => f.write_str(
                "the flash failed in the middle of a change: the old settings apply until the next start, which \
                 shows if the old or the new settings were kept",
            ),
            Self::NotSupported => f.write_str("this board does not support the request"),
            Self::TooManySensed { sensed, inputs, left } => write!(
                f,
                "the board has {inputs} encoder inputs, of which the device's joints leave {left} for its {sensed} \
                 [[sensed]]: remove those that it cannot read"
            ),
            Self::KeyTooOld => f.write_str(
                "the press of the key arrived too late: press it again; if that happens again, the page, the network or \
                 the computer between key and board is too slow",
            ),
            Self::NoIndexPeriod(joint) => write!(
                f,
                "the index mark of joint {joint} has no period: `haptic rules --index-period` with the counts between two \
                 pulses"
            ),
            Self::IndexUnseen(joint) => {
                write!(f, "joint {joint} has not passed its index mark: move it slowly through its range while `haptic home` waits")
            }
            Self::IndexAmbiguous(joint) => write!(
                f,
                "the index mark of joint {joint} may belong to several turns of its encoder: move the joint \
                 slowly from one end of its range to the other while `haptic home` waits"
            ),
            Self::IndexOutside(joint) => write!(
                f,
                "the index mark of joint {joint} contradicts its limits: check `offset`, `limits` and the index period, \
                 then home again"
            ),
            Self::NoStops => f.write_str("the device is not homed by stops: run `haptic home` without --key"),
            Self::StopsUntouched => f.write_str(
                "the joints have not touched their stops: run `haptic polarity`, then `haptic home --key`",
            ),
        }
    }
}

impl core::error::Error for Refusal {}
