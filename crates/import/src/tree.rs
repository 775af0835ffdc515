//! The kinematic tree that URDF and MJCF have in common: bodies, the joints between them, and their inertia.

use crate::xml::{Element, pose};
use haptic_host::error::Failure;
use nalgebra::{Isometry3, Matrix3, Unit, UnitQuaternion, Vector3};

/// A kinematic tree.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Name of the robot; empty if the file has none.
    pub name: String,
    /// Name of the format.
    pub format: &'static str,
    /// Bodies in the order of the file, each after its parent. The first is the base.
    pub bodies: Vec<Body>,
    /// Gravity in the frame of the base, m/s².
    pub gravity: Vector3<f64>,
    /// Remarks for the user about parts of the file that have no counterpart, one sentence each.
    pub remarks: Vec<String>,
}

/// A rigid body.
#[derive(Clone, Debug)]
pub struct Body {
    /// Name of the body.
    pub name: String,
    /// Index of the parent, smaller than the body's own; `None` for the base.
    pub parent: Option<usize>,
    /// Motion from the parent's frame to the body's frame, the steps one after the other.
    pub steps: Vec<Step>,
    /// Inertia in the body's frame.
    pub inertia: Inertia,
}

/// A part of the way from a parent's frame to a body's frame.
#[derive(Clone, Debug)]
pub enum Step {
    /// A constant displacement.
    Fixed(Isometry3<f64>),
    /// A joint.
    Joint(Joint),
}

/// A joint that moves a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name of the joint.
    pub name: String,
    /// Motion of the joint.
    pub motion: Motion,
    /// Direction in the joint's frame.
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

/// Motion that a joint allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Rotation about the axis.
    Revolute,
    /// Translation along the axis.
    Prismatic,
    /// Another motion, named by the file's word. Such a joint can only be held.
    Other(&'static str),
}

impl Joint {
    /// Returns the displacement at the position `q`, rad or m.
    pub fn displacement(&self, q: f64) -> Isometry3<f64> {
        match self.motion {
            Motion::Revolute => pose(Vector3::zeros(), UnitQuaternion::from_axis_angle(&self.axis, q)),
            Motion::Prismatic => pose(self.axis.into_inner() * q, UnitQuaternion::identity()),
            Motion::Other(_) => Isometry3::identity(),
        }
    }
}

/// Mass, centre of mass and inertia tensor of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertia {
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
    pub(crate) fn new(
        element: Element<'_>,
        mass: f64,
        frame: Isometry3<f64>,
        tensor: [f64; 6],
    ) -> Result<Self, Failure> {
        let [xx, yy, zz, xy, xz, yz] = tensor;
        let tensor = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let moments = tensor.symmetric_eigenvalues();
        // Printed tensors have six digits.
        if moments.min() < -1e-5 * moments.max().max(0.0) {
            let reason = format!("a principal moment of inertia is negative ({:.3e} kg m²)", moments.min());
            return Err(element.error(reason, "check the tensor's signs and units (kg m², about the centre of mass)"));
        }
        Ok(Self { mass, com: Vector3::zeros(), tensor }.moved(&frame))
    }
    /// Returns the inertia in a frame in which this one's frame is displaced by `frame`.
    pub fn moved(&self, frame: &Isometry3<f64>) -> Self {
        let rotation = frame.rotation.to_rotation_matrix();
        Self {
            mass: self.mass,
            com: frame.transform_point(&self.com.into()).coords,
            tensor: rotation * self.tensor * rotation.transpose(),
        }
    }
    /// Returns the inertia of both bodies joined.
    pub fn joined(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass == 0.0 {
            return Self { tensor: self.tensor + other.tensor, ..*self };
        }
        let com = (self.com * self.mass + other.com * other.mass) / mass;
        let about = |part: &Self| {
            let r = part.com - com;
            part.tensor + (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * part.mass
        };
        Self { mass, com, tensor: about(self) + about(other) }
    }
}
