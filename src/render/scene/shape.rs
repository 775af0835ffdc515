//! The interface of a wall's shape: distance from the tip, and values in a scene file.
//!
//! A shape is one file next to this file and one line in the list of [`surface`](super::surface). Its [`ShapeSpec`]
//! defines scene files, checks and conversion between precisions.

use super::Contact;
use crate::math::{Math, Real};
use nalgebra::SVector;

/// Maximum number of values of a shape.
pub const SHAPE_VALUES: usize = 8;
/// Values of a shape, in the order of [`ShapeSpec::keys`].
pub type Values<T> = [T; SHAPE_VALUES];

/// The meaning of a shape's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A point in the task frame, m: three numbers, zero beyond the task.
    Point,
    /// A unit vector: three numbers.
    Direction,
    /// A positive length, m.
    Length,
    /// 1 for yes, 0 for no.
    Flag,
}

impl Meaning {
    /// Returns the number of floats of the value.
    pub const fn width(self) -> usize {
        match self {
            Self::Point | Self::Direction => 3,
            Self::Length | Self::Flag => 1,
        }
    }
}

/// The entry of a shape in scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeSpec {
    /// Value of the key `shape` in scene files.
    pub name: &'static str,
    /// Smallest task dimension in which the shape exists.
    pub least_task: usize,
    /// Keys in addition to the common keys of walls.
    pub keys: &'static [(&'static str, Meaning)],
}

/// A wall's shape.
pub trait Shape<T: Real>: Copy {
    /// Entry in scene files.
    const SPEC: ShapeSpec;
    /// True if the normal depends on the tip position.
    const CURVED: bool = true;
    /// Makes the shape from these values.
    fn from_values(values: &Values<T>) -> Self;
    /// Returns the shape's values.
    fn values(&self) -> Values<T>;
    /// Returns the distance and the normal at the tip position `p` (m).
    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N>;
    /// Returns ṅ (1/s) at the tip position `p` (m) moving at `velocity` (m/s).
    fn normal_rate<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N>;
}

/// Converts a flag to a number: 1 for true.
pub(super) fn number<T: Real>(flag: bool) -> T {
    if flag { T::one() } else { T::zero() }
}
