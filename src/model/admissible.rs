//! The coordinate that a redundant device holds besides its tip while a wall pushes.
//!
//! Its joints are one more than its task has dimensions, so a motion is left that moves no tip: the null motion. (4) holds
//! *every* admissible coordinate, and which one the third is, decides how much inertia the wall meets: Wrr belongs to
//! the choice, Weff does not (docs/model.md section 2). The mechanisms compute with the orientation φ; here the same is
//! turned into the other choices by adding null motion to a unit motion E.

use crate::math::Real;
use crate::model::mechanism::Shaping;
use nalgebra::SVector;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Which coordinate besides the tip's a redundant device holds while the wall pushes, and so what Wrr is (docs/model.md
/// section 2). Of no effect on a device whose joints are as many as its task dimensions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[serde(rename_all = "kebab-case")]
pub enum Admissible {
    /// φ, the direction of the last link: the handle slides along the wall and does not turn.
    #[default]
    Orientation,
    /// The angle of joint 0.
    #[serde(rename = "joint-0")]
    Joint0,
    /// The angle of joint 1.
    #[serde(rename = "joint-1")]
    Joint1,
    /// The angle of joint 2.
    #[serde(rename = "joint-2")]
    Joint2,
    /// None: the internal motion gets no torque and does what it does, so that Wrr is the tip's own inertia.
    Consistent,
}

impl Admissible {
    /// Every choice with its name in scene files and on the command line.
    pub const ALL: [(&'static str, Self); 5] = [
        ("orientation", Self::Orientation),
        ("joint-0", Self::Joint0),
        ("joint-1", Self::Joint1),
        ("joint-2", Self::Joint2),
        ("consistent", Self::Consistent),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// Share of the null motion that moves the held joint, squared, at and above which the joint is held; below the lesser
/// one it is not, as no finite null motion would hold it.
const HELD: [f64; 2] = [0.02 * 0.02, 0.05 * 0.05];

impl Admissible {
    /// The joint that is held.
    pub fn joint(self) -> Option<usize> {
        match self {
            Self::Joint0 => Some(0),
            Self::Joint1 => Some(1),
            Self::Joint2 => Some(2),
            Self::Orientation | Self::Consistent => None,
        }
    }

    /// `shaping` of a tip direction with φ held, turned into one with this coordinate held; `null` is that of the null
    /// motion (φ alone).
    pub fn hold<T: Real, const N: usize>(self, shaping: &Shaping<T, N>, null: &Shaping<T, N>) -> Shaping<T, N> {
        let added = self.added(shaping, null);
        let (e, me) = (shaping.e + null.e * added, shaping.me + null.me * added);
        Shaping { e, me, w_rr: e.dot(&me) }
    }

    /// The null motion in what [`Admissible::hold`] makes of `shaping`, rad/m of φ.
    pub fn added<T: Real, const N: usize>(self, shaping: &Shaping<T, N>, null: &Shaping<T, N>) -> T {
        self.null_motion(null, &shaping.e, shaping.e.dot(&null.me))
    }

    /// The velocity torques `b` (N m) with φ held, turned into those with this coordinate held. `bent` = J⁻¹ J̇ q̇ is what
    /// the joints do less of than they would if the tip went straight on, rad/s².
    pub fn hold_bias<T: Real, const N: usize>(
        self,
        b: &SVector<T, N>,
        bent: &SVector<T, N>,
        null: &Shaping<T, N>,
    ) -> SVector<T, N> {
        b + null.me * self.null_motion(null, &-bent, b.dot(&null.e))
    }

    /// The null motion that has to be added to joint motion `motion`, whose momentum along the null motion is `along`.
    fn null_motion<T: Real, const N: usize>(self, null: &Shaping<T, N>, motion: &SVector<T, N>, along: T) -> T {
        if self == Self::Orientation {
            return T::zero();
        }
        let free = -along / null.w_rr;
        let Some(joint) = self.joint().filter(|joint| *joint < N) else { return free };
        let moves = null.e[joint];
        let [low, high] = HELD.map(T::from_f64);
        let share = moves * moves / null.e.dot(&null.e);
        if share <= low {
            return free;
        }
        let held = -motion[joint] / moves;
        if share >= high {
            return held;
        }
        let s = (share - low) / (high - low);
        free + (held - free) * (s * s * (T::from_f64(3.0) - s - s))
    }
}
