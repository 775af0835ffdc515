//! A device as its maker describes it: what a device file holds, in SI units, before anything is precomputed.
//!
//! The host fills it from a TOML file; each mechanism lumps it into its own minimal coefficients once.

use crate::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use crate::model::motor::Motor;

/// A whole device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Which mechanism; its [`Spec`](crate::model::catalogue::Spec) says how many entries of the arrays below count.
    pub kind: Kind,
    /// Gravity in the task frame, m/s²; the first `task` entries count.
    pub gravity: [f64; 3],
    /// The mechanism's geometry, its keys flattened in the order of its `Spec::geometry`; metres, signs unitless.
    pub geometry: [f64; MAX_GEOMETRY],
    /// The links in the mechanism's order.
    pub links: [Link; MAX_LINKS],
    /// The actuated joints, joint 0 first.
    pub joints: [Joint; MAX_JOINTS],
    /// Point mass at the tip, kg.
    pub handle_mass: f64,
    /// The pose that homing declares the device to be in, rad.
    pub home: Option<[f64; MAX_JOINTS]>,
}

impl Description {
    /// The links' side of the transmissions: the same device without its motors' inertia where there is one.
    pub fn link_side(&self) -> Self {
        let mut links = *self;
        for joint in &mut links.joints {
            if let Some(transmission) = joint.transmission {
                // Rounding must not make a joint whose inertia is all on the motor's side negative.
                joint.inertia = (joint.inertia - transmission.motor_inertia).max(0.0);
            }
        }
        links
    }

    /// Returns true if any joint has a transmission that gives or a structural mode.
    pub fn is_flexible(&self) -> bool {
        self.joints.iter().any(|joint| joint.transmission.is_some() || joint.structural_modes().next().is_some())
    }
}

/// One rigid link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Link {
    /// kg
    pub mass: f64,
    /// Distance of the centre of mass along the link from its proximal joint, m; negative behind it.
    pub com: f64,
    /// About the centre of mass, normal to the linkage plane, kg m².
    pub inertia: f64,
    /// About the link's own axis, kg m².
    pub inertia_axial: f64,
    /// In the linkage plane, across the link, kg m².
    pub inertia_transverse: f64,
}

/// One actuated joint with its motor and encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// Rotor (and body, on a turret or a paddle) reflected to the joint, kg m².
    pub inertia: f64,
    /// Viscous friction, N m s/rad.
    pub viscous: f64,
    /// Coulomb friction, N m.
    pub coulomb: f64,
    /// Allowed angles (low, high), rad.
    pub limits: Option<(f64, f64)>,
    /// The encoder, when the device is to run on a board.
    pub encoder: Option<Encoder>,
    /// The motor, when the device is to run on a board.
    pub motor: Option<Motor<f64>>,
    /// The transmission between motor and link, where it is not rigid.
    pub transmission: Option<Transmission>,
    /// The description vouches that nothing gives between motor and link.
    pub rigid: bool,
    /// Dry friction beyond `coulomb`, where there is more of it at rest than in motion.
    pub friction: Option<Stribeck>,
    /// The cogging of the motor's magnets, without current.
    pub cogging: Option<Cogging>,
    /// The mode that swings on the link.
    pub modes: [Option<StructuralMode>; MAX_MODES],
}

/// Structural modes of a joint at most.
pub const MAX_MODES: usize = 2;

/// Dry friction that falls from its value at rest to the Coulomb friction as the joint moves:
/// coulomb + (rest - coulomb) exp(-(speed/stribeck_speed)²). It acts where `coulomb` acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stribeck {
    /// The torque that holds the joint at rest, N m; at least the Coulomb friction.
    pub rest: f64,
    /// At which speed most of the difference is gone, rad/s; positive.
    pub stribeck_speed: f64,
}

/// A torque that turns with the motor: amplitude sin(per_turn θ), on the motor's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cogging {
    /// N m at the joint.
    pub amplitude: f64,
    /// Periods in a turn of the joint.
    pub per_turn: f64,
}

/// A part of the joint's link that swings on a spring: a structural mode by its effective inertia, as seen with the joint
/// held still (docs/model.md section 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StructuralMode {
    /// Hz, undamped, with the joint held still.
    pub frequency: f64,
    /// Share of critical damping, not negative.
    pub damping: f64,
    /// The part of the inertia about the joint that swings, kg m²; positive.
    pub inertia: f64,
}

impl StructuralMode {
    /// Stiffness of its spring, N m/rad.
    pub fn stiffness(&self) -> f64 {
        let omega = core::f64::consts::TAU * self.frequency;
        self.inertia * omega * omega
    }

    /// Of its damper, N m s/rad.
    pub fn viscous(&self) -> f64 {
        2.0 * self.damping * self.inertia * core::f64::consts::TAU * self.frequency
    }
}

impl Joint {
    /// Dry friction at a speed (rad/s), N m.
    pub fn dry_friction(&self, speed: f64) -> f64 {
        self.friction.map_or(self.coulomb, |friction| {
            let over = speed / friction.stribeck_speed;
            self.coulomb + (friction.rest - self.coulomb) * libm::exp(-over * over)
        })
    }

    /// The structural modes that there are.
    pub fn structural_modes(&self) -> impl Iterator<Item = StructuralMode> + '_ {
        self.modes.iter().flatten().copied()
    }
}

/// A belt, cable, gear or shaft that gives: motor and link are two bodies with a spring between them, all seen at the
/// joint (docs/model.md section 4). A joint's viscous and Coulomb friction act on the motor's side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission {
    /// N m/rad, positive.
    pub stiffness: f64,
    /// N m s/rad, not negative.
    pub damping: f64,
    /// The part of the joint's inertia that is on the motor's side, kg m²; positive.
    pub motor_inertia: f64,
    /// Which side the encoder is on.
    pub encoder_at: EncoderAt,
}

/// The side of a transmission that an encoder measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EncoderAt {
    /// The motor's.
    #[default]
    Motor,
    /// The link's.
    Joint,
}

/// An incremental encoder as seen at the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Counts per turn of the joint, after x4 decoding.
    pub counts_per_turn: f64,
    /// Joint angle at count 0 after homing, rad.
    pub offset: f64,
    /// Counts fall when the angle grows.
    pub inverted: bool,
}

/// Why a description cannot be a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptionError {
    /// The description is of another mechanism than the one asked for.
    WrongKind,
    /// A number that must be positive is not; the index of the geometry entry.
    GeometryNotPositive(usize),
    /// No joint angles bring the linkage together.
    CannotClose,
    /// `assembly` is neither 1 nor -1.
    Assembly,
    /// This mechanism cannot carry the weight it would feel (a paddle's gravity must be zero).
    GravityNotZero,
    /// The mass matrix would not be positive definite: some joint moves without any inertia.
    NoInertia,
    /// A number is infinite or NaN.
    NotFinite,
    /// A mass, inertia or friction coefficient is negative.
    Negative,
}

impl core::fmt::Display for DescriptionError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::WrongKind => f.write_str("the description is of another mechanism"),
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
