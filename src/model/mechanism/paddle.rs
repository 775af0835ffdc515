//! `paddle`: one pivot with a handle (Hapkit-like). The task coordinate is the handle's arc length, x = length q.

use super::{Mechanism, Regularity};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{SMatrix, SVector};

/// Coefficients of a paddle.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Paddle<T> {
    /// Distance from the pivot to the handle, m.
    length: T,
    inverse_length: T,
    /// Inertia of body, rotor and handle about the pivot, kg m².
    inertia: T,
}

impl<T: Real> Paddle<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Paddle<U> {
        Paddle { length: cast(self.length), inverse_length: cast(self.inverse_length), inertia: cast(self.inertia) }
    }
}

impl<T: Real> Mechanism<T, 1> for Paddle<T> {
    const SPEC: Spec =
        Spec { name: "paddle", joints: 1, task: 1, links: &[], geometry: &[("length", 1)], periodic: false };
    /// The handle's arc length, m.
    type Pose = T;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::Paddle {
            return Err(DescriptionError::WrongKind);
        }
        let length = description.geometry[0];
        if length.is_nan() || length <= 0.0 {
            return Err(DescriptionError::GeometryNotPositive(0));
        }
        if description.gravity[0] != 0.0 {
            return Err(DescriptionError::GravityNotZero);
        }
        let inertia = description.joints[0].inertia + description.handle_mass * length * length;
        if inertia.is_nan() || inertia <= 0.0 {
            return Err(DescriptionError::NoInertia);
        }
        Ok(Self {
            length: T::from_f64(length),
            inverse_length: T::from_f64(1.0 / length),
            inertia: T::from_f64(inertia),
        })
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, [q]: &[Angle<T>; 1]) -> T {
        self.length * q.radians
    }
    #[inline(always)]
    fn tip(&self, pose: &T) -> SVector<T, 1> {
        SVector::from([*pose])
    }
    fn regularity(&self, _: &T) -> Regularity<T> {
        Regularity { serial: T::one(), parallel: T::one() }
    }
    #[inline(always)]
    fn jacobian(&self, _: &T) -> SMatrix<T, 1, 1> {
        SMatrix::from([[self.length]])
    }
    fn jacobian_rate(&self, _: &T, _: &SVector<T, 1>) -> SMatrix<T, 1, 1> {
        SMatrix::zeros()
    }
    #[inline(always)]
    fn mass(&self, _: &T) -> SMatrix<T, 1, 1> {
        SMatrix::from([[self.inertia]])
    }
    fn coriolis(&self, _: &T, _: &SVector<T, 1>) -> SVector<T, 1> {
        SVector::zeros()
    }
    #[inline(always)]
    fn velocity_torque(&self, _: &T, _: &SVector<T, 1>) -> SVector<T, 1> {
        SVector::zeros()
    }
    fn gravity(&self, _: &T) -> SVector<T, 1> {
        SVector::zeros()
    }
    #[inline(always)]
    fn inverse(&self, _: &T, velocity: &SVector<T, 1>) -> SVector<T, 1> {
        velocity * self.inverse_length
    }
}
