//! The interface of a wall's shape: its distance from the tip, and the values that a scene file gives for it.
//!
//! A shape is one file beside this one and one line in the list of [`surface`](super::surface). Scene files, checks and
//! conversion between precisions follow from its [`ShapeSpec`].

use super::Contact;
use crate::math::{Math, Real};
use nalgebra::SVector;

/// Most numbers that the values of a shape take together.
pub const SHAPE_VALUES: usize = 8;

/// The values of a shape as numbers, in the order of its [`ShapeSpec::keys`].
pub type Values<T> = [T; SHAPE_VALUES];

/// The meaning of a shape's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A point of the task frame, m: three numbers, zero beyond the task.
    Point,
    /// A unit vector: three numbers.
    Direction,
    /// A positive length, m.
    Length,
    /// 1 for yes, 0 for no.
    Flag,
}

impl Meaning {
    /// Number of floats that it takes.
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
    /// Its word for `shape`.
    pub name: &'static str,
    /// The least task dimension in which it exists.
    pub least_task: usize,
    /// Its keys besides those that every wall has.
    pub keys: &'static [(&'static str, Meaning)],
}

/// A wall's shape.
pub trait Shape<T: Real>: Copy {
    /// Its entry in scene files.
    const SPEC: ShapeSpec;
    /// True if its normal turns with the tip.
    const CURVED: bool = true;
    /// The shape with these values.
    fn from_values(values: &Values<T>) -> Self;
    /// Its values.
    fn values(&self) -> Values<T>;
    /// Distance and normal at the tip position `p` (m).
    fn contact<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>) -> Contact<T, N>;
    /// ṅ (1/s) at the tip position `p` (m) moving at `velocity` (m/s).
    fn normal_rate<K: Math<T>, const N: usize>(&self, p: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N>;
}

/// 1 for true.
pub(super) fn number<T: Real>(flag: bool) -> T {
    if flag { T::one() } else { T::zero() }
}
