//! Why the board will not do what it was asked, each with what to do about it.

use crate::safety::fault::{CLEARING, Fault};
use crate::safety::limits::BadLimit;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Why the board will not do what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// No device has been loaded.
    NoDevice,
    /// No scene has been loaded.
    NoScene,
    /// The device has more joints than the board has axes.
    TooManyJoints {
        /// Joints of the device.
        joints: u8,
        /// Axes of the board.
        axes: u8,
    },
    /// The device's numbers cannot be used (not finite, no encoder, no inertia).
    BadDevice,
    /// The scene cannot be used.
    Scene(crate::render::scene::SceneError),
    /// The precomputed table does not fit the device or the board's memory.
    BadTable,
    /// Homing needs a device with `[home]`.
    NoHome,
    /// Not homed since power-on.
    NotHomed,
    /// A joint has no limits.
    NoJointLimits(u8),
    /// A joint has no motor.
    NoMotor(u8),
    /// A joint's motor data have not been verified.
    MotorNotVerified(u8),
    /// The polarity check has not been made with this device, homed where it is.
    PolarityUnchecked,
    /// A joint is outside its limits.
    OutsideLimits(u8),
    /// The tip is inside a wall.
    InsideWall,
    /// The device is not at rest.
    Moving,
    /// A fault is latched.
    Faulted(Fault),
    /// This needs the motors off.
    Armed,
    /// The bus voltage is out of range.
    BusVoltage,
    /// Limits may not exceed what the board can do.
    BadLimit(BadLimit),
    /// The pose is singular.
    Singular,
    /// Another request of the kind is under way.
    Busy,
    /// Another tool holds the board.
    HeldByAnother,
    /// The entry of a setting is damaged, or of another version.
    BadEntry,
    /// Writing to flash failed.
    Flash,
    /// This board cannot do that.
    NotSupported,
    /// The flash failed in the middle of a change: the next start shows the old settings or the new ones.
    Unsettled,
    /// The dead man's key that shall hold the motors on was seen down too long ago.
    KeyTooOld,
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
            Self::BadTable => f.write_str("the precomputed table does not fit this device or the board's memory"),
            Self::NoHome => f.write_str("the device file has no [home]: add the pose to home in"),
            Self::NotHomed => f.write_str("the device is not homed: hold it in its home pose and run `haptic home`"),
            Self::NoJointLimits(joint) => {
                write!(f, "joint {joint} has no limits in the device file: a real device needs them")
            }
            Self::NoMotor(joint) => write!(f, "joint {joint} has no [joint.motor] or encoder in the device file"),
            Self::MotorNotVerified(joint) => write!(
                f,
                "the motor of joint {joint} is not verified: check its numbers, `inductance` among them, then set `verified = true` in the device file"
            ),
            Self::PolarityUnchecked => {
                f.write_str("motor polarity has not been checked with this device and this home: run `haptic polarity`")
            }
            Self::OutsideLimits(joint) => write!(f, "joint {joint} is outside its limits: move it back by hand"),
            Self::InsideWall => f.write_str("the tip is inside a wall: move it out by hand"),
            Self::Moving => f.write_str("the device is moving: hold it still"),
            Self::Faulted(fault) => {
                write!(f, "{fault}; {}", fault.remedy())?;
                // Some remedies end with it.
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
            Self::HeldByAnother => f.write_str("another tool holds the board: close it first"),
            Self::BadEntry => f.write_str("this setting is damaged or of another version: use the tool's own restore"),
            Self::Flash => f.write_str("writing to flash failed: try again; the old settings are kept"),
            Self::Unsettled => f.write_str(
                "the flash failed in the middle of a change: the old settings are in force until the next start, which \
                 shows whether the old ones or the new ones were kept",
            ),
            Self::NotSupported => f.write_str("this board cannot do that"),
            Self::KeyTooOld => f.write_str(
                "the press of the key took longer to come than a key may be silent: press it anew; if that happens again, \
                 the page, the network or the computer between key and board is too slow",
            ),
        }
    }
}

impl core::error::Error for Refusal {}
