//! Reduces a rigid device to the motions that affect the wall. [`super::flexible_reduction`] reduces compliant devices.

use super::flexible_reduction;
use super::plant::{ContinuousPlant, Drive, Lags, Linearised};
use nalgebra::{DMatrix, DVector};

/// Longest decay time of a joint's own damping, samples. Slower damping counts as none.
const SLOWEST_DECAY_SAMPLES: f64 = 1e10;

/// Builds the reduced plant, or returns `None` if M is not positive definite. `inputs` (N x p) has the torques of each
/// input in units of m/T² times metres. `sense_damped` adds the positions of the damped joints.
pub(crate) fn reduce(
    device: &Linearised,
    drive: &Drive,
    inputs: &DMatrix<f64>,
    sample_s: f64,
    reference_mass: f64,
    sense_damped: bool,
) -> Option<ContinuousPlant> {
    let joints = device.row.len();
    let (t, m) = (sample_s, reference_mass);
    let mobility = device.mass.clone().cholesky()?.inverse();
    let negligible = |damping: f64, joint: usize| damping * t * mobility[(joint, joint)] < 1.0 / SLOWEST_DECAY_SAMPLES;

    let lags = Lags::new(drive, joints, t);
    if !device.flexible.is_rigid() {
        return flexible_reduction::reduce(device, &lags, inputs, sample_s, reference_mass);
    }
    let Lags { rate: lag, emf } = lags;
    let viscous: Vec<f64> =
        (0..joints).map(|j| if negligible(device.viscous[j], j) { 0.0 } else { device.viscous[j] }).collect();
    let damped: Vec<usize> = (0..joints).filter(|&j| viscous[j] > 0.0 || !negligible(emf[j], j)).collect();
    let undamped: Vec<usize> = (0..joints).filter(|j| !damped.contains(j)).collect();
    let lagging: Vec<usize> = (0..joints).filter(|&j| lag[j].is_some()).collect();
    let sensed: Vec<usize> =
        if sense_damped { (0..joints).filter(|&j| viscous[j] > 0.0).collect() } else { Vec::new() };

    let has_share = !undamped.is_empty();
    let (d, l) = (damped.len(), lagging.len());
    let share = d + l;
    let position = share + usize::from(has_share);
    let size = position + 1 + sensed.len();
    let mut a = DMatrix::zeros(size, size);
    let mut b = DMatrix::zeros(size, inputs.ncols());

    // Adds the acceleration of a weighted sum of joints to row `into`: weights · M⁻¹ (τ - B q̇).
    let mut accelerate = |into: usize, weights: &DVector<f64>, b: &mut DMatrix<f64>| {
        let pull = &mobility * weights; // M⁻¹ is symmetric
        for (column, &joint) in damped.iter().enumerate() {
            let direct_emf = if lag[joint].is_none() { emf[joint] } else { 0.0 };
            a[(into, column)] -= t * pull[joint] * (viscous[joint] + direct_emf);
        }
        for (column, &joint) in lagging.iter().enumerate() {
            a[(into, d + column)] += m * pull[joint];
        }
        for joint in (0..joints).filter(|&j| lag[j].is_none()) {
            for input in 0..inputs.ncols() {
                b[(into, input)] += m * pull[joint] * inputs[(joint, input)];
            }
        }
    };
    let unit = |joint: usize| DVector::from_fn(joints, |i, _| if i == joint { 1.0 } else { 0.0 });
    for (state, &joint) in damped.iter().enumerate() {
        accelerate(state, &unit(joint), &mut b);
    }
    if has_share {
        let weights = DVector::from_fn(joints, |j, _| if undamped.contains(&j) { device.row[j] } else { 0.0 });
        accelerate(share, &weights, &mut b);
        a[(position, share)] = 1.0;
    }
    for (column, &joint) in lagging.iter().enumerate() {
        let rate = lag[joint].unwrap_or_default();
        a[(d + column, d + column)] = -rate;
        if let Some(velocity) = damped.iter().position(|&j| j == joint) {
            a[(d + column, velocity)] = -rate * emf[joint] * t / m;
        }
        for input in 0..inputs.ncols() {
            b[(d + column, input)] = rate * inputs[(joint, input)];
        }
    }
    for (state, &joint) in damped.iter().enumerate() {
        a[(position, state)] = device.row[joint];
        if let Some(slot) = sensed.iter().position(|&j| j == joint) {
            a[(position + 1 + slot, state)] = 1.0;
        }
    }
    Some(ContinuousPlant {
        a,
        b,
        electrically_damped: emf.iter().enumerate().any(|(j, &e)| !negligible(e, j)),
        damped,
        lagging,
        has_share,
        position,
        rendered_rows: DVector::from_fn(position + 1, |state, _| if state == position { 1.0 } else { 0.0 }),
        sensed,
    })
}
