//! `paddle` and `paddles`: one to three pivots with a handle each (Hapkit-like), without coupling. The task coordinates
//! are the handles' arc lengths, xᵢ = lengthᵢ qᵢ.

use super::{Mechanism, Regularity, Shaping};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{MAX_JOINTS, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{SMatrix, SVector};

/// Coefficients of N paddles.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Paddles<T, const N: usize> {
    /// Distance from each pivot to its handle, m.
    lengths: [T; MAX_JOINTS],
    inverse_lengths: [T; MAX_JOINTS],
    /// Inertia of body, rotor and handle about each pivot, kg m².
    inertias: [T; MAX_JOINTS],
    /// First moment of mass along each handle times gravity, N m.
    weights: [[T; 2]; MAX_JOINTS],
    /// True if gravity acts on any paddle.
    has_weight: bool,
}

/// One paddle.
pub type Paddle<T> = Paddles<T, 1>;
/// Two paddles.
pub type Paddles2<T> = Paddles<T, 2>;
/// Three paddles.
pub type Paddles3<T> = Paddles<T, 3>;

/// Quantities that depend on the angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real, const N: usize> {
    /// The handles' arc lengths, m.
    arcs: SVector<T, N>,
    /// Sine and cosine of each angle; unused without weight.
    directions: [(T, T); N],
}

impl<T: Real, const N: usize> Paddles<T, N> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Paddles<U, N> {
        Paddles {
            lengths: self.lengths.map(cast),
            inverse_lengths: self.inverse_lengths.map(cast),
            inertias: self.inertias.map(cast),
            weights: self.weights.map(|weight| weight.map(cast)),
            has_weight: self.has_weight,
        }
    }
}

impl<T: Real, const N: usize> Mechanism<T, N> for Paddles<T, N> {
    const SPEC: Spec = Spec {
        name: if N == 1 { "paddle" } else { "paddles" },
        label: match N {
            1 => "paddle",
            2 => "paddles-2",
            _ => "paddles-3",
        },
        joints: N,
        task: N,
        links: match N {
            1 => &["handle"],
            2 => &["handle-1", "handle-2"],
            _ => &["handle-1", "handle-2", "handle-3"],
        },
        are_links_optional: true,
        geometry: if N == 1 { &[("length", 1)] } else { &[("lengths", N)] },
        gravity: 2,
    };
    type Pose = Pose<T, N>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind.spec() != Self::SPEC {
            return Err(DescriptionError::WrongKind);
        }
        let zero = [T::zero(); MAX_JOINTS];
        let mut paddles = Self {
            lengths: zero,
            inverse_lengths: zero,
            inertias: zero,
            weights: [[T::zero(); 2]; MAX_JOINTS],
            has_weight: false,
        };
        let [gx, gy, _] = description.gravity;
        for (i, (joint, link)) in description.joints.iter().zip(&description.links).enumerate().take(N) {
            let length = description.geometry[i];
            if length.is_nan() || length <= 0.0 {
                return Err(DescriptionError::GeometryNotPositive(i));
            }
            let handle = if N == 1 { description.handle_mass } else { 0.0 };
            let inertia = joint.inertia + link.inertia + link.mass * link.com * link.com + handle * length * length;
            if inertia.is_nan() || inertia <= 0.0 {
                return Err(DescriptionError::NoInertia);
            }
            paddles.lengths[i] = T::from_f64(length);
            paddles.inverse_lengths[i] = T::from_f64(1.0 / length);
            paddles.inertias[i] = T::from_f64(inertia);
            let moment = link.mass * link.com + handle * length;
            paddles.has_weight |= moment * gx != 0.0 || moment * gy != 0.0;
            paddles.weights[i] = [T::from_f64(moment * gx), T::from_f64(moment * gy)];
        }
        Ok(paddles)
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; N]) -> Pose<T, N> {
        let mut directions = [(T::zero(), T::zero()); N];
        if self.has_weight {
            for (direction, angle) in directions.iter_mut().zip(q) {
                *direction = K::sin_cos_of(*angle);
            }
        }
        Pose { arcs: SVector::from_fn(|i, _| self.lengths[i] * q[i].radians), directions }
    }
    #[inline(always)]
    fn tip(&self, pose: &Pose<T, N>) -> SVector<T, N> {
        pose.arcs
    }
    fn regularity(&self, _: &Pose<T, N>) -> Regularity<T> {
        Regularity { serial: T::one(), parallel: T::one() }
    }
    #[inline(always)]
    fn jacobian(&self, _: &Pose<T, N>) -> SMatrix<T, N, N> {
        SMatrix::from_fn(|i, j| if i == j { self.lengths[i] } else { T::zero() })
    }
    #[inline(always)]
    fn transpose(&self, _: &Pose<T, N>, force: &SVector<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| self.lengths[i] * force[i])
    }
    #[inline(always)]
    fn velocity(&self, _: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| self.lengths[i] * qd[i])
    }
    fn jacobian_rate(&self, _: &Pose<T, N>, _: &SVector<T, N>) -> SMatrix<T, N, N> {
        SMatrix::zeros()
    }
    #[inline(always)]
    fn mass(&self, _: &Pose<T, N>) -> SMatrix<T, N, N> {
        SMatrix::from_fn(|i, j| if i == j { self.inertias[i] } else { T::zero() })
    }
    fn coriolis(&self, _: &Pose<T, N>, _: &SVector<T, N>) -> SVector<T, N> {
        SVector::zeros()
    }
    #[inline(always)]
    fn velocity_torque(&self, _: &Pose<T, N>, _: &SVector<T, N>) -> SVector<T, N> {
        SVector::zeros()
    }
    #[inline(always)]
    fn gravity(&self, pose: &Pose<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| {
            let (sine, cosine) = pose.directions[i];
            self.weights[i][0] * sine - self.weights[i][1] * cosine
        })
    }
    #[inline(always)]
    fn inverse(&self, _: &Pose<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        SVector::from_fn(|i, _| velocity[i] * self.inverse_lengths[i])
    }
    #[inline(always)]
    fn shaping(&self, pose: &Pose<T, N>, n: &SVector<T, N>) -> Shaping<T, N> {
        let e = self.inverse(pose, n);
        let me = SVector::from_fn(|i, _| self.inertias[i] * e[i]);
        Shaping { e, me, w_rr: e.dot(&me) }
    }
    fn repeats(&self, _: usize) -> bool {
        false
    }
}
