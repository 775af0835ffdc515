//! The third task coordinate of a redundant device, which stays constant together with the tip while a wall pushes.
//!
//! A redundant device has one joint more than task dimensions, so one joint motion does not move the tip: the null
//! motion. Equation (4) keeps every admissible coordinate constant. The choice of the third coordinate therefore
//! decides how much inertia the wall meets: Wrr depends on it, Weff does not (docs/model.md section 2). Mechanisms
//! compute with the orientation φ; this module adds null motion to a unit motion E for the other choices.

use crate::math::Real;
use crate::model::mechanism::Shaping;
use nalgebra::SVector;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The coordinate that a redundant device keeps constant in addition to its tip while a wall pushes. Determines Wrr
/// (docs/model.md section 2). Has no effect on other devices.
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
    /// No coordinate. The null motion is free, so Wrr is the effective inertia at the tip.
    Consistent,
}

impl Admissible {
    /// Every choice, with the name in scene files and on the command line.
    pub const ALL: [(&'static str, Self); 5] = [
        ("orientation", Self::Orientation),
        ("joint-0", Self::Joint0),
        ("joint-1", Self::Joint1),
        ("joint-2", Self::Joint2),
        ("consistent", Self::Consistent),
    ];

    /// Returns the name of this choice.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// Square of a joint's share in the null motion: at and below the lower value the joint is free, because no finite null
/// motion could hold it; at and above the upper value it can be held.
const HOLDABLE_SHARE_SQUARED: [f64; 2] = [0.02 * 0.02, 0.05 * 0.05];

impl Admissible {
    /// Returns the index of the held joint, if a joint is held.
    pub fn joint(self) -> Option<usize> {
        match self {
            Self::Joint0 => Some(0),
            Self::Joint1 => Some(1),
            Self::Joint2 => Some(2),
            Self::Orientation | Self::Consistent => None,
        }
    }

    /// Converts the `shaping` of a tip direction from a held φ to this coordinate. `null` is the shaping of φ alone.
    pub fn hold<T: Real, const N: usize>(self, shaping: &Shaping<T, N>, null: &Shaping<T, N>) -> Shaping<T, N> {
        let added = self.added_null_motion(shaping, null);
        let (e, me) = (shaping.e + null.e * added, shaping.me + null.me * added);
        Shaping { e, me, w_rr: e.dot(&me) }
    }

    /// Returns the null motion that [`Admissible::hold`] adds to `shaping`, in rad of φ per metre of tip motion.
    pub fn added_null_motion<T: Real, const N: usize>(self, shaping: &Shaping<T, N>, null: &Shaping<T, N>) -> T {
        self.null_motion(null, &shaping.e, shaping.e.dot(&null.me))
    }

    /// Converts the velocity torques `b` (N m) from a held φ to this coordinate. `qdd_bias` = J⁻¹ J̇ q̇ (rad/s²) is the
    /// joint acceleration that is subtracted to keep the tip on a straight line.
    pub fn hold_bias<T: Real, const N: usize>(
        self,
        b: &SVector<T, N>,
        qdd_bias: &SVector<T, N>,
        null: &Shaping<T, N>,
    ) -> SVector<T, N> {
        b + null.me * self.null_motion(null, &-qdd_bias, b.dot(&null.e))
    }

    /// Returns the null motion to add to `motion`, whose momentum along the null motion is `along`.
    fn null_motion<T: Real, const N: usize>(self, null: &Shaping<T, N>, motion: &SVector<T, N>, along: T) -> T {
        if self == Self::Orientation {
            return T::zero();
        }
        let free = -along / null.w_rr;
        let Some(joint) = self.joint().filter(|joint| *joint < N) else { return free };
        let moves = null.e[joint];
        let [low, high] = HOLDABLE_SHARE_SQUARED.map(T::from_f64);
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
