//! The maker's description of a device: the contents of a device file in SI units.
//!
//! The host reads a description from a TOML file. Each mechanism computes its minimal coefficients from it once.

use crate::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use crate::model::motor::Motor;

/// Description of a complete device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Kind of mechanism. Its [`Spec`](crate::model::catalogue::Spec) gives the number of valid entries per field.
    pub kind: Kind,
    /// Gravity in the task frame, m/s²; the first `task` entries are valid.
    pub gravity: [f64; 3],
    /// Geometry: the values of all keys in the order of `Spec::geometry`. Lengths are in m; signs have no unit.
    pub geometry: [f64; MAX_GEOMETRY],
    /// Links in the mechanism's order.
    pub links: [Link; MAX_LINKS],
    /// Actuated joints, joint 0 first.
    pub joints: [Joint; MAX_JOINTS],
    /// Point mass at the tip, kg.
    pub handle_mass: f64,
    /// Joint angles that homing assigns, rad.
    pub home: Option<[f64; MAX_JOINTS]>,
}

impl Description {
    /// Returns the device without the inertia of motors behind a transmission.
    pub fn link_side(&self) -> Self {
        let mut links = *self;
        for joint in &mut links.joints {
            if let Some(transmission) = joint.transmission {
                // Rounding must not make the inertia negative if the complete inertia is on the motor's side.
                joint.inertia = (joint.inertia - transmission.motor_inertia).max(0.0);
            }
        }
        links
    }

    /// Returns true if any joint has a compliant transmission or a structural mode.
    pub fn is_flexible(&self) -> bool {
        self.joints.iter().any(|joint| joint.transmission.is_some() || joint.structural_modes().next().is_some())
    }
}

/// One rigid link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Link {
    /// Mass, kg.
    pub mass: f64,
    /// Distance of the centre of mass from the proximal joint along the link, m; negative behind the joint.
    pub com: f64,
    /// Inertia about the centre of mass, normal to the linkage plane, kg m².
    pub inertia: f64,
    /// Inertia about the link's own axis, kg m².
    pub inertia_axial: f64,
    /// Inertia about an axis in the linkage plane, across the link, kg m².
    pub inertia_transverse: f64,
}

/// One actuated joint with its motor and encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// Inertia of the rotor (and of the body, on a turret or a paddle) about the joint, kg m².
    pub inertia: f64,
    /// Viscous friction, N m s/rad.
    pub viscous: f64,
    /// Coulomb friction, N m.
    pub coulomb: f64,
    /// Allowed angles (low, high), rad.
    pub limits: Option<(f64, f64)>,
    /// Encoder; required by a board.
    pub encoder: Option<Encoder>,
    /// Motor; required by a board.
    pub motor: Option<Motor<f64>>,
    /// Transmission between motor and link; `None` if it is rigid.
    pub transmission: Option<Transmission>,
    /// True if the description states that motor and link are connected rigidly.
    pub rigid: bool,
    /// Dry friction that is larger at rest than in motion.
    pub friction: Option<Stribeck>,
    /// Cogging torque of the motor's magnets, without current.
    pub cogging: Option<Cogging>,
    /// Structural modes of the link.
    pub modes: [Option<StructuralMode>; MAX_MODES],
}

/// Maximum number of structural modes of a joint.
pub const MAX_MODES: usize = 2;

/// Dry friction that falls from `rest` to the Coulomb friction as the speed grows: coulomb + (rest - coulomb)
/// exp(-(speed/stribeck_speed)²). Acts on the same side as `coulomb`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stribeck {
    /// Friction torque at rest, N m; at least the Coulomb friction.
    pub rest: f64,
    /// Speed at which the excess over Coulomb friction has fallen to 1/e, rad/s; positive.
    pub stribeck_speed: f64,
}

/// A torque that is periodic in the motor angle, amplitude sin(per_turn θ), on the motor's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cogging {
    /// Amplitude, N m at the joint.
    pub amplitude: f64,
    /// Number of periods in a turn of the joint.
    pub per_turn: f64,
}

/// A structural mode: a part of the joint's link that oscillates on a spring. Given by its effective inertia with the
/// joint held still (docs/model.md section 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StructuralMode {
    /// Undamped frequency with the joint held still, Hz.
    pub frequency: f64,
    /// Damping ratio; not negative.
    pub damping: f64,
    /// Part of the inertia about the joint that oscillates, kg m²; positive.
    pub inertia: f64,
}

impl StructuralMode {
    /// Returns the stiffness of the mode's spring, N m/rad.
    pub fn stiffness(&self) -> f64 {
        let omega = core::f64::consts::TAU * self.frequency;
        self.inertia * omega * omega
    }

    /// Returns the damping of the mode's damper, N m s/rad.
    pub fn viscous(&self) -> f64 {
        2.0 * self.damping * self.inertia * core::f64::consts::TAU * self.frequency
    }
}

impl Joint {
    /// Returns the dry friction at a speed (rad/s), N m.
    pub fn dry_friction(&self, speed: f64) -> f64 {
        self.friction.map_or(self.coulomb, |friction| {
            let over = speed / friction.stribeck_speed;
            self.coulomb + (friction.rest - self.coulomb) * libm::exp(-over * over)
        })
    }

    /// Returns the structural modes of the joint.
    pub fn structural_modes(&self) -> impl Iterator<Item = StructuralMode> + '_ {
        self.modes.iter().flatten().copied()
    }
}

/// A compliant belt, cable, gear or shaft. Motor and link are two bodies joined by a spring. All values are referred to
/// the joint (docs/model.md section 4). The joint's viscous and Coulomb friction act on the motor's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission {
    /// Stiffness, N m/rad; positive.
    pub stiffness: f64,
    /// Damping, N m s/rad; not negative.
    pub damping: f64,
    /// Part of the joint's inertia on the motor's side, kg m²; positive.
    pub motor_inertia: f64,
    /// Side of the encoder.
    pub encoder_at: EncoderAt,
}

/// The side of a transmission that an encoder measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EncoderAt {
    /// Motor side.
    #[default]
    Motor,
    /// Link side.
    Joint,
}

/// An incremental encoder, referred to the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Counts per turn of the joint, after x4 decoding.
    pub counts_per_turn: f64,
    /// Joint angle at count 0 after homing, rad.
    pub offset: f64,
    /// True if the count falls as the angle grows.
    pub inverted: bool,
}

/// Reason why a description is not a valid device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptionError {
    /// The description is for another mechanism than the requested one.
    WrongKind,
    /// A geometry value that must be positive is not. Holds the value's index.
    GeometryNotPositive(usize),
    /// No joint angles close the linkage.
    CannotClose,
    /// `assembly` is neither 1 nor -1.
    Assembly,
    /// This mechanism cannot have gravity (a paddle's gravity must be zero).
    GravityNotZero,
    /// The mass matrix would not be positive definite, because some joint moves without inertia.
    NoInertia,
    /// A number is infinite or NaN.
    NotFinite,
    /// A mass, inertia or friction coefficient is negative.
    Negative,
}

impl core::fmt::Display for DescriptionError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::WrongKind => f.write_str("the description is for another mechanism"),
            Self::GeometryNotPositive(_) => f.write_str("a length must be greater than zero"),
            Self::CannotClose => f.write_str("this geometry cannot close: no joint angles bring the links together"),
            Self::Assembly => f.write_str("assembly must be 1 or -1"),
            Self::GravityNotZero => f.write_str("gravity must be zero for this mechanism"),
            Self::NoInertia => {
                f.write_str("a joint would move without any inertia: give it a rotor inertia, or its links a mass")
            }
            Self::NotFinite => f.write_str("every number must be finite"),
            Self::Negative => f.write_str("masses, inertias and friction must not be negative"),
        }
    }
}

impl core::error::Error for DescriptionError {}
