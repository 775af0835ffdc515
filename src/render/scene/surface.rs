//! The list of wall shapes.

use super::Contact;
use super::cylinder::Cylinder;
use super::plane::Plane;
use super::shape::{Meaning, Shape, ShapeSpec, Values};
use super::sphere::Sphere;
use crate::math::{Math, Real};
use nalgebra::SVector;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

macro_rules! shapes {
    ($($(#[$doc:meta])* $Shape:ident;)*) => {
        /// A wall's shape. Vectors are in the task frame; entries beyond the task dimension are zero.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
        pub enum Surface<T> { $($(#[$doc])* $Shape($Shape<T>),)* }

        impl<T: Real> Surface<T> {
            /// Entries of all shapes in scene files.
            pub const SPECS: &'static [ShapeSpec] = &[$(<$Shape<T> as Shape<T>>::SPEC),*];

            /// Returns the shape's entry in scene files.
            pub fn spec(&self) -> ShapeSpec {
                match self { $(Self::$Shape(_) => <$Shape<T> as Shape<T>>::SPEC,)* }
            }

            /// Makes the shape of this name from these values; `None` for an unknown name.
            pub fn from_values(name: &str, values: &Values<T>) -> Option<Self> {
                $(if name == <$Shape<T> as Shape<T>>::SPEC.name {
                    return Some(Self::$Shape(Shape::from_values(values)));
                })*
                None
            }

            /// Returns the shape's values, in the order of [`ShapeSpec::keys`].
            pub fn values(&self) -> Values<T> {
                match self { $(Self::$Shape(shape) => shape.values(),)* }
            }

            /// Converts to another precision.
            pub fn cast<U: Real>(&self) -> Surface<U> {
                let values = self.values().map(|value| U::from_f64(value.to_f64()));
                match self { $(Self::$Shape(_) => Surface::$Shape(Shape::from_values(&values)),)* }
            }

            /// Returns true if the normal depends on the tip position.
            pub fn is_curved(&self) -> bool {
                match self { $(Self::$Shape(_) => <$Shape<T> as Shape<T>>::CURVED,)* }
            }

            /// Returns the contact of a curved surface. Not inlined, because the mechanisms share it.
            #[inline(never)]
            fn curved_contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
                match self { $(Self::$Shape(shape) => shape.contact::<K, N>(p),)* }
            }

            /// Returns ṅ (1/s) at the tip position `p` moving at `velocity` (m/s). Not inlined, as planes return zero.
            #[inline(never)]
            pub fn normal_rate<K: Math<T>, const N: usize>(
                &self,
                p: &SVector<T, N>,
                velocity: &SVector<T, N>,
            ) -> SVector<T, N> {
                match self { $(Self::$Shape(shape) => shape.normal_rate::<K, N>(p, velocity),)* }
            }
        }
    };
}

shapes! {
    /// A half-space.
    Plane;
    /// A ball, or the space outside it (in the plane: a disc).
    Sphere;
    /// A cylinder, or the space outside it (in space only).
    Cylinder;
}

impl<T: Real> Surface<T> {
    /// Returns the distance and the normal at the tip position `p` (m).
    #[inline(always)]
    pub fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N> {
        let (distance, normal) = match self {
            Self::Plane(plane) => {
                let Contact { distance, normal } = plane.contact::<K, N>(p);
                (distance, normal.map(|n| n))
            }
            curved => {
                // Copies `p`, so that `p` can stay in registers for planes.
                let p = *p;
                let Contact { distance, normal } = curved.curved_contact::<K, N>(&p);
                (distance, normal.map(|n| n))
            }
        };
        Contact { distance, normal }
    }

    /// Returns true for a ball and for the space outside a ball.
    pub(crate) fn is_sphere(&self) -> bool {
        matches!(self, Self::Sphere(_))
    }

    /// Returns [`Surface::contact`], inlined for a ball, and the curvature of the surface (1/m): the normal's rotation
    /// per tip motion, negative inside. Every other shape counts as flat.
    #[inline(always)]
    pub(crate) fn contact_and_curvature<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> (Contact<T, N>, T) {
        match self {
            Self::Sphere(sphere) => sphere.contact_and_curvature::<K, N>(p),
            other => (other.contact::<K, N>(p), T::zero()),
        }
    }

    /// Returns true if every value is valid for its meaning, for a device of task dimension `task`.
    pub(super) fn is_valid(&self, task: usize) -> bool {
        let values = self.values();
        let mut rest = values.as_slice();
        self.spec().keys.iter().all(|(_, meaning)| {
            let Some((value, after)) = rest.split_at_checked(meaning.width()) else { return false };
            rest = after;
            let flat = || value.iter().skip(task).all(|entry| *entry == T::zero());
            let squared = value.iter().fold(T::zero(), |sum, entry| sum + *entry * *entry);
            match meaning {
                Meaning::Point => flat() && value.iter().all(|entry| entry.is_finite()),
                Meaning::Direction => flat() && super::is_unit(squared),
                Meaning::Length => value.iter().all(|length| *length > T::zero() && length.is_finite()),
                Meaning::Flag => true,
            }
        })
    }
}
