//! Mechanisms, which compute tip, Jacobian, mass matrix and bias forces from joint angles.
//!
//! A mechanism is one file in this module's folder and one line in [`mechanisms!`](crate::mechanisms). It computes its
//! minimal coefficients from the maker's description once, in f64 on the host. Once per control step it computes all
//! quantities that depend on the angles alone, in its `Pose`.
//!
//! Every mechanism has as many *task* coordinates as joints: the tip's `d` coordinates and, on the redundant arm, the
//! orientation φ. Its Jacobian J is therefore always square, N x N, and a unit motion of the tip along `n` without
//! other motion is E = J⁻¹ n (docs/model.md section 2). Rendered directions have zeros beyond `d`.

mod chain;
mod delta;
mod five_bar;
mod five_bar_turret;
mod paddle;
mod parallelogram;
mod serial_3r;

use crate::math::{Angle, Math, Real};
use crate::model::catalogue::{Kind, MAX_JOINTS, Spec};
use crate::model::description::{Description, DescriptionError};
use crate::model::solve::quotient;
use crate::model::units::JointUnits;
use heapless::Vec;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Distance of a pose from the nearest singularities, as sines in [0, 1] (0 = singular).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Regularity<T> {
    /// Zero if J loses rank (a stretched arm): E and the feed-forward are unbounded, Jᵀ f is finite.
    pub serial: T,
    /// Zero if J⁻¹ loses rank (a stretched closed loop): Jᵀ f is unbounded. 1 on open chains.
    pub parallel: T,
}

/// A unit motion of the tip, with its joint motion, momentum and inertia.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaping<T: Real, const N: usize> {
    /// E = J⁻¹ n: joint velocities per unit rendered velocity, rad/m.
    pub e: SVector<T, N>,
    /// M E: joint momentum per unit rendered velocity, kg m.
    pub me: SVector<T, N>,
    /// Wrr = Eᵀ M E: inertia along n without admissible motion, kg.
    pub w_rr: T,
}

/// The terms of equation (4) for one wall in N directions, the wall's normal first. Used by the analysis only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallTerms<T: Real, const N: usize> {
    /// E = T⁻¹: joint velocities per unit velocity along each direction, one column each, rad/m.
    pub e: SMatrix<T, N, N>,
    /// M E of the normal, kg m.
    pub me: SVector<T, N>,
    /// W = Eᵀ M E, kg.
    pub w: SMatrix<T, N, N>,
    /// b = c + g - M T⁻¹ Ṫ q̇, N m.
    pub b: SVector<T, N>,
    /// Jᵀ n, m.
    pub row: SVector<T, N>,
    /// Weff = 1/(nᵀ J M⁻¹ Jᵀ n), kg.
    pub w_eff: T,
}

/// Returns the symmetric matrix with this upper triangle.
#[inline(always)]
fn symmetric_matrix<T: Real, const N: usize>(upper: impl Fn(usize, usize) -> T) -> SMatrix<T, N, N> {
    let mut matrix = SMatrix::zeros();
    for j in 0..N {
        for i in 0..=j {
            let entry = upper(i, j);
            matrix[(i, j)] = entry;
            matrix[(j, i)] = entry;
        }
    }
    matrix
}

/// Returns 1/(yᵀ M⁻¹ y): the effective inertia of M along y.
#[inline(always)]
fn effective_inertia<T: Real, const N: usize>(mass: &SMatrix<T, N, N>, y: &SVector<T, N>) -> T {
    let (above, below) = quotient(mass, y);
    below / above
}

/// Returns the effective inertia along (`lever`, `y`) of a turret with the mass matrix `arms` of its linkage.
#[inline(always)]
fn inertia_with_turret<T: Real>(turret: T, lever: T, arms: &Matrix2<T>, y: &Vector2<T>) -> T {
    // If the wall faces across the arms' plane, y is zero and the effective inertia is the turret's alone.
    let (above, below) = quotient(arms, y);
    turret * below / (lever * lever * below + turret * above)
}

/// Returns Bᵀ Λ B for a symmetric Λ.
#[inline(always)]
pub(crate) fn in_basis<T: Real, const N: usize>(
    inertia: &SMatrix<T, N, N>,
    basis: &SMatrix<T, N, N>,
) -> SMatrix<T, N, N> {
    let moved = inertia * basis;
    symmetric_matrix(|i, j| basis.column(i).dot(&moved.column(j)))
}

/// Joint torques by equation (4) for one wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapedTorque<T: Real, const N: usize> {
    /// E = J⁻¹ n, rad/m.
    pub e: SVector<T, N>,
    /// Joint torques, N m.
    pub torque: SVector<T, N>,
}

impl<T: Real, const N: usize> Shaping<T, N> {
    /// Makes the shaping of the joint velocities `e` (rad/m) with a mass matrix (N x N, kg m²).
    #[inline(always)]
    pub fn of(mass: &SMatrix<T, N, N>, e: SVector<T, N>) -> Self {
        let me = mass * e;
        Self { e, me, w_rr: e.dot(&me) }
    }

    /// Returns the joint torques (N m) that render `force` (N) along n by equation (4), τ = M E Wrr⁻¹ (f - Eᵀ
    /// subtracted) + b. `subtracted` is the part of b (N m) that reduces f: all of b by the paper, zero if the force is
    /// rendered in every motion.
    #[inline(always)]
    pub fn torque(&self, force: T, b: &SVector<T, N>, subtracted: &SVector<T, N>) -> SVector<T, N> {
        if N == 1 {
            // One joint has no admissible direction: M E Wrr⁻¹ Eᵀ is 1, and b cancels without rounding.
            return self.me * (force / self.w_rr) + (b - subtracted);
        }
        self.me * ((force - self.e.dot(subtracted)) / self.w_rr) + b
    }
}

/// The equations of motion of one mechanism with N joints, M q̈ + c(q, q̇) + g(q) = τ (without friction).
///
/// All methods accept any finite input. Near a singularity, results grow but stay finite if a clamp is documented.
pub trait Mechanism<T: Real, const N: usize>: Copy + core::fmt::Debug {
    /// Contents of its device files.
    const SPEC: Spec;
    /// Quantities that depend on the angles alone, computed once per control step.
    type Pose: Copy + core::fmt::Debug;
    /// Computes the coefficients from a description. The error names the invalid property of the description.
    fn new(description: &Description) -> Result<Self, DescriptionError>;
    /// Computes all quantities that depend on the joint angles alone.
    fn pose_at<K: Math<T>>(&self, angles: &[Angle<T>; N]) -> Self::Pose;
    /// Computes [`Mechanism::pose_at`] for joint angles `q` in rad.
    #[inline(always)]
    fn pose<K: Math<T>>(&self, q: &SVector<T, N>) -> Self::Pose {
        self.pose_at::<K>(&core::array::from_fn(|i| Angle::from_radians(q[i])))
    }
    /// Computes [`Mechanism::pose_at`] without clamps, or returns `None` if a sine is below `least` (positive sines).
    #[inline(always)]
    fn regular_pose<K: Math<T>>(&self, angles: &[Angle<T>; N], least: &Regularity<T>) -> Option<Self::Pose> {
        let pose = self.pose_at::<K>(angles);
        let regularity = self.regularity(&pose);
        (regularity.serial >= least.serial && regularity.parallel >= least.parallel).then_some(pose)
    }
    /// Returns the task position: tip in metres (then φ in rad on the redundant arm).
    fn tip(&self, pose: &Self::Pose) -> SVector<T, N>;
    /// Returns the distance from singularities.
    fn regularity(&self, pose: &Self::Pose) -> Regularity<T>;
    /// Returns J (N x N): task velocity = J q̇.
    fn jacobian(&self, pose: &Self::Pose) -> SMatrix<T, N, N>;
    /// Returns J̇ (N x N) at joint velocities `qd` (rad/s).
    fn jacobian_rate(&self, pose: &Self::Pose, qd: &SVector<T, N>) -> SMatrix<T, N, N>;
    /// Returns M(q) (N x N), kg m².
    fn mass(&self, pose: &Self::Pose) -> SMatrix<T, N, N>;
    /// Returns c(q, q̇): Coriolis and centrifugal joint torques, N m.
    fn coriolis(&self, pose: &Self::Pose, qd: &SVector<T, N>) -> SVector<T, N>;
    /// Returns g(q): the joint torques that hold the device against gravity, N m.
    fn gravity(&self, pose: &Self::Pose) -> SVector<T, N>;

    /// Returns Jᵀ f: the joint torques of a task force.
    fn transpose(&self, pose: &Self::Pose, force: &SVector<T, N>) -> SVector<T, N> {
        self.jacobian(pose).tr_mul(force)
    }
    /// Returns J q̇: the task velocity.
    fn velocity(&self, pose: &Self::Pose, qd: &SVector<T, N>) -> SVector<T, N> {
        self.jacobian(pose) * qd
    }
    /// Returns J⁻¹ v: the joint velocities of a task velocity. Clamped at a serial singularity, not infinite.
    fn inverse(&self, pose: &Self::Pose, velocity: &SVector<T, N>) -> SVector<T, N>;
    /// Returns J⁻¹ (N x N).
    fn jacobian_inverse(&self, pose: &Self::Pose) -> SMatrix<T, N, N> {
        let mut inverse = SMatrix::<T, N, N>::zeros();
        for column in 0..N {
            let mut unit = SVector::<T, N>::zeros();
            unit[column] = T::one();
            inverse.set_column(column, &self.inverse(pose, &unit));
        }
        inverse
    }
    /// Returns the joint motion and the inertia of a unit task motion along `n`.
    fn shaping(&self, pose: &Self::Pose, n: &SVector<T, N>) -> Shaping<T, N> {
        Shaping::of(&self.mass(pose), self.inverse(pose, n))
    }
    /// Returns the torques that move the tip straight at constant speed while the joints move: c - M J⁻¹ J̇ q̇ (N m),
    /// the velocity part of `b` in docs/model.md section 2. A tip acceleration `a` adds `shaping(pose, a).me`.
    fn velocity_torque(&self, pose: &Self::Pose, qd: &SVector<T, N>) -> SVector<T, N> {
        let qdd_bias = self.inverse(pose, &(self.jacobian_rate(pose, qd) * qd));
        self.coriolis(pose, qd) - self.mass(pose) * qdd_bias
    }
    /// Computes equation (4) for one wall of unit normal `n` whose `force` (N) is rendered in every motion: E = J⁻¹ n
    /// (rad/m) and the joint torques τ = M E Wrr⁻¹ f + b (N m). b is zero without joint velocities `qd` (rad/s). The
    /// tip accelerates by f/Wrr along n and not across n. A closed form needs one pass of inverse dynamics.
    #[inline(always)]
    fn shaped_torque(
        &self,
        pose: &Self::Pose,
        n: &SVector<T, N>,
        force: T,
        qd: Option<&SVector<T, N>>,
    ) -> ShapedTorque<T, N> {
        let shaping = self.shaping(pose, n);
        let torque = shaping.me * (force / shaping.w_rr);
        ShapedTorque { e: shaping.e, torque: qd.map_or(torque, |qd| torque + self.velocity_torque(pose, qd)) }
    }
    /// Computes [`Mechanism::shaped_torque`] for a wall whose normal turns. `turning` is the resulting tip acceleration
    /// (m/s²), -κ of [`frame_rate`](crate::model::inertia::frame_rate).
    #[inline(always)]
    fn shaped_torque_of_turning_wall(
        &self,
        pose: &Self::Pose,
        n: &SVector<T, N>,
        force: T,
        qd: &SVector<T, N>,
        turning: &SVector<T, N>,
    ) -> ShapedTorque<T, N> {
        let Shaping { e, w_rr, .. } = self.shaping(pose, n);
        let accelerated = self.shaping(pose, &(n * (force / w_rr) + turning)).me;
        ShapedTorque { e, torque: self.velocity_torque(pose, qd) + accelerated }
    }
    /// Returns the terms of equation (4) for one wall at joint velocities `qd` (rad/s). The columns of `basis` are
    /// orthonormal: the wall's normal, the directions across the wall and, on the redundant arm, φ.
    #[inline(always)]
    fn wall_terms(&self, pose: &Self::Pose, basis: &SMatrix<T, N, N>, qd: &SVector<T, N>) -> WallTerms<T, N> {
        let n = basis.column(0).into_owned();
        let row = self.transpose(pose, &n);
        WallTerms {
            e: self.jacobian_inverse(pose) * basis,
            me: self.shaping(pose, &n).me,
            w: in_basis(&self.operational_inertia(pose), basis),
            b: self.velocity_torque(pose, qd) + self.gravity(pose),
            row,
            w_eff: effective_inertia(&self.mass(pose), &row),
        }
    }
    /// Returns Λ = J⁻ᵀ M J⁻¹ (N x N): the inertia in task coordinates.
    fn operational_inertia(&self, pose: &Self::Pose) -> SMatrix<T, N, N> {
        let inverse = self.jacobian_inverse(pose);
        inverse.tr_mul(&(self.mass(pose) * inverse))
    }
    /// Returns true if angles of the joint that differ by a complete turn are the same pose. A prismatic joint never
    /// repeats, nor does a joint whose task coordinate is an arc length.
    fn repeats(&self, _joint: usize) -> bool {
        true
    }
    /// Returns true if the joint slides along its axis instead of turning about it.
    fn is_prismatic(&self, _joint: usize) -> bool {
        false
    }
}

macro_rules! define {
    ($(($Variant:ident, $module:ident, $n:literal))*) => {
        $(
            pub use $module::$Variant;
        )*

        impl Kind {
            /// Returns the contents of this mechanism's device files.
            pub const fn spec(self) -> Spec {
                match self {
                    $(Kind::$Variant => <$Variant<f64> as Mechanism<f64, $n>>::SPEC,)*
                }
            }
        }

        /// A mechanism that is chosen at run time, with its coefficients.
        #[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
        pub enum AnyMechanism<T: Real> {
            $(
                #[doc = concat!("See [`", stringify!($Variant), "`].")]
                $Variant($Variant<T>),
            )*
        }

        impl<T: Real> AnyMechanism<T> {
            /// Computes the mechanism of a description.
            pub fn new(description: &Description) -> Result<Self, DescriptionError> {
                match description.kind {
                    $(Kind::$Variant => <$Variant<T> as Mechanism<T, $n>>::new(description).map(Self::$Variant),)*
                }
            }

            /// Converts to another precision.
            pub fn cast<U: Real>(&self) -> AnyMechanism<U> {
                match self {
                    $(Self::$Variant(mechanism) => AnyMechanism::$Variant(mechanism.cast()),)*
                }
            }

            /// Returns [`Mechanism::repeats`].
            pub fn repeats(&self, joint: usize) -> bool {
                match self {
                    $(Self::$Variant(mechanism) => <$Variant<T> as Mechanism<T, $n>>::repeats(mechanism, joint),)*
                }
            }

            /// Returns [`Mechanism::is_prismatic`].
            pub fn is_prismatic(&self, joint: usize) -> bool {
                match self {
                    $(Self::$Variant(mechanism) => <$Variant<T> as Mechanism<T, $n>>::is_prismatic(mechanism, joint),)*
                }
            }

            /// Returns the units of each joint.
            pub fn units(&self) -> Vec<&'static JointUnits, MAX_JOINTS> {
                (0..self.kind().spec().joints).map(|joint| JointUnits::of(self.is_prismatic(joint))).collect()
            }

            /// Returns the kind of this mechanism.
            pub fn kind(&self) -> Kind {
                match self {
                    $(Self::$Variant(_) => Kind::$Variant,)*
                }
            }
        }

        /// Runs `$body` with `$m` bound to the concrete mechanism inside an [`AnyMechanism`].
        #[macro_export]
        macro_rules! with_mechanism {
            ($any:expr, $m:ident => $body:expr) => {
                match $any {
                    $($crate::model::mechanism::AnyMechanism::$Variant($m) => $body,)*
                }
            };
        }
    };
}

crate::mechanisms!(define);

/// Sine of the angle between the rods or at an elbow below which reciprocals are clamped, so that numbers stay finite.
const SINE_FLOOR: f64 = 1.0e-6;

/// Returns `1 / x` with |x| clamped to at least `floor`, so that the result is finite for any finite `x`.
#[inline(always)]
pub(crate) fn reciprocal<T: Real>(x: T, floor: T) -> T {
    if x.abs() >= floor {
        return T::one() / x;
    }
    let limit = T::one() / floor;
    if x < T::zero() { -limit } else { limit }
}

/// Calls [`Mechanism::pose_at`]. Compiled once per mechanism, because every copy would enlarge the image.
#[inline(never)]
pub(crate) fn shared_pose<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    angles: &[Angle<T>; N],
) -> M::Pose {
    mechanism.pose_at::<K>(angles)
}

/// Calls [`Mechanism::shaping`]. Compiled once per mechanism, because every copy would enlarge the image.
#[inline(never)]
pub(crate) fn shared_shaping<T: Real, M: Mechanism<T, N>, const N: usize>(
    mechanism: &M,
    pose: &M::Pose,
    n: &SVector<T, N>,
) -> Shaping<T, N> {
    mechanism.shaping(pose, n)
}
