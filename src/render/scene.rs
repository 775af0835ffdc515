//! The scene that the device renders: walls, springs and damping fields, with the values of the scene file.
//!
//! A [`Scene`] is plain data, the same on host and board. The controller builds its run-time form from a checked scene.
//! A wall's shape is one file in this module's folder and one line in the list of [`surface`].

mod cylinder;
mod plane;
pub mod shape;
mod sphere;
pub mod surface;

use crate::math::{Real, cast};
pub use crate::model::admissible::Admissible;
use crate::render::velocity::Estimator;
pub use cylinder::Cylinder;
use heapless::Vec;
use nalgebra::SVector;
pub use plane::Plane;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};
pub use sphere::Sphere;
pub use surface::Surface;

/// Maximum number of walls in a scene.
pub const MAX_WALLS: usize = 8;
/// Maximum number of springs in a scene.
pub const MAX_SPRINGS: usize = 4;

/// The position of a point relative to a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact<T: Real, const N: usize> {
    /// Signed distance along the normal, m; negative inside the solid.
    pub distance: T,
    /// Unit normal out of the solid.
    pub normal: SVector<T, N>,
}

/// The feed-forward of a wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[serde(rename_all = "kebab-case")]
pub enum FeedForward {
    /// No feed-forward: the wall meets Weff.
    Off,
    /// Equation (4) unchanged: the wall meets Wrr, and a resting hand is pushed sideways.
    Full,
    /// Equation (4) with a high-passed wall force: acts at the frequencies of instability, and not at rest.
    #[default]
    Washout,
}

impl FeedForward {
    /// Every kind with its name in scene files and on the command line.
    pub const ALL: [(&'static str, Self); 3] = [("off", Self::Off), ("full", Self::Full), ("washout", Self::Washout)];

    /// Returns the name in scene files.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// The treatment of b, the forces that keep a moving tip on a straight line (docs/model.md section 2).
///
/// The first two variants were the flags `false` and `true`, so old settings and backups remain readable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Schema)]
#[serde(rename_all = "kebab-case")]
pub enum VelocityTerms {
    /// No velocity terms: τ = M E Wrr⁻¹ fr.
    Off,
    /// The paper's (4): b acts in the admissible motion only, so the wall meets Wrr u̇r = fr - zr.
    Paper,
    /// b acts in every motion, τ = M E Wrr⁻¹ fr + b, so the wall meets Wrr u̇r = fr, the rendered force.
    #[default]
    Rendered,
}

impl VelocityTerms {
    /// Every choice with its name in scene files.
    pub const ALL: [(&'static str, Self); 3] =
        [("off", Self::Off), ("paper", Self::Paper), ("rendered", Self::Rendered)];

    /// Returns the name in scene files.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl<'de> Deserialize<'de> for VelocityTerms {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(rename_all = "kebab-case")]
        enum Word {
            Off,
            Paper,
            Rendered,
        }
        /// A visitor for the value in a text file: a word, or the former flag.
        struct FlagOrWord;
        impl<'de> serde::de::Visitor<'de> for FlagOrWord {
            type Value = Word;
            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("off, paper or rendered")
            }
            fn visit_bool<E>(self, on: bool) -> Result<Word, E> {
                Ok(if on { Word::Paper } else { Word::Off })
            }
            fn visit_str<E: serde::de::Error>(self, word: &str) -> Result<Word, E> {
                Word::deserialize(serde::de::value::StrDeserializer::new(word))
            }
        }
        let word = if deserializer.is_human_readable() {
            deserializer.deserialize_any(FlagOrWord)?
        } else {
            Word::deserialize(deserializer)?
        };
        Ok(match word {
            Word::Off => Self::Off,
            Word::Paper => Self::Paper,
            Word::Rendered => Self::Rendered,
        })
    }
}

/// Largest `feed_forward_gain` of a scene. Near the inertia's pole the board uses a smaller gain.
pub const MAX_FEED_FORWARD_GAIN: f64 = 3.0;

/// One wall: fr = -stiffness x - damping v while x < 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Wall<T> {
    /// Shape.
    pub surface: Surface<T>,
    /// Stiffness, N/m.
    pub stiffness: T,
    /// Damping, N s/m.
    pub damping: T,
    /// Feed-forward of the wall's force.
    pub feed_forward: FeedForward,
    /// Corner frequency of the feed-forward's high-pass, Hz; used by [`FeedForward::Washout`].
    pub washout_hz: T,
    /// True if B q̇ is added to b, so that uneven joint damping does not cause creep.
    pub damping_compensation: bool,
    /// True if the wall acts on both sides of the surface and may pull.
    pub bilateral: bool,
}

/// A spring to a point or a line (guidance).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Spring<T> {
    /// Position of the point, or of any point of the line, m.
    pub point: [T; 3],
    /// Unit direction of the line; zero for a point.
    pub direction: [T; 3],
    /// Stiffness, N/m.
    pub stiffness: T,
    /// Damping in the directions of the stiffness, N s/m.
    pub damping: T,
}

/// A torsional spring between the ground and the last link of a redundant device. It holds the orientation φ without a
/// force at the tip at rest (docs/model.md section 2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Posture<T> {
    /// Orientation φ to hold, rad.
    pub orientation: T,
    /// Stiffness at `orientation`, N m/rad. Also the largest moment (N m), because the moment grows as the sine.
    pub stiffness: T,
    /// Damping, N m s/rad.
    pub damping: T,
}

/// A complete scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(bound(deserialize = "T: Real + Deserialize<'de>"))]
pub struct Scene<T> {
    /// Task dimension of the scene.
    pub task: u8,
    /// Control rate, Hz.
    pub rate_hz: T,
    /// Cutoff of the velocity estimators, Hz.
    pub cutoff_hz: T,
    /// Kind of velocity estimator.
    pub estimator: Estimator,
    /// True if the device's own weight is held at all times.
    pub gravity_compensation: bool,
    /// Treatment of b, the forces of a moving tip.
    pub velocity_terms: VelocityTerms,
    /// Walls.
    pub walls: Vec<Wall<T>, MAX_WALLS>,
    /// Springs.
    pub springs: Vec<Spring<T>, MAX_SPRINGS>,
    /// Sum of all damping fields, N s/m.
    pub field_damping: T,
    /// α: factor on equation (4)'s feed-forward, 0 to [`MAX_FEED_FORWARD_GAIN`]; above 1 only with one shaped wall.
    #[serde(default = "T::one")]
    pub feed_forward_gain: T,
    /// Coordinate that a redundant device holds.
    #[serde(default)]
    pub admissible: Admissible,
    /// Posture in which a redundant device is held.
    #[serde(default)]
    pub posture: Option<Posture<T>>,
}

/// Control rate of a scene file without a rate, Hz.
pub const DEFAULT_RATE_HZ: f64 = 20_000.0;
/// Lowest control rate, Hz.
pub const MIN_RATE_HZ: f64 = 200.0;
/// Highest control rate, Hz.
pub const MAX_RATE_HZ: f64 = 50_000.0;

/// An error in a scene. The index is the number of the wall or spring, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum SceneError {
    /// The scene is for another task dimension than the device.
    Dimension,
    /// The control rate is outside 200 Hz to 50 kHz.
    Rate,
    /// The cutoff is not between zero and half the rate.
    Cutoff,
    /// A washout corner is not between zero and half the rate.
    Washout(u8),
    /// A wall's stiffness or damping is negative or not finite.
    WallGains(u8),
    /// A spring's or field's stiffness or damping is negative or not finite.
    GuidanceGains,
    /// A normal, axis or direction is not a unit vector, a radius not positive, or a point not finite.
    Surface(u8),
    /// This shape does not exist in the device's task space (a cylinder needs three dimensions).
    Shape(u8),
    /// The feed-forward gain is not from 0 to 3, or above 1 with several shaped walls.
    FeedForwardGain,
    /// The estimator's additional value (such as `difference_over`) is outside its range.
    Estimator,
    /// The posture's numbers are not finite or negative, or the device is not redundant.
    Posture,
}

impl core::fmt::Display for SceneError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Dimension => f.write_str("the scene is for another task dimension than the device"),
            Self::Rate => f.write_str("the control rate must be from 200 to 50000 Hz"),
            Self::Cutoff => f.write_str("the cutoff must be greater than zero and below half the rate"),
            Self::Washout(i) => {
                write!(f, "wall {i}: washout_hz must be greater than zero and below half the rate")
            }
            Self::WallGains(i) => write!(f, "wall {i}: stiffness and damping must be finite and not negative"),
            Self::GuidanceGains => {
                f.write_str("stiffness and damping of springs and fields must be finite and not negative")
            }
            Self::Surface(i) => {
                write!(f, "wall {i}: its point must be finite, its normal or axis not zero, its radius positive")
            }
            Self::Shape(i) => write!(f, "wall {i}: this shape needs a three-dimensional device"),
            Self::FeedForwardGain => {
                f.write_str("feed_forward_gain must be from 0 to 3, and at most 1 if several walls have a feed-forward")
            }
            Self::Estimator => {
                f.write_str("the velocity estimator's additional value (such as difference_over) is outside its range")
            }
            Self::Posture => f.write_str(
                "posture: it needs a device with more joints than its tip has directions, a finite orientation, and \
                 stiffness and damping that are finite and not negative",
            ),
        }
    }
}

impl core::error::Error for SceneError {}

impl<T: Real> Default for Scene<T> {
    /// An empty scene at [`DEFAULT_RATE_HZ`] with a 500 Hz cutoff that holds the device's own weight.
    fn default() -> Self {
        Self {
            task: 0,
            rate_hz: T::from_f64(DEFAULT_RATE_HZ),
            cutoff_hz: T::from_f64(500.0),
            estimator: Estimator::Butterworth,
            gravity_compensation: true,
            velocity_terms: VelocityTerms::default(),
            walls: Vec::new(),
            springs: Vec::new(),
            field_damping: T::zero(),
            feed_forward_gain: T::one(),
            admissible: Admissible::default(),
            posture: None,
        }
    }
}

impl<T: Real> Wall<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Wall<U> {
        Wall {
            surface: self.surface.cast(),
            stiffness: cast(self.stiffness),
            damping: cast(self.damping),
            feed_forward: self.feed_forward,
            washout_hz: cast(self.washout_hz),
            damping_compensation: self.damping_compensation,
            bilateral: self.bilateral,
        }
    }
}

impl<T: Real> Spring<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Spring<U> {
        Spring {
            point: self.point.map(cast),
            direction: self.direction.map(cast),
            stiffness: cast(self.stiffness),
            damping: cast(self.damping),
        }
    }
}

impl<T: Real> Posture<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Posture<U> {
        Posture { orientation: cast(self.orientation), stiffness: cast(self.stiffness), damping: cast(self.damping) }
    }
}

impl<T: Real> Scene<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Scene<U> {
        Scene {
            task: self.task,
            rate_hz: cast(self.rate_hz),
            cutoff_hz: cast(self.cutoff_hz),
            estimator: self.estimator,
            gravity_compensation: self.gravity_compensation,
            velocity_terms: self.velocity_terms,
            walls: self.walls.iter().map(Wall::cast).collect(),
            springs: self.springs.iter().map(Spring::cast).collect(),
            field_damping: cast(self.field_damping),
            feed_forward_gain: cast(self.feed_forward_gain),
            admissible: self.admissible,
            posture: self.posture.as_ref().map(Posture::cast),
        }
    }

    /// Checks all conditions that the controller relies on, for a device of task dimension `task`.
    pub fn check(&self, task: usize) -> Result<(), SceneError> {
        let gain = |value: T| value.is_finite() && value >= T::zero();
        if usize::from(self.task) != task {
            return Err(SceneError::Dimension);
        }
        let rate = self.rate_hz;
        if !(T::from_f64(MIN_RATE_HZ)..=T::from_f64(MAX_RATE_HZ)).contains(&rate) {
            return Err(SceneError::Rate);
        }
        let half_rate = rate * T::from_f64(0.5);
        let below_half = |hz: T| hz > T::zero() && hz < half_rate;
        if !below_half(self.cutoff_hz) {
            return Err(SceneError::Cutoff);
        }
        if !self.estimator.is_valid() {
            return Err(SceneError::Estimator);
        }
        let shaped = self.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off).count();
        let limit = if shaped > 1 { T::one() } else { T::from_f64(MAX_FEED_FORWARD_GAIN) };
        if !(T::zero()..=limit).contains(&self.feed_forward_gain) {
            return Err(SceneError::FeedForwardGain);
        }
        for (index, wall) in self.walls.iter().enumerate() {
            let index = index as u8;
            if !gain(wall.stiffness) || !gain(wall.damping) {
                return Err(SceneError::WallGains(index));
            }
            if wall.feed_forward == FeedForward::Washout && !below_half(wall.washout_hz) {
                return Err(SceneError::Washout(index));
            }
            if task < wall.surface.spec().least_task {
                return Err(SceneError::Shape(index));
            }
            if !wall.surface.is_valid(task) {
                return Err(SceneError::Surface(index));
            }
        }
        let springs = self.springs.iter().all(|spring| {
            let length = squared(&spring.direction);
            gain(spring.stiffness)
                && gain(spring.damping)
                && is_finite_point(&spring.point)
                && (length == T::zero() || is_unit(length))
        });
        if !springs || !gain(self.field_damping) {
            return Err(SceneError::GuidanceGains);
        }
        if let Some(posture) = &self.posture
            && !(posture.orientation.is_finite() && gain(posture.stiffness) && gain(posture.damping))
        {
            return Err(SceneError::Posture);
        }
        Ok(())
    }
}

fn is_finite_point<T: Real>(v: &[T; 3]) -> bool {
    v.iter().all(|entry| entry.is_finite())
}

fn squared<T: Real>(v: &[T; 3]) -> T {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// Returns true if a squared length is 1 to within f32 rounding.
fn is_unit<T: Real>(length_squared: T) -> bool {
    (length_squared - T::one()).abs() < T::from_f64(1.0e-5)
}

/// Returns the first N entries of a three-vector as a task vector.
#[inline(always)]
pub fn task_vector<T: Real, const N: usize>(v: &[T; 3]) -> SVector<T, N> {
    SVector::from_fn(|i, _| if i < 3 { v[i] } else { T::zero() })
}
