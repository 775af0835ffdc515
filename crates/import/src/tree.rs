//! The kinematic tree that URDF and MJCF have in common: bodies, the joints between them, and their inertia.

use crate::xml::{Element, pose};
use haptic_host::error::Failure;
use nalgebra::{Isometry3, Matrix3, Unit, UnitQuaternion, Vector3};

pub(crate) struct Tree {
    /// Name of the robot; empty if the file has none.
    pub name: String,
    /// Bodies in the order of the file, each after its parent. The first is the base.
    pub bodies: Vec<Body>,
    /// Gravity in the frame of the base, m/s².
    pub gravity: Vector3<f64>,
    /// Sentences about parts of the file that have no counterpart.
    pub remarks: Vec<String>,
}

pub(crate) struct Body {
    pub name: String,
    /// Index of the parent, smaller than the body's own; `None` for the base.
    pub parent: Option<usize>,
    /// Motion from the parent's frame to the body's frame, the steps one after the other.
    pub steps: Vec<Step>,
    /// Inertia in the body's frame.
    pub inertia: Inertia,
}

pub(crate) enum Step {
    Fixed(Isometry3<f64>),
    Joint(Joint),
}

#[derive(Clone)]
pub(crate) struct Joint {
    pub name: String,
    pub motion: Motion,
    pub axis: Unit<Vector3<f64>>,
    /// Lowest and highest position, rad or m.
    pub limits: Option<[f64; 2]>,
    /// Viscous friction, N m s/rad or N s/m.
    pub viscous: f64,
    /// Dry friction, N m or N.
    pub coulomb: f64,
    /// Rotor inertia reflected to the joint, kg m² or kg.
    pub inertia: f64,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Motion {
    Revolute,
    Prismatic,
    /// Any other motion. Such a joint can only be held.
    Other,
}

impl Joint {
    /// Returns the displacement at the position `q`, rad or m.
    pub fn displacement(&self, q: f64) -> Isometry3<f64> {
        match self.motion {
            Motion::Revolute => pose(Vector3::zeros(), UnitQuaternion::from_axis_angle(&self.axis, q)),
            Motion::Prismatic => pose(self.axis.into_inner() * q, UnitQuaternion::identity()),
            Motion::Other => Isometry3::identity(),
        }
    }
}

#[derive(Clone, Copy, Default, PartialEq)]
pub(crate) struct Inertia {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass, m.
    pub com: Vector3<f64>,
    /// Tensor about the centre of mass, along the axes of the frame, kg m².
    pub tensor: Matrix3<f64>,
}

impl Inertia {
    /// Creates an inertia from the values at `element`, whose frame is displaced by `frame`. `tensor` is ixx, iyy, izz,
    /// ixy, ixz, iyz.
    pub fn new(element: Element<'_>, mass: f64, frame: Isometry3<f64>, tensor: [f64; 6]) -> Result<Self, Failure> {
        let [xx, yy, zz, xy, xz, yz] = tensor;
        let tensor = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let moments = tensor.symmetric_eigenvalues();
        // Printed tensors have six digits.
        if moments.min() < -1e-5 * moments.max().max(0.0) {
            let reason = format!("a principal moment of inertia is negative ({:.3e} kg m²)", moments.min());
            return Err(element.error("", reason, "check signs and units (kg m², about the centre of mass)"));
        }
        Ok(Self { mass, com: Vector3::zeros(), tensor }.moved(&frame))
    }
    /// Returns the inertia in a frame in which this one's frame is displaced by `frame`.
    pub fn moved(&self, frame: &Isometry3<f64>) -> Self {
        let rotation = frame.rotation.to_rotation_matrix();
        let com = frame.transform_point(&self.com.into()).coords;
        Self { mass: self.mass, com, tensor: rotation * self.tensor * rotation.transpose() }
    }
    /// Returns the inertia of both bodies joined.
    pub fn joined(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let com = (self.com * self.mass + other.com * other.mass) / if mass > 0.0 { mass } else { 1.0 };
        let about = |part: &Self| {
            let r = part.com - com;
            part.tensor + (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * part.mass
        };
        Self { mass, com, tensor: about(self) + about(other) }
    }
}
