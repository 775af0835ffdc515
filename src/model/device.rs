//! The board's form of a device: coefficients of the mechanism, encoders, motors, limits.

use crate::math::{Angle, Math, Real, cast, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::{
    ANGLE_COUNTS, AngleSensor, Description, DescriptionError, Encoder, EncoderAt, Homing, MAX_SENSED,
};
use crate::model::mechanism::{AnyMechanism, Mechanism, shared_pose, shared_shaping};
use crate::model::motor::Motor;
use crate::model::padding::{pad, to_joints};
use crate::model::solve::solve_symmetric;
use crate::model::units::JointUnits;
use heapless::{String, Vec};
use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest angle by which a joint at rest may be beyond its limits, rad (of a slide times its lever), because limits end
/// before stops.
pub const MAX_BEYOND_LIMITS: f64 = 0.1;

/// Maximum length of a device name, bytes.
pub const NAME_LENGTH: usize = 32;

/// All data of a device that a control step needs, in the board's precision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Device<T: Real> {
    /// Name of the device for people.
    pub name: String<NAME_LENGTH>,
    /// Equations of motion.
    pub mechanism: AnyMechanism<T>,
    /// True if gravity acts on the device.
    pub weight: bool,
    /// Joints; the first N are valid.
    pub joints: [Joint<T>; MAX_JOINTS],
    /// Joint angles that homing assigns, rad.
    pub home: Option<[T; MAX_JOINTS]>,
    /// Reference of homing. Earlier backups have none.
    #[serde(default = "by_hand")]
    pub homing: Homing<T>,
    /// Encoders without motors.
    #[serde(default)]
    pub sensed: Vec<Sensed<T>, MAX_SENSED>,
}

fn by_hand<T>() -> Homing<T> {
    Homing::Hand
}

/// An encoder without a motor. No force depends on its angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Sensed<T> {
    /// Angle per encoder count, rad; negative if the encoder is inverted.
    pub radians_per_count: T,
    /// Angle at the home pose, rad.
    pub offset: T,
}

/// One joint: encoder, motor, friction, limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Joint<T> {
    /// Joint angle per encoder count, rad; negative if the encoder is inverted.
    pub radians_per_count: T,
    /// Counts after which the angle repeats: one turn, or q turns if the counts per turn are a fraction p/q; 0 if the
    /// angle never repeats.
    pub counts_per_turn: i32,
    /// Joint angle at count 0, rad. For an incremental encoder moved by up to half a count so that home is at an integer
    /// count.
    pub offset: T,
    /// Viscous friction, N m s/rad.
    pub viscous: T,
    /// Coulomb friction, N m.
    pub coulomb: T,
    /// Allowed angles, rad.
    pub limits: Option<(T, T)>,
    /// Motor; a joint without a motor cannot be armed.
    pub motor: Option<Motor<T>>,
    /// Absolute encoder; `None` if the encoder counts from power-on.
    #[serde(default)]
    pub absolute: Option<AngleSensor>,
}

impl<T: Real> Device<T> {
    /// Computes the coefficients in f64 and rounds them once. Cuts the name to at most [`NAME_LENGTH`] bytes.
    pub fn new(name: &str, description: &Description) -> Result<Self, DescriptionError> {
        let spec = description.kind.spec();
        let mechanism = AnyMechanism::new(description)?;
        let r = T::from_f64;
        let mut short = String::new();
        for character in name.chars() {
            if short.push(character).is_err() {
                break;
            }
        }
        let mut joints = [Joint::default(); MAX_JOINTS];
        for (index, (joint, described)) in joints.iter_mut().zip(&description.joints).take(spec.joints).enumerate() {
            let mut scale = 0.0;
            if let Some(encoder) = described.encoder {
                scale = radians_per_count(&encoder);
                joint.offset = r(match description.home {
                    // An index mark is at count 0, and home between two counts.
                    Some(home) if description.homing != Homing::Index && described.absolute.is_none() => {
                        offset_on_count(encoder.offset, home[index], scale)
                    }
                    _ => encoder.offset,
                });
                if mechanism.repeats(index) {
                    joint.counts_per_turn = counts_until_repeat(encoder.counts_per_turn);
                }
            }
            joint.radians_per_count = r(scale);
            joint.viscous = r(described.viscous);
            joint.coulomb = r(described.coulomb);
            joint.limits = described.limits.map(|(low, high)| (r(low), r(high)));
            joint.motor = described.motor.map(|motor| motor.cast());
            joint.absolute = described.absolute;
        }
        Ok(Self {
            name: short,
            mechanism,
            weight: description.gravity.iter().take(spec.gravity).any(|g| *g != 0.0),
            joints,
            home: description.home.map(|home| home.map(r)),
            homing: description.homing.map(r),
            sensed: (description.sensed.iter().flatten())
                .map(|encoder| Sensed { radians_per_count: r(radians_per_count(encoder)), offset: r(encoder.offset) })
                .collect(),
        })
    }

    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Device<U> {
        Device {
            name: self.name.clone(),
            mechanism: self.mechanism.cast(),
            weight: self.weight,
            joints: self.joints.map(|joint| joint.cast()),
            home: self.home.map(|home| home.map(cast)),
            homing: self.homing.map(cast),
            sensed: (self.sensed.iter())
                .map(|joint| Sensed { radians_per_count: cast(joint.radians_per_count), offset: cast(joint.offset) })
                .collect(),
        }
    }

    /// Returns true if absolute encoders tell all joint angles at power-on, so that the device need not be homed.
    pub fn homes_itself(&self) -> bool {
        let is_known = |(index, joint): (usize, &Joint<T>)| {
            joint.absolute.is_some_and(|sensor| sensor.at == EncoderAt::Joint || self.settling_limits(index).is_some())
        };
        self.joints.iter().enumerate().take(self.axes()).all(is_known)
    }

    /// Returns the limits (rad) of a joint within which its absolute encoder's angle occurs once.
    fn settling_limits(&self, index: usize) -> Option<(T, T)> {
        let joint = &self.joints[index];
        let beyond = MAX_BEYOND_LIMITS * f64::from(JointUnits::of(self.mechanism.is_prismatic(index)).lever);
        let turn = T::from_i32(ANGLE_COUNTS) * joint.radians_per_count.abs();
        joint.limits.filter(|(low, high)| *high - *low + T::from_f64(2.0 * beyond) <= turn)
    }

    /// Returns an angle (rad) that is less than half a turn of an absolute encoder from the joint at power-on: the middle
    /// of limits that settle the turn, otherwise the home pose.
    pub fn nearest_angle(&self, index: usize) -> T {
        let middle = self.settling_limits(index).map(|(low, high)| (low + high) * T::from_f64(0.5));
        middle.or(self.home.map(|home| home[index])).unwrap_or(T::zero())
    }

    /// Returns the largest age of an angle at the crest that uses it, s. Only absolute encoders have one.
    pub fn angle_age(&self, carrier_hz: f64) -> f64 {
        self.joints.iter().filter_map(|joint| joint.absolute).fold(0.0, |age, sensor| sensor.age(carrier_hz).max(age))
    }

    /// Returns the number of joints N.
    pub fn axes(&self) -> usize {
        self.mechanism.kind().spec().joints
    }
}

impl<T: Real> Joint<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Joint<U> {
        Joint {
            radians_per_count: cast(self.radians_per_count),
            counts_per_turn: self.counts_per_turn,
            offset: cast(self.offset),
            viscous: cast(self.viscous),
            coulomb: cast(self.coulomb),
            limits: self.limits.map(|(low, high)| (cast(low), cast(high))),
            motor: self.motor.map(|motor| motor.cast()),
            absolute: self.absolute,
        }
    }
}

/// Returns the angle of one count, rad; negative if the encoder is inverted.
fn radians_per_count(encoder: &Encoder) -> f64 {
    let sign = if encoder.inverted { -1.0 } else { 1.0 };
    sign * core::f64::consts::TAU / encoder.counts_per_turn
}

/// Maximum number of turns after which an angle repeats, because rounding errors of the board's f32 division stay below
/// half a turn up to this number.
const MAX_TURNS: f64 = 1_048_576.0;

/// Returns the integer number of counts p in q complete turns, where p/q is the first convergent of the continued
/// fraction that equals `counts_per_turn`, or the last one that fits. Over the counter's full range p/q is off by less
/// than one count (from 2048 counts per turn on). Returns 0 if no such number fits.
fn counts_until_repeat(counts_per_turn: f64) -> i32 {
    let (mut counts, mut turns) = (1.0, 0.0);
    let (mut counts_before, mut turns_before) = (0.0, 1.0);
    let mut rest = counts_per_turn;
    loop {
        // Truncates, and turns NaN into 0.
        let whole = rest as i64 as f64;
        let next = (whole * counts + counts_before, whole * turns + turns_before);
        if !(next.0 <= f64::from(i32::MAX) && next.1 <= MAX_TURNS && rest > 0.0) {
            return if turns > 0.0 { counts as i32 } else { 0 };
        }
        (counts_before, turns_before) = (counts, turns);
        (counts, turns) = next;
        if counts / turns == counts_per_turn {
            return counts as i32;
        }
        rest = 1.0 / (rest - whole);
    }
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        impl AnyMechanism<f32> {
            /// Returns true if all results at `q` (rad) are finite, which an invalid coefficient would prevent.
            pub fn is_finite_at<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> bool {
                match self {
                    $(Self::$Variant(mechanism) => finite_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// Returns the tip force per joint torque at `q` (rad).
            pub fn leverage<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> Leverage {
                match self {
                    $(Self::$Variant(mechanism) => leverage_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// Returns the torques that hold the device's weight at `q` (rad), N m; zeros beyond the joints.
            pub fn gravity<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> [f32; MAX_JOINTS] {
                match self {
                    $(Self::$Variant(mechanism) => gravity_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// Returns the mass matrix at `q` (rad), kg m², by rows; zeros beyond the joints.
            pub fn inertia<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> [[f32; MAX_JOINTS]; MAX_JOINTS] {
                match self {
                    $(Self::$Variant(mechanism) => inertia_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// Returns the joint torques Jᵀ f (N m) of a force f (N, task frame) at the tip at `q` (rad).
            pub fn torque<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS], force: &[f32; 3]) -> [f32; MAX_JOINTS] {
                match self {
                    $(Self::$Variant(mechanism) => torque_at::<K, _, $n>(mechanism, q, force),)*
                }
            }
        }
    };
}
crate::mechanisms!(define);

fn finite_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(mechanism: &M, q: &[f32; MAX_JOINTS]) -> bool {
    let pose = shared_pose::<f32, K, M, N>(mechanism, &angles(q));
    // Every coefficient of M contributes in this direction.
    let direction = SVector::from_fn(|i, _| 0.5 + 0.1 * i as f32);
    let shaping = shared_shaping(mechanism, &pose, &direction);
    let results = [mechanism.tip(&pose), mechanism.gravity(&pose), shaping.e, shaping.me];
    results.iter().all(|v| v.iter().all(|x| x.is_finite())) && shaping.w_rr.is_finite()
}

fn angles<const N: usize>(q: &[f32; MAX_JOINTS]) -> [Angle<f32>; N] {
    to_joints(q).map(Angle::from_radians)
}

fn gravity_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    mechanism: &M,
    q: &[f32; MAX_JOINTS],
) -> [f32; MAX_JOINTS] {
    pad(&mechanism.gravity(&shared_pose::<f32, K, M, N>(mechanism, &angles(q))).data.0[0])
}

fn inertia_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    mechanism: &M,
    q: &[f32; MAX_JOINTS],
) -> [[f32; MAX_JOINTS]; MAX_JOINTS] {
    let mass = mechanism.mass(&shared_pose::<f32, K, M, N>(mechanism, &angles(q)));
    core::array::from_fn(|i| core::array::from_fn(|j| mass.get((i, j)).copied().unwrap_or(0.0)))
}

fn torque_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    mechanism: &M,
    q: &[f32; MAX_JOINTS],
    force: &[f32; 3],
) -> [f32; MAX_JOINTS] {
    let pose = shared_pose::<f32, K, M, N>(mechanism, &angles(q));
    let torque = mechanism.transpose(&pose, &to_joints(force).into());
    pad(&torque.data.0[0])
}

/// The tip force per joint torque, 1/m: a row for each task direction, zeros beyond the task. A hand that holds the tip
/// in place feels the force J⁻ᵀ τ, or (J M⁻¹ Jᵀ)⁻¹ J M⁻¹ τ on a redundant arm, whose null motion is free.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Leverage([[f32; MAX_JOINTS]; 3]);

impl Leverage {
    /// Returns the tip force (N) of the torques `torque` (N m) of the first N joints, in the first N task directions.
    #[inline(always)]
    pub fn force<const N: usize>(&self, torque: &[f32; MAX_JOINTS]) -> [f32; N] {
        core::array::from_fn(|direction| (0..N).fold(0.0, |sum, joint| sum + self.0[direction][joint] * torque[joint]))
    }

    /// Returns the squared force at the tip (N²) of the torques `torque` (N m) of all joints.
    pub fn force_squared(&self, torque: &[f32; MAX_JOINTS]) -> f32 {
        squared(&self.force::<MAX_JOINTS>(torque))
    }

    /// Returns the largest relative change of a joint's tip force per torque from `was`; 0 if the change is unknown.
    pub fn relative_change_from(&self, was: &Self) -> f32 {
        let squared_force = |of: &Self, joint: usize| squared(&of.0.map(|direction| direction[joint]));
        let (mut more, mut less) = (1.0, 1.0);
        for joint in 0..MAX_JOINTS {
            let (now, then) = (squared_force(self, joint), squared_force(was, joint));
            let (high, low) = if now > then { (now, then) } else { (then, now) };
            // Compares the ratios without a division.
            if low > 0.0 && high * less > more * low {
                (more, less) = (high, low);
            }
        }
        sqrt(more / less) - 1.0
    }

    /// Returns an upper bound of the tip force that an error of 1 N m of joint `joint` makes, N.
    pub fn force_bound(&self, joint: usize) -> f32 {
        self.0.iter().fold(0.0, |sum, direction| sum + direction[joint].abs())
    }
}

#[inline(always)]
pub(crate) fn squared<const N: usize>(force: &[f32; N]) -> f32 {
    force.iter().fold(0.0, |sum, along| sum + along * along)
}

#[inline(always)]
fn unit_vector<const N: usize>(direction: usize) -> SVector<f32, N> {
    SVector::from_fn(|i, _| if i == direction { 1.0 } else { 0.0 })
}

#[inline(never)]
fn leverage_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(mechanism: &M, q: &[f32; MAX_JOINTS]) -> Leverage {
    let pose = shared_pose::<f32, K, M, N>(mechanism, &angles(q));
    let (mut rows, task) = ([[0.0; MAX_JOINTS]; 3], M::SPEC.task);
    if task == N {
        // The rows of J⁻ᵀ.
        for (direction, row) in rows.iter_mut().enumerate().take(N) {
            *row = pad(&mechanism.inverse(&pose, &unit_vector(direction)).data.0[0]);
        }
        return Leverage(rows);
    }
    // Joint motion M⁻¹ Jᵀ and tip motion J M⁻¹ Jᵀ per unit of a hand's force in each direction.
    let mass = mechanism.mass(&pose);
    let torques: [SVector<f32, N>; N] =
        core::array::from_fn(|direction| mechanism.transpose(&pose, &unit_vector(direction)));
    let moved: [SVector<f32, N>; N] = core::array::from_fn(|direction| solve_symmetric(&mass, &torques[direction]));
    let tip = SMatrix::<f32, N, N>::from_fn(|i, j| match (i < task, j < task) {
        (true, true) => torques[i].dot(&moved[j]),
        _ => f32::from(u8::from(i == j)),
    });
    for joint in 0..N {
        let along = SVector::from_fn(|direction, _| if direction < task { moved[direction][joint] } else { 0.0 });
        let force = solve_symmetric(&tip, &along);
        rows.iter_mut().zip(force.iter()).take(task).for_each(|(row, force)| row[joint] = *force);
    }
    Leverage(rows)
}

/// Returns the angle at count 0 nearest to `offset` that puts `home` at an integer count (all in rad), so that the
/// measured pose after homing equals the declared pose. The angle moves by at most half a count.
fn offset_on_count(offset: f64, home: f64, radians_per_count: f64) -> f64 {
    let counts = (home - offset) / radians_per_count;
    let half = if counts < 0.0 { -0.5 } else { 0.5 };
    // No encoder reaches counts beyond an i64, to which `as` clamps.
    home - ((counts + half) as i64) as f64 * radians_per_count
}
