//! Motions without feedback. If the joints' damping is exactly compensated, a device drifts freely. The analysis
//! removes these motions because their modes on the unit circle cannot be distinguished from unstable modes.

use super::control_loop::{Loop, Mode};
use super::plant::{ContinuousPlant, Linearised};
use nalgebra::{DMatrix, DVector};

/// Constant motions of the loop, which exist at any gains.
#[derive(Clone, Debug)]
pub(super) struct Drift {
    /// States per unit of motion, one column per motion, without the rendered position.
    states: DMatrix<f64>,
    /// Wall force that each motion needs, in force units. The rendered position settles at -force/kp.
    force: DVector<f64>,
    /// Index of the state that is one for this motion and zero for every other motion, for each motion.
    pivot: Vec<usize>,
    position: usize,
}

impl Drift {
    /// Returns F on the remaining states after removing the constant motions.
    pub fn remove_from(&self, f: DMatrix<f64>, kp: f64) -> DMatrix<f64> {
        let mut motion = self.states.clone();
        for column in 0..motion.ncols() {
            motion[(self.position, column)] = -self.force[column] / kp;
        }
        let mut reduced = f.clone();
        for (column, &pivot) in self.pivot.iter().enumerate() {
            reduced -= motion.column(column) * f.row(pivot);
        }
        let kept: Vec<usize> = (0..f.nrows()).filter(|i| !self.pivot.contains(i)).collect();
        DMatrix::from_fn(kept.len(), kept.len(), |i, j| reduced[(kept[i], kept[j])])
    }
}

/// One constant motion: (velocities of the damped joints, share of the undamped joints, lagging torques, wall force).
pub(super) type ConstantMotion = (Vec<f64>, f64, Vec<f64>, f64);

/// Finds the constant joint velocities that persist if the joints' damping is exactly compensated.
///
/// These velocities do not move the tip along the wall's normal. With the full feed-forward the wall balances a force
/// EᵀB q̇; a washout removes it, so only velocities with EᵀB q̇ = 0 persist. With back-EMF no velocity persists.
pub(super) fn find_drift(
    device: &Linearised,
    around: &Loop,
    mode: Mode,
    plant: &ContinuousPlant,
    mass: f64,
    states: impl Fn(&[ConstantMotion]) -> DMatrix<f64>,
) -> Option<Drift> {
    if plant.sensed.is_empty() || plant.electrically_damped {
        return None;
    }
    let t = 1.0 / around.rate_hz;
    let d = plant.damped.len();
    let pull = DVector::from_fn(d, |i, _| {
        let joint = plant.damped[i];
        device.unit_motion[joint] * device.viscous[joint] * t / mass
    });
    let mut conditions = Vec::new();
    if !plant.has_share {
        conditions.push(DVector::from_fn(d, |i, _| device.row[plant.damped[i]]));
    }
    if matches!(mode, Mode::Washout(_)) {
        conditions.push(pull.clone());
    }
    let (basis, pivot) = null_space(d, &conditions);
    if basis.is_empty() {
        return None;
    }
    let constants: Vec<ConstantMotion> = basis
        .iter()
        .map(|v| {
            let share = -(0..d).map(|i| device.row[plant.damped[i]] * v[i]).sum::<f64>();
            let torque = plant
                .lagging
                .iter()
                .map(|j| {
                    let at = plant.damped.iter().position(|i| i == j);
                    at.map_or(0.0, |i| v[i] * device.viscous[*j] * t / mass)
                })
                .collect();
            let force = if mode == Mode::Full { pull.dot(v) } else { 0.0 };
            (v.iter().copied().collect(), share, torque, force)
        })
        .collect();
    let force = DVector::from_iterator(constants.len(), constants.iter().map(|c| c.3));
    Some(Drift { states: states(&constants), force, pivot, position: plant.position })
}

/// Returns a basis of the vectors orthogonal to all conditions, by Gauss-Jordan elimination, and a pivot for each
/// vector: the coordinate at which this vector is one and the other vectors are zero.
fn null_space(dimension: usize, conditions: &[DVector<f64>]) -> (Vec<DVector<f64>>, Vec<usize>) {
    let mut rows: Vec<DVector<f64>> = Vec::new();
    let mut bound = Vec::new();
    for condition in conditions {
        let mut row = condition.clone();
        for (other, &at) in rows.iter().zip(&bound) {
            let factor = row[at];
            row -= other * factor;
        }
        let at = row.iamax();
        if row[at].abs() <= 1e-12 * condition.amax() {
            continue;
        }
        row /= row[at];
        for other in &mut rows {
            let factor = other[at];
            *other -= &row * factor;
        }
        rows.push(row);
        bound.push(at);
    }
    let free: Vec<usize> = (0..dimension).filter(|i| !bound.contains(i)).collect();
    let basis = free
        .iter()
        .map(|&at| {
            let mut v = DVector::zeros(dimension);
            v[at] = 1.0;
            for (row, &pivot) in rows.iter().zip(&bound) {
                v[pivot] = -row[at];
            }
            v
        })
        .collect();
    (basis, free)
}
