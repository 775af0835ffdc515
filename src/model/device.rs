//! A device as the board knows it: lumped mechanism, encoders, motors, limits. Plain data, ready to use.

use crate::math::{Angle, Math, Real, cast, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::{Description, DescriptionError};
use crate::model::mechanism::{AnyMechanism, Mechanism, shared_pose};
use crate::model::motor::Motor;
use crate::model::padding::{head, padded};
use crate::model::precomputed::MassModel;
use crate::model::solve::solve_symmetric;
use heapless::String;
use nalgebra::{SMatrix, SVector};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Longest device name kept, bytes.
pub const NAME_LENGTH: usize = 32;

/// Everything about a device that a step needs, lumped and in the board's precision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Device<T: Real> {
    /// Its name, for people.
    pub name: String<NAME_LENGTH>,
    /// Its equations of motion.
    pub mechanism: AnyMechanism<T>,
    /// True if it has weight to hold.
    pub weight: bool,
    /// Its joints; the first N count.
    pub joints: [Joint<T>; MAX_JOINTS],
    /// The pose that homing declares, rad.
    pub home: Option<[T; MAX_JOINTS]>,
}

/// One joint: encoder, motor, friction, limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Joint<T> {
    /// Joint angle per encoder count, rad; negative when the encoder is inverted.
    pub radians_per_count: T,
    /// Counts after which the angle repeats, 0 when it never does. They make one turn where the counts per turn are
    /// whole, and q turns where they are a fraction p/q.
    pub counts_per_turn: i32,
    /// Joint angle at count 0, rad; within half a count of the description's, where home is a whole count.
    pub offset: T,
    /// Viscous friction, N m s/rad.
    pub viscous: T,
    /// Coulomb friction, N m.
    pub coulomb: T,
    /// Allowed angles, rad.
    pub limits: Option<(T, T)>,
    /// The motor; a joint without one cannot be armed.
    pub motor: Option<Motor<T>>,
}

impl<T: Real> Device<T> {
    /// Lumps a description in f64 and rounds once. A name longer than [`NAME_LENGTH`] bytes is cut at a character.
    pub fn new(name: &str, description: &Description) -> Result<Self, DescriptionError> {
        let spec = description.kind.spec();
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
                let sign = if encoder.inverted { -1.0 } else { 1.0 };
                scale = sign * core::f64::consts::TAU / encoder.counts_per_turn;
                joint.offset = r(match description.home {
                    Some(home) => on_a_count(encoder.offset, home[index], scale),
                    None => encoder.offset,
                });
                joint.counts_per_turn = repeats_after(encoder.counts_per_turn);
            }
            joint.radians_per_count = r(scale);
            joint.viscous = r(described.viscous);
            joint.coulomb = r(described.coulomb);
            joint.limits = described.limits.map(|(low, high)| (r(low), r(high)));
            joint.motor = described.motor.map(|motor| motor.cast());
        }
        Ok(Self {
            name: short,
            mechanism: AnyMechanism::new(description)?,
            weight: description.gravity.iter().take(spec.task).any(|g| *g != 0.0),
            joints,
            home: description.home.map(|home| home.map(r)),
        })
    }

    /// The same in another precision.
    pub fn cast<U: Real>(&self) -> Device<U> {
        Device {
            name: self.name.clone(),
            mechanism: self.mechanism.cast(),
            weight: self.weight,
            joints: self.joints.map(|joint| joint.cast()),
            home: self.home.map(|home| home.map(cast)),
        }
    }

    /// N.
    pub fn axes(&self) -> usize {
        self.mechanism.kind().spec().joints
    }
}

impl<T: Real> Joint<T> {
    /// The same in another precision.
    pub fn cast<U: Real>(&self) -> Joint<U> {
        Joint {
            radians_per_count: cast(self.radians_per_count),
            counts_per_turn: self.counts_per_turn,
            offset: cast(self.offset),
            viscous: cast(self.viscous),
            coulomb: cast(self.coulomb),
            limits: self.limits.map(|(low, high)| (cast(low), cast(high))),
            motor: self.motor.map(|motor| motor.cast()),
        }
    }
}

/// Most turns after which an angle repeats: a board divides its way back to them from f32 numbers, whose five roundings
/// stay below half a turn of so many.
const MOST_TURNS: f64 = 1_048_576.0;

/// The whole number of counts p after which q whole turns are over, where p/q are these counts per turn: the first
/// convergent of their continued fraction that is the same f64, or the last that fits. Then p/q is so near that the
/// counter's whole range is off by less than one count (from 2048 counts per turn on). 0 when no such number fits.
fn repeats_after(counts_per_turn: f64) -> i32 {
    let (mut counts, mut turns) = (1.0, 0.0);
    let (mut counts_before, mut turns_before) = (0.0, 1.0);
    let mut rest = counts_per_turn;
    loop {
        // Truncates; NaN becomes 0.
        let whole = rest as i64 as f64;
        let next = (whole * counts + counts_before, whole * turns + turns_before);
        if !(next.0 <= f64::from(i32::MAX) && next.1 <= MOST_TURNS && rest > 0.0) {
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
            /// Returns true if everything computed at `q` (rad) is finite: a broken coefficient spoils at least one
            /// number.
            pub fn is_finite_at<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> bool {
                match self {
                    $(Self::$Variant(mechanism) => finite_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// The forces at the tip for joint torques at `q` (rad).
            pub fn leverage<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> Leverage {
                match self {
                    $(Self::$Variant(mechanism) => leverage_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// The torques that carry the device's weight at `q` (rad), N m; zeros beyond the joints.
            pub fn gravity<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> [f32; MAX_JOINTS] {
                match self {
                    $(Self::$Variant(mechanism) => gravity_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// The mass matrix at `q` (rad), kg m², by rows; zeros beyond the joints.
            pub fn inertia<K: Math<f32>>(&self, q: &[f32; MAX_JOINTS]) -> [[f32; MAX_JOINTS]; MAX_JOINTS] {
                match self {
                    $(Self::$Variant(mechanism) => inertia_at::<K, _, $n>(mechanism, q),)*
                }
            }

            /// Jᵀ f, N m: the joint torques that make a force f (N, task frame) at the tip at `q` (rad).
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
    // A direction in which every coefficient of the mass matrix counts, through the copy of this code that is there
    // anyway.
    let askew = SVector::from_fn(|i, _| 0.5 + 0.1 * i as f32);
    let shaping = MassModel::Exact.shaping(mechanism, &head(q).into(), &pose, &askew);
    let found = [mechanism.tip(&pose), mechanism.gravity(&pose), shaping.e, shaping.me];
    found.iter().all(|v| v.iter().all(|x| x.is_finite())) && shaping.w_rr.is_finite()
}

/// Joint angles given in rad.
fn angles<const N: usize>(q: &[f32; MAX_JOINTS]) -> [Angle<f32>; N] {
    head(q).map(Angle::of_radians)
}

fn gravity_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(
    mechanism: &M,
    q: &[f32; MAX_JOINTS],
) -> [f32; MAX_JOINTS] {
    padded(&mechanism.gravity(&shared_pose::<f32, K, M, N>(mechanism, &angles(q))).data.0[0])
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
    let torque = mechanism.transpose(&pose, &head(force).into());
    padded(&torque.data.0[0])
}

/// The forces (N) that joint torques τ (N m) make at the tip: a row for each task direction, zeros beyond the task,
/// 1/m. It is the force felt by a hand that holds the tip where it is: J⁻ᵀ τ, and for an arm with more joints than the
/// tip has directions, whose other motion is free, (J M⁻¹ Jᵀ)⁻¹ J M⁻¹ τ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Leverage([[f32; MAX_JOINTS]; 3]);

impl Leverage {
    /// The force at the tip, N, that the torques τ (N m) of the first N joints are worth, in the first N task directions.
    #[inline(always)]
    pub fn force<const N: usize>(&self, torque: &[f32; MAX_JOINTS]) -> [f32; N] {
        core::array::from_fn(|direction| (0..N).fold(0.0, |sum, joint| sum + self.0[direction][joint] * torque[joint]))
    }

    /// Its square, N², of all joints' torques τ (N m).
    pub fn force_squared(&self, torque: &[f32; MAX_JOINTS]) -> f32 {
        squared(&self.force::<MAX_JOINTS>(torque))
    }

    /// By what share a torque of one joint is worth more or less at the tip than it `was`: of the joint where that is most.
    /// 0 where nothing is known.
    pub fn changed_from(&self, was: &Self) -> f32 {
        let worth = |of: &Self, joint: usize| squared(&of.0.map(|direction| direction[joint]));
        let most = (0..MAX_JOINTS).fold(1.0, |most: f32, joint| {
            let (now, then) = (worth(self, joint), worth(was, joint));
            if now > 0.0 && then > 0.0 { most.max(now / then).max(then / now) } else { most }
        });
        sqrt(most) - 1.0
    }

    /// More than what an error of 1 N m of joint `joint` can be worth at the tip, N.
    pub fn most_of(&self, joint: usize) -> f32 {
        self.0.iter().fold(0.0, |sum, direction| sum + direction[joint].abs())
    }
}

/// |f|².
#[inline(always)]
pub(crate) fn squared<const N: usize>(force: &[f32; N]) -> f32 {
    force.iter().fold(0.0, |sum, along| sum + along * along)
}

/// The direction of a task axis.
#[inline(always)]
fn unit<const N: usize>(direction: usize) -> SVector<f32, N> {
    SVector::from_fn(|i, _| if i == direction { 1.0 } else { 0.0 })
}

#[inline(never)]
fn leverage_at<K: Math<f32>, M: Mechanism<f32, N>, const N: usize>(mechanism: &M, q: &[f32; MAX_JOINTS]) -> Leverage {
    let pose = shared_pose::<f32, K, M, N>(mechanism, &angles(q));
    let (mut rows, task) = ([[0.0; MAX_JOINTS]; 3], M::SPEC.task);
    if task == N {
        // The rows of J⁻ᵀ.
        for (direction, row) in rows.iter_mut().enumerate().take(N) {
            *row = padded(&mechanism.inverse(&pose, &unit(direction)).data.0[0]);
        }
        return Leverage(rows);
    }
    // By what a unit of each force of a hand moves the joints, M⁻¹ Jᵀ, and the tip, J M⁻¹ Jᵀ.
    let mass = mechanism.mass(&pose);
    let torques: [SVector<f32, N>; N] = core::array::from_fn(|direction| mechanism.transpose(&pose, &unit(direction)));
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

/// The angle of count 0 that is nearest to `offset` and has `home` on a whole count (all in rad), so that the pose that
/// homing declares is the pose that is read. It moves by half a count at most, which homing rounded away before.
fn on_a_count(offset: f64, home: f64, radians_per_count: f64) -> f64 {
    let counts = (home - offset) / radians_per_count;
    let half = if counts < 0.0 { -0.5 } else { 0.5 };
    // Counts beyond an i64's are no encoder's; `as` clamps them.
    home - ((counts + half) as i64) as f64 * radians_per_count
}
