//! The analysis's matrices for a device description and joint angles.

use super::flexible::{Flexible, Hand};
use super::plant::{Linearised, MotorElectrics};
use super::subject::Subject;
use haptic_bridge::math::FineTable;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, DescriptionError};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism, Regularity, Shaping};
use haptic_bridge::with_mechanism;
use haptic_host::vectors::{padded_to, unit};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use thiserror::Error;

/// Smallest sine of the singular angle that is analysed.
pub const LEAST_ANALYSED_SINE: f64 = 1e-6;

/// Reason why a pose cannot be analysed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PoseError {
    /// The number of joint angles is wrong.
    #[error("this device has {joints} joints, so a pose has {joints} angles, not {found}")]
    Joints {
        /// Number of joints of the device, N.
        joints: usize,
        /// Number of angles in the pose.
        found: usize,
    },
    /// The number of entries in a normal is wrong.
    #[error("this device's task has {task} dimensions, so a normal has {task} entries, not {found}")]
    Normal {
        /// Task dimension of the device, d.
        task: usize,
        /// Number of entries in the normal.
        found: usize,
    },
    /// The normal is zero, infinite or NaN.
    #[error("a normal must be finite and not zero")]
    NoDirection,
    /// A joint angle is not finite.
    #[error("joint angles must be finite numbers of radians")]
    Angle,
    /// The arm is stretched or folded.
    #[error("this pose is singular: the arm is in line with itself, so the tip cannot move in every direction")]
    Serial,
    /// The closed loop is stretched or cannot close.
    #[error("this pose is singular or cannot be reached: the closed linkage is stretched to a line or does not close")]
    Parallel,
    /// The description is not valid.
    #[error(transparent)]
    Description(#[from] DescriptionError),
}

impl From<PoseError> for haptic_host::error::Failure {
    fn from(error: PoseError) -> Self {
        match error {
            PoseError::Serial | PoseError::Parallel => {
                Self::impossible(error).remedy("choose joint angles away from the singularity")
            }
            _ => Self::wrong(error),
        }
    }
}

/// The device at one pose, in task coordinates.
#[derive(Clone, Debug)]
pub struct TaskPose {
    /// Position of the tip, m (d entries).
    pub position: Vec<f64>,
    /// J, N x N.
    pub jacobian: DMatrix<f64>,
    /// J⁻¹, N x N.
    pub inverse: DMatrix<f64>,
    /// M, N x N, kg m².
    pub mass: DMatrix<f64>,
    /// Λ = J⁻ᵀ M J⁻¹, N x N.
    pub operational: DMatrix<f64>,
    /// Distances from singularities.
    pub regularity: Regularity<f64>,
    /// Task dimension, d.
    pub task: usize,
}

impl TaskPose {
    /// Computes the pose. Rejects wrong lengths but not singular poses (see [`TaskPose::regular`]).
    pub fn at(description: &Description, q: &[f64]) -> Result<Self, PoseError> {
        Self::of(&AnyMechanism::new(description)?, q)
    }

    /// Like [`TaskPose::at`], for an existing mechanism.
    pub fn of(mechanism: &AnyMechanism<f64>, q: &[f64]) -> Result<Self, PoseError> {
        with_mechanism!(mechanism, m => evaluate(m, q))
    }

    /// Replaces φ by another coordinate as the last task coordinate of a redundant device, in J, J⁻¹ and Λ.
    pub fn holding(mut self, admissible: Admissible) -> Self {
        let joints = self.mass.nrows();
        if self.task == joints || admissible == Admissible::Orientation {
            return self;
        }
        let shaping = |e: SVector<f64, MAX_JOINTS>| Shaping::of(&SMatrix::from_fn(|i, j| self.mass[(i, j)]), e);
        let column = |i: usize| SVector::<f64, MAX_JOINTS>::from_fn(|j, _| self.inverse[(j, i)]);
        let null = shaping(column(joints - 1));
        let mut inverse = self.inverse.clone();
        for i in 0..self.task {
            let held = admissible.hold(&shaping(column(i)), &null);
            inverse.column_mut(i).copy_from(&held.e);
        }
        // Scales the last column so that the new coordinate is the angle of the held joint.
        if let Some(joint) = admissible.joint() {
            let scaled = inverse.column(joints - 1) / inverse[(joint, joints - 1)];
            inverse.set_column(joints - 1, &scaled);
        }
        if let Some(jacobian) = inverse.clone().try_inverse() {
            self.operational = inverse.tr_mul(&(&self.mass * &inverse));
            (self.jacobian, self.inverse) = (jacobian, inverse);
        }
        self
    }

    /// Returns the pose, or an error if the pose is singular.
    pub fn regular(self) -> Result<Self, PoseError> {
        check_regular(&self.regularity)?;
        Ok(self)
    }
}

/// Two properties of a pose for a search over many poses, computed without dynamic matrices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stance {
    /// Distances from singularities.
    pub regularity: Regularity<f64>,
    /// Side of the singularities; true if J's determinant is positive.
    pub positive: bool,
}

impl Stance {
    /// Computes the properties at joint angles `q` (rad). Rejects wrong lengths but not singular poses.
    pub fn of(mechanism: &AnyMechanism<f64>, q: &[f64]) -> Result<Self, PoseError> {
        check_angles(q, mechanism.kind().spec().joints)?;
        Ok(with_mechanism!(mechanism, m => {
            let pose = m.pose::<FineTable>(&SVector::from_column_slice(q));
            Self { regularity: m.regularity(&pose), positive: m.jacobian(&pose).determinant() > 0.0 }
        }))
    }

    /// Returns true if the pose is at least the sine `sine` away from all singularities.
    pub fn is_clear(&self, sine: f64) -> bool {
        self.regularity.serial >= sine && self.regularity.parallel >= sine
    }
}

/// Rejects a wrong number of joint angles, and angles that are not finite.
pub fn check_angles(q: &[f64], joints: usize) -> Result<(), PoseError> {
    if q.len() != joints {
        return Err(PoseError::Joints { joints, found: q.len() });
    }
    if q.iter().any(|angle| !angle.is_finite()) {
        return Err(PoseError::Angle);
    }
    Ok(())
}

/// Rejects singular poses.
pub fn check_regular(regularity: &Regularity<f64>) -> Result<(), PoseError> {
    if regularity.parallel.is_nan() || regularity.parallel < LEAST_ANALYSED_SINE {
        Err(PoseError::Parallel)
    } else if regularity.serial.is_nan() || regularity.serial < LEAST_ANALYSED_SINE {
        Err(PoseError::Serial)
    } else {
        Ok(())
    }
}

fn evaluate<const N: usize, M: Mechanism<f64, N>>(mechanism: &M, q: &[f64]) -> Result<TaskPose, PoseError> {
    check_angles(q, N)?;
    let pose = mechanism.pose::<FineTable>(&SVector::from_column_slice(q));
    let dense = |m: nalgebra::SMatrix<f64, N, N>| DMatrix::from_iterator(N, N, m.iter().copied());
    Ok(TaskPose {
        position: mechanism.tip(&pose).iter().copied().take(M::SPEC.task).collect(),
        jacobian: dense(mechanism.jacobian(&pose)),
        inverse: dense(mechanism.jacobian_inverse(&pose)),
        mass: dense(mechanism.mass(&pose)),
        operational: dense(mechanism.operational_inertia(&pose)),
        regularity: mechanism.regularity(&pose),
        task: M::SPEC.task,
    })
}

/// Scales `normal` to unit length and pads it with zeros to N entries.
pub fn unit_normal(normal: &[f64], task: usize, joints: usize) -> Result<DVector<f64>, PoseError> {
    if normal.len() != task {
        return Err(PoseError::Normal { task, found: normal.len() });
    }
    Ok(padded_to(joints, &unit(normal).ok_or(PoseError::NoDirection)?))
}

impl Linearised {
    /// Linearises the device at rest at `q` (rad) along `normal` (d entries, any length but zero).
    pub fn at(description: &Description, q: &[f64], normal: &[f64]) -> Result<Self, PoseError> {
        Self::holding(description, q, normal, Admissible::default())
    }

    /// Like [`Linearised::at`], for a redundant device whose feed-forward holds `admissible`.
    pub fn holding(
        description: &Description,
        q: &[f64],
        normal: &[f64],
        admissible: Admissible,
    ) -> Result<Self, PoseError> {
        Subject::new(description)?.linearise_along(q, normal, admissible)
    }

    /// Like [`Linearised::holding`], for a [`Device`] without its compliant parts. [`super::prediction`] includes them.
    pub fn of(device: &Device<f64>, q: &[f64], normal: &[f64], admissible: Admissible) -> Result<Self, PoseError> {
        let pose = TaskPose::of(&device.mechanism, q)?.regular()?.holding(admissible);
        let joints = q.len();
        let n = unit_normal(normal, pose.task, joints)?;
        Ok(Linearised {
            gain: 1.0,
            row: pose.jacobian.tr_mul(&n),
            unit_motion: &pose.inverse * &n,
            viscous: DVector::from_fn(joints, |j, _| device.joints[j].viscous),
            mass: pose.mass,
            flexible: Flexible {
                tip: pose.jacobian.rows(0, pose.task).into_owned(),
                normal: n.rows(0, pose.task).into_owned(),
                ..Flexible::default()
            },
        })
    }

    /// Adds a hand.
    pub fn with_hand(mut self, hand: Hand) -> Self {
        self.flexible.hand = hand;
        self
    }

    /// Removes joint damping.
    pub fn undamped(mut self) -> Self {
        self.viscous.fill(0.0);
        self
    }
}

impl Subject {
    /// Linearises the device at rest at `q` (rad), along `normal` (d entries, any length but zero).
    pub fn linearise_along(&self, q: &[f64], normal: &[f64], admissible: Admissible) -> Result<Linearised, PoseError> {
        let mut linearised = Linearised::of(&self.device, q, normal, admissible)?;
        let Flexible { transmissions, modes, .. } = self.compliant_parts();
        (linearised.flexible.transmissions, linearised.flexible.modes) = (transmissions, modes);
        Ok(linearised)
    }
}

/// Returns the motors of all joints, or `None` if a joint has no motor.
pub fn motors(description: &Description) -> Option<Vec<MotorElectrics>> {
    let joints = description.kind.spec().joints;
    description.joints[..joints]
        .iter()
        .map(|joint| {
            joint.motor.map(|motor| MotorElectrics {
                torque_constant: motor.torque_constant,
                back_emf: motor.back_emf,
                resistance: motor.resistance,
                inductance: motor.inductance,
            })
        })
        .collect()
}
