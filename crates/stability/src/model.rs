//! The paper's quantities for a device at one configuration, as `haptic model` prints them (docs/files.md).
//!
//! The shared library computes the numbers in f64, or in f32 with the board's mechanism and trigonometry.

use crate::perception::Perception;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{FineTable, Math, Real};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::principal::{Principal, Pull};
use haptic_bridge::with_mechanism;
use haptic_host::device_file::DeviceFile;
use nalgebra::{DMatrix, SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// A matrix as a list of rows.
pub type Rows = Vec<Vec<f64>>;

/// Arithmetic of a computation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// The board's arithmetic: 32-bit floats and its own trigonometry.
    F32,
    /// The analysis's arithmetic: 64-bit floats.
    #[default]
    F64,
}

impl Precision {
    /// All precisions with their names.
    pub const ALL: [(&'static str, Self); 2] = [("f64", Self::F64), ("f32", Self::F32)];
}

/// A wall with its force.
#[derive(Clone, Debug, PartialEq)]
pub struct WallForce {
    /// Unit normal, d entries.
    pub normal: Vec<f64>,
    /// Force along the normal, N.
    pub force: f64,
    /// Stiffness in any unit common to all walls; for several walls it determines the rendered directions.
    pub stiffness: f64,
    /// True if the wall uses the feed-forward.
    pub feed_forward: bool,
}

/// One principal direction of the stiffness of several walls (docs/model.md section 2).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Direction {
    /// Unit vector, d entries.
    pub along: Vec<f64>,
    /// Stiffness along the unit vector, relative to the stiffest wall.
    pub stiffness: f64,
    /// Share of the force for the level of this direction and the stiffer directions; `None` for the last direction.
    pub share: Option<f64>,
}

/// All quantities of equation (4), for R rendered directions, N joints and d task dimensions.
///
/// Sizes are in parentheses. One wall renders its normal; several walls render the principal directions of their
/// stiffness in descending order of stiffness.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Position of the tip, m (d).
    pub position: Vec<f64>,
    /// Jacobian of the tip, m/rad (d x N).
    pub jacobian: Rows,
    /// M, kg m² (N x N).
    pub mass: Rows,
    /// c(q, q̇) + g(q), N m (N).
    pub bias: Vec<f64>,
    /// Wrr, kg (R x R).
    pub w_rr: Rows,
    /// Wra (R x N-R).
    pub w_ra: Rows,
    /// Waa (N-R x N-R).
    pub w_aa: Rows,
    /// zr, N (R).
    pub z_r: Vec<f64>,
    /// za (N-R).
    pub z_a: Vec<f64>,
    /// Weff, kg (R x R).
    pub w_eff: Rows,
    /// Wrr - Weff, kg (R x R).
    pub coupling: Rows,
    /// fa of equation (4), N-R entries.
    pub f_a: Vec<f64>,
    /// Torques τ of (4) with g in z, N m (N); for several walls by the levels of docs/model.md section 2.
    pub torque: Vec<f64>,
    /// Jrᵀ fr, N m (N).
    pub torque_without_feed_forward: Vec<f64>,
    /// Condition numbers.
    pub condition: Condition,
    /// Inertia that a hand feels at the tip.
    pub perception: Perception,
    /// Directions that several walls render, in descending order of stiffness; empty for one wall.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub directions: Vec<Direction>,
}

/// Condition numbers in the 2-norm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// Condition number of the tip Jacobian (d x N).
    pub jacobian: f64,
    /// Condition number of the mass matrix M.
    pub mass: f64,
}

/// Reason why the quantities cannot be computed at a configuration.
#[derive(Clone, Debug, PartialEq)]
pub enum ModelError {
    /// J loses rank: joint velocities along `joints` neither move the tip nor, on a redundant arm, turn the last link.
    Serial {
        /// True if the task has the orientation φ as its last entry.
        oriented: bool,
        /// Joint motion that does not move the tip, a unit vector (N).
        joints: Vec<f64>,
        /// Task direction that no joint motion reaches, a unit vector (N).
        lost: Vec<f64>,
    },
    /// J⁻¹ loses rank: the tip moves along `free` while the joints are held.
    Parallel {
        /// Task direction that the joints do not hold, a unit vector (N).
        free: Vec<f64>,
    },
    /// The closing links do not meet at these angles, or only when they are in one line.
    CannotClose,
    /// A result is infinite or not a number.
    NotFinite,
}

impl core::fmt::Display for ModelError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Serial { oriented, joints, lost } => {
                write!(f, "serial singularity: {} without moving the tip", moving_joints(joints))?;
                write!(f, "{}", if *oriented { " or turning its link" } else { "" })?;
                write!(f, " (an arm is stretched, folded or on its turning axis), so that no joint motion")?;
                write!(f, " moves it along {}", vector(lost))?;
                write!(f, "{}", if *oriented { " (x, y, orientation)" } else { "" })
            }
            Self::Parallel { free } => {
                write!(f, "parallel singularity: the distal links are in one line, and")?;
                write!(f, " the tip moves along {} with every joint held still", vector(free))
            }
            Self::CannotClose => f.write_str(
                "parallel singularity or out of reach: at these angles the distal links do not meet, or only in one line",
            ),
            Self::NotFinite => f.write_str("the numbers overflow at this configuration"),
        }
    }
}

impl std::error::Error for ModelError {}

impl From<ModelError> for haptic_host::error::Failure {
    fn from(error: ModelError) -> Self {
        let remedy = match error {
            ModelError::NotFinite => "choose smaller speeds and forces",
            _ => "choose joint angles away from the singularity",
        };
        Self::impossible(error).remedy(remedy)
    }
}

fn vector(values: &[f64]) -> String {
    let entries: Vec<String> =
        values.iter().map(|value| format!("{:.3}", (value * 1.0e3).round() / 1.0e3 + 0.0)).collect();
    format!("[{}]", entries.join(", "))
}

/// Returns a text that names the moving joints.
fn moving_joints(direction: &[f64]) -> String {
    let moving: Vec<String> =
        (0..direction.len()).filter(|joint| direction[*joint].abs() > 1.0e-3).map(|joint| joint.to_string()).collect();
    match moving.as_slice() {
        [joint] => format!("joint {joint} turns"),
        [first @ .., last] => {
            format!("joints {} and {last} turn together as {}", first.join(", "), vector(direction))
        }
        [] => "a joint turns".into(),
    }
}

/// Smallest sine of the singular angle of a regular pose. The library limits the reciprocals of smaller sines.
pub const MIN_REGULAR_SINE: f64 = 1.0e-6;

/// Evaluates equation (4) at joint angles `q` (rad) and velocities `qd` (rad/s). An error names the singularity.
pub fn evaluate(
    device: &DeviceFile,
    q: &[f64],
    qd: &[f64],
    walls: &[WallForce],
    precision: Precision,
) -> Result<Report, ModelError> {
    evaluate_holding(device, q, qd, walls, precision, Admissible::default())
}

/// Like [`evaluate`], for a redundant device whose feed-forward holds `admissible`.
pub fn evaluate_holding(
    device: &DeviceFile,
    q: &[f64],
    qd: &[f64],
    walls: &[WallForce],
    precision: Precision,
    admissible: Admissible,
) -> Result<Report, ModelError> {
    with_mechanism!(&device.mechanism, m => check_regular(m, q))?;
    let report = match precision {
        Precision::F64 => {
            with_mechanism!(&device.mechanism, m => report::<f64, FineTable, _, _>(m, q, qd, walls, admissible))
        }
        Precision::F32 => {
            // Wraps the angles as the controller does, because the board's trigonometry is accurate within a turn.
            let turn = core::f64::consts::TAU;
            let wrap = |(joint, angle): (usize, &f64)| match device.mechanism.repeats(joint) {
                true => angle - turn * (angle / turn).round(),
                false => *angle,
            };
            let q: Vec<f64> = q.iter().enumerate().map(wrap).collect();
            let mechanism = AnyMechanism::<f32>::new(&device.description).map_err(|_| ModelError::NotFinite)?;
            with_mechanism!(&mechanism, m => report::<f32, BoardMath, _, _>(m, &q, qd, walls, admissible))
        }
    };
    if report.is_finite() { Ok(report) } else { Err(ModelError::NotFinite) }
}

/// Rejects a singular pose with an error that names the singularity.
fn check_regular<const N: usize, M: Mechanism<f64, N>>(mechanism: &M, q: &[f64]) -> Result<(), ModelError> {
    let pose = mechanism.pose::<FineTable>(&vector_of(q));
    let regularity = mechanism.regularity(&pose);
    if regularity.parallel == 0.0 {
        return Err(ModelError::CannotClose);
    }
    if regularity.parallel < MIN_REGULAR_SINE {
        let inverse = DMatrix::from_fn(N, N, |i, j| mechanism.jacobian_inverse(&pose)[(i, j)]);
        let (_, free) = weakest_singular_vectors(inverse);
        return Err(ModelError::Parallel { free });
    }
    if regularity.serial < MIN_REGULAR_SINE {
        let jacobian = mechanism.jacobian(&pose);
        let (lost, joints) = weakest_singular_vectors(DMatrix::from_fn(N, N, |i, j| jacobian[(i, j)]));
        return Err(ModelError::Serial { oriented: N > M::SPEC.task, joints, lost });
    }
    Ok(())
}

/// Returns the (left, right) singular vectors of the smallest singular value, with their largest entries positive.
fn weakest_singular_vectors(matrix: DMatrix<f64>) -> (Vec<f64>, Vec<f64>) {
    let size = matrix.nrows();
    let svd = matrix.svd(true, true);
    let last = svd.singular_values.imin();
    let signed = |values: Vec<f64>| {
        let largest = values.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        values.into_iter().map(|value| value * largest.signum() + 0.0).collect::<Vec<f64>>()
    };
    let left = svd.u.map_or(vec![0.0; size], |u| u.column(last).iter().copied().collect());
    let right = svd.v_t.map_or(vec![0.0; size], |v| v.row(last).iter().copied().collect());
    (signed(left), signed(right))
}

fn vector_of<T: Real, const N: usize>(values: &[f64]) -> SVector<T, N> {
    SVector::from_fn(|index, _| T::from_f64(values.get(index).copied().unwrap_or(0.0)))
}

fn report<T: Real, K: Math<T>, const N: usize, M: Mechanism<T, N>>(
    mechanism: &M,
    q: &[f64],
    qd: &[f64],
    walls: &[WallForce],
    admissible: Admissible,
) -> Report {
    let task = M::SPEC.task;
    let pose = mechanism.pose::<K>(&vector_of(q));
    let qd = vector_of(qd);
    let pulls: Vec<Pull<T, N>> = walls
        .iter()
        .map(|wall| Pull {
            normal: vector_of(&wall.normal),
            across: false,
            stiffness: T::from_f64(wall.stiffness),
            feed_forward: wall.feed_forward,
        })
        .collect();
    let force = walls
        .iter()
        .zip(&pulls)
        .fold(SVector::<T, N>::zeros(), |sum, (wall, pull)| sum + pull.normal * T::from_f64(wall.force));
    let inertia = Inertia::holding::<K, M>(mechanism, &pose, &qd, &pulls, &force, admissible);
    let jacobian = mechanism.jacobian(&pose);
    let mass = mechanism.mass(&pose);
    let bias = mechanism.coriolis(&pose, &qd) + mechanism.gravity(&pose);
    let r = inertia.split.rendered;
    let (jacobian, mass) = (rows(&jacobian, 0..task, 0..N), rows(&mass, 0..N, 0..N));
    let normal = if let [only] = walls { Some(only.normal.as_slice()) } else { None };
    Report {
        position: list(&mechanism.tip(&pose), 0..task),
        perception: Perception::new(&jacobian, &mass, normal),
        condition: Condition { jacobian: condition_number(&jacobian), mass: condition_number(&mass) },
        bias: list(&bias, 0..N),
        w_rr: rows(&inertia.w, 0..r, 0..r),
        w_ra: rows(&inertia.w, 0..r, r..N),
        w_aa: rows(&inertia.w, r..N, r..N),
        z_r: list(&inertia.z, 0..r),
        z_a: list(&inertia.z, r..N),
        w_eff: rows(&inertia.w_eff, 0..r, 0..r),
        coupling: rows(&(inertia.w - inertia.w_eff), 0..r, 0..r),
        f_a: list(&inertia.f_a, 0..N - r),
        torque: list(&inertia.torque, 0..N),
        torque_without_feed_forward: list(&inertia.torque_without_feed_forward, 0..N),
        jacobian,
        mass,
        directions: if walls.len() > 1 { directions(&Principal::new::<K>(&pulls, task), task) } else { Vec::new() },
    }
}

fn directions<T: Real, const N: usize>(principal: &Principal<T, N>, task: usize) -> Vec<Direction> {
    (0..task)
        .map(|i| Direction {
            along: list(&principal.direction(i), 0..task),
            stiffness: principal.stiffness_along(i).to_f64(),
            share: (i + 1 < N).then(|| principal.share(i + 1).to_f64()),
        })
        .collect()
}

fn list<T: Real, const N: usize>(values: &SVector<T, N>, range: core::ops::Range<usize>) -> Vec<f64> {
    range.map(|index| values[index].to_f64()).collect()
}

fn rows<T: Real, const N: usize>(
    matrix: &SMatrix<T, N, N>,
    rows: core::ops::Range<usize>,
    columns: core::ops::Range<usize>,
) -> Rows {
    rows.map(|i| columns.clone().map(|j| matrix[(i, j)].to_f64()).collect()).collect()
}

/// Returns the ratio of the largest to the smallest singular value.
fn condition_number(rows: &Rows) -> f64 {
    let columns = rows.first().map_or(0, Vec::len);
    let values = DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j]).singular_values();
    values.max() / values.min()
}

impl Report {
    fn is_finite(&self) -> bool {
        let lists = [&self.position, &self.bias, &self.z_r, &self.z_a, &self.f_a, &self.torque];
        let matrices = [&self.jacobian, &self.mass, &self.w_rr, &self.w_ra, &self.w_aa, &self.w_eff];
        lists.iter().all(|list| list.iter().all(|value| value.is_finite()))
            && matrices.iter().all(|rows| rows.iter().flatten().all(|value| value.is_finite()))
            && self.torque_without_feed_forward.iter().all(|value| value.is_finite())
            && self.condition.jacobian.is_finite()
            && self.condition.mass.is_finite()
            && self.perception.is_finite()
    }

    /// Returns Wrr/Weff - 1 for one wall, otherwise 0.
    pub fn gain(&self) -> f64 {
        match (self.w_rr.as_slice(), self.w_eff.as_slice()) {
            ([w_rr], [w_eff]) => w_rr[0] / w_eff[0] - 1.0,
            _ => 0.0,
        }
    }
}
