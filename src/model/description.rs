//! The maker's description of a device: the contents of a device file in SI units.
//!
//! The host reads a description from a TOML file. Each mechanism computes its minimal coefficients from it once.

use crate::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use crate::model::motor::Motor;
use crate::model::units::JointUnits;
use heapless::Vec;
use nalgebra::Matrix3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Value of a chain's task in [`Description::geometry`] for the arc length of the tip. 0, 1 and 2 are x, y and z.
pub const ARC: f64 = 3.0;

/// Description of a complete device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Kind of mechanism. Its [`Spec`](crate::model::catalogue::Spec) gives the number of valid entries per field.
    pub kind: Kind,
    /// Gravity in the task frame, m/s²; the first `Spec::gravity` entries are valid.
    pub gravity: [f64; 3],
    /// Geometry: the values of all keys in the order of `Spec::geometry`. Lengths are in m, angles in rad.
    pub geometry: [f64; MAX_GEOMETRY],
    /// Links in the mechanism's order.
    pub links: [Link; MAX_LINKS],
    /// Actuated joints, joint 0 first.
    pub joints: [Joint; MAX_JOINTS],
    /// Point mass at the tip, kg.
    pub handle_mass: f64,
    /// Joint angles that homing assigns, rad. Only rough angles unless the device is homed by hand.
    pub home: Option<[f64; MAX_JOINTS]>,
    /// Reference of homing.
    pub homing: Homing<f64>,
    /// Encoders without motors, first to last. [`Encoder::offset`] is the angle at the home pose.
    pub sensed: [Option<Encoder>; MAX_SENSED],
}

/// Reference from which homing computes the joint angles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub enum Homing<T> {
    /// A person holds the device in its home pose.
    #[default]
    Hand,
    /// Index marks of the encoders, each at its encoder's `offset`.
    Index,
    /// Mechanical stops at these joint angles (rad), each at or beyond one of its joint's limits.
    Stop([T; MAX_JOINTS]),
}

impl<T: Copy> Homing<T> {
    /// Converts the angles with `convert`.
    pub fn map<U>(self, convert: impl FnMut(T) -> U) -> Homing<U> {
        match self {
            Self::Hand => Homing::Hand,
            Self::Index => Homing::Index,
            Self::Stop(angles) => Homing::Stop(angles.map(convert)),
        }
    }
}

/// Maximum number of encoders without motors: those of a gimbal.
pub const MAX_SENSED: usize = 3;

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

    /// Returns the units of each joint.
    pub fn units(&self) -> Vec<&'static JointUnits, MAX_JOINTS> {
        self.joints.iter().take(self.kind.spec().joints).map(Joint::units).collect()
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
    /// Distance of the centre of mass from the proximal joint along the link (x), m; negative behind the joint.
    pub com: f64,
    /// Coordinates y and z of the centre of mass in the link's frame, m. Zero unless the mechanism is a chain.
    pub com_across: [f64; 2],
    /// Inertia about the centre of mass, normal to the linkage plane (izz), kg m².
    pub inertia: f64,
    /// Inertia about the link's own axis (ixx), kg m².
    pub inertia_axial: f64,
    /// Inertia about an axis in the linkage plane, across the link (iyy), kg m².
    pub inertia_transverse: f64,
    /// Entries ixy, ixz and iyz of the inertia tensor, kg m². Zero unless the mechanism is a chain.
    pub inertia_products: [f64; 3],
}

impl Link {
    /// Returns the centre of mass in the link's frame, m.
    pub fn com_vector(&self) -> [f64; 3] {
        [self.com, self.com_across[0], self.com_across[1]]
    }

    /// Returns the inertia tensor about the centre of mass, kg m².
    pub fn tensor(&self) -> Matrix3<f64> {
        let [xy, xz, yz] = self.inertia_products;
        Matrix3::new(self.inertia_axial, xy, xz, xy, self.inertia_transverse, yz, xz, yz, self.inertia)
    }

    /// Adds a point mass (kg) at `place` (m) in the link's frame.
    pub fn add_point(&mut self, mass: f64, place: [f64; 3]) {
        let total = self.mass + mass;
        if total <= 0.0 {
            return;
        }
        // Two masses at a distance d have the reduced mass times d² about their common centre.
        let (com, reduced) = (self.com_vector(), self.mass * mass / total);
        let [x, y, z]: [f64; 3] = core::array::from_fn(|i| place[i] - com[i]);
        let moved: [f64; 3] = core::array::from_fn(|i| com[i] + (place[i] - com[i]) * (mass / total));
        self.mass = total;
        (self.com, self.com_across) = (moved[0], [moved[1], moved[2]]);
        self.inertia_axial += reduced * (y * y + z * z);
        self.inertia_transverse += reduced * (x * x + z * z);
        self.inertia += reduced * (x * x + y * y);
        for (product, of) in self.inertia_products.iter_mut().zip([x * y, x * z, y * z]) {
            *product -= reduced * of;
        }
    }
}

/// Frame of a chain's joint in the frame of the link before, and its axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFrame {
    /// Origin, m.
    pub origin: [f64; 3],
    /// Roll, pitch and yaw of the rotation Rz(yaw) Ry(pitch) Rx(roll), rad.
    pub rpy: [f64; 3],
    /// Axis in the joint's frame; any length but zero.
    pub axis: [f64; 3],
}

impl JointFrame {
    /// The frame of the link before, with its z axis as the joint's axis.
    pub const SAME: Self = Self { origin: [0.0; 3], rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] };
}

impl Default for JointFrame {
    fn default() -> Self {
        Self::SAME
    }
}

/// One actuated joint with its motor and encoder. The coordinate of a prismatic joint is its travel, and every rad in
/// the units below is a m, every N m a N, and every kg m² a kg, see [`JointUnits`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joint {
    /// True if the joint slides along its axis instead of turning about it.
    pub prismatic: bool,
    /// Place and axis of the joint. Only a chain uses it.
    pub frame: JointFrame,
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
    /// Chip and place of an absolute encoder; `None` if the encoder counts from power-on.
    pub absolute: Option<AngleSensor>,
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

/// Maximum number of harmonics of a cogging torque.
pub const MAX_COGGING: usize = 4;

/// A torque that is periodic in the motor angle, Σ amplitude sin(per_turn θ + phase), on the motor's side. It is the
/// derivative of a potential, so it does no net work in a turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cogging {
    /// Harmonics; those with an amplitude of zero are absent.
    pub harmonics: [CoggingHarmonic; MAX_COGGING],
}

/// A harmonic of a cogging torque.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoggingHarmonic {
    /// Amplitude, N m at the joint.
    pub amplitude: f64,
    /// Number of periods in a turn of the joint.
    pub per_turn: f64,
    /// Phase at joint angle zero, rad.
    pub phase: f64,
}

impl Cogging {
    /// Returns the torque at a motor angle (rad), N m.
    pub fn torque(&self, angle: f64) -> f64 {
        self.present().map(|h| h.amplitude * libm::sin(h.per_turn * angle + h.phase)).sum()
    }

    /// Returns the potential energy at a motor angle (rad), J; not negative.
    pub fn energy(&self, angle: f64) -> f64 {
        self.present().map(|h| h.amplitude / h.per_turn * (1.0 + libm::cos(h.per_turn * angle + h.phase))).sum()
    }

    fn present(&self) -> impl Iterator<Item = &CoggingHarmonic> {
        self.harmonics.iter().filter(|harmonic| harmonic.amplitude != 0.0)
    }
}

/// A structural mode: a part of the joint's link that oscillates on a spring. Given by its effective inertia with the
/// joint held still (docs/model.md section 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StructuralMode {
    /// Undamped frequency with the joint held still, Hz.
    pub frequency: f64,
    /// Damping ratio; not negative.
    pub damping: f64,
    /// Oscillating part of the inertia about the joint, kg m²; positive.
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

    /// Returns the units of the joint.
    pub fn units(&self) -> &'static JointUnits {
        JointUnits::of(self.prismatic)
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum EncoderAt {
    /// Motor side.
    #[default]
    Motor,
    /// Link side.
    Joint,
}

/// Counts of an absolute encoder in a turn of its magnet.
pub const ANGLE_COUNTS: i32 = 1 << 14;

/// An absolute encoder: a chip that measures the angle of a magnet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct AngleSensor {
    /// Type of the chip.
    pub chip: AngleChip,
    /// Shaft with the magnet.
    pub at: EncoderAt,
}

/// Type of an absolute encoder with SPI frames of 16 bits (ams data sheets AS5047D v1-00, AS5048 v1-06).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum AngleChip {
    /// AS5047D or AS5047P, which extrapolates the angle by its own delay.
    As5047,
    /// AS5048A.
    As5048,
}

impl AngleSensor {
    /// Returns the age of the angle at the crest that reads it, s. The chip latches the angle at the valley before.
    pub fn age(&self, carrier_hz: f64) -> f64 {
        self.chip.delay() + 0.5 / carrier_hz
    }
}

impl AngleChip {
    /// Returns the name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::As5047 => "as5047",
            Self::As5048 => "as5048",
        }
    }

    /// Returns the chip's delay from the magnet to the latched angle, s.
    pub const fn delay(self) -> f64 {
        match self {
            Self::As5047 => 2e-6,
            Self::As5048 => 100e-6,
        }
    }
}

/// An encoder, referred to the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Counts per turn of the joint, after x4 decoding. Of a prismatic joint, 2π times the counts per metre.
    pub counts_per_turn: f64,
    /// Joint angle at count 0 after homing, of an absolute encoder at its angle zero, rad.
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
    /// The mass matrix would not be positive definite, because some joint moves without inertia.
    NoInertia,
    /// The axis of a joint has no direction. Holds the joint's index.
    Axis(usize),
    /// The joints cannot move the tip along all of the task's coordinates, or a coordinate occurs twice.
    Task,
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
            Self::NoInertia => {
                f.write_str("a joint would move without any inertia: give it a rotor inertia, or its links a mass")
            }
            Self::Axis(_) => f.write_str("a joint's axis needs a direction"),
            Self::Task => f.write_str("the joints cannot move the tip along all of the task's coordinates"),
            Self::NotFinite => f.write_str("every number must be finite"),
            Self::Negative => f.write_str("masses, inertias and friction must not be negative"),
        }
    }
}

impl core::error::Error for DescriptionError {}
