//! Postures of a redundant arm at one tip position, with the inertia of each.
//!
//! The arm moves along its null motion, a joint motion that keeps the tip in place, in both directions from the given
//! posture. The motion ends near a joint limit or a singularity, or after a full turn. Weff depends on the posture. Wrr
//! also depends on the held coordinate ([`Admissible`]), and grows without bound towards postures in which this
//! coordinate cannot be held; `min_sine` is the smallest allowed sine of the singular angle.

use super::{angles_at, build_device, clearance, singular_pose, task_position, within_limits};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_host::error::Failure;
use haptic_stability::analysis::map::effective_inertias;
use haptic_stability::analysis::pose::{TaskPose, unit_normal};
use nalgebra::DVector;
use serde::Serialize;

/// Difference in orientation between two postures, rad.
const ORIENTATION_STEP: f64 = 0.001;

/// A posture of the arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Posture {
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// Orientation φ, the sum of the joint angles, rad. It distinguishes the postures at one tip position.
    pub orientation: f64,
    /// Effective inertia without the feed-forward, kg.
    pub w_eff: f64,
    /// Effective inertia with the feed-forward, kg.
    pub w_rr: f64,
    /// Sine of the nearest singular angle.
    pub clearance: f64,
}

/// The most notable postures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Postures {
    /// The given posture of the arm.
    pub here: Posture,
    /// The posture with the largest Weff.
    pub heaviest: Posture,
    /// The posture with the smallest Weff.
    pub lightest: Posture,
    /// The posture with the largest Wrr.
    pub most_held: Posture,
    /// The posture with the smallest Wrr.
    pub least_held: Posture,
    /// Number of postures that were computed.
    pub postures: usize,
}

fn posture(device: &Device<f64>, q: &[f64], normal: &DVector<f64>, admissible: Admissible) -> Option<Posture> {
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?.holding(admissible);
    let (w_eff, w_rr) = effective_inertias(&pose, normal)?;
    Some(Posture { q: q.to_vec(), orientation: q.iter().sum(), w_eff, w_rr, clearance: clearance(&pose) })
}

/// Returns the most notable postures at the tip position of `q` (rad); `None` without redundancy.
pub fn postures(
    description: &Description,
    q: &[f64],
    normal: &[f64],
    min_sine: f64,
    admissible: Admissible,
) -> Result<Option<Postures>, Failure> {
    let spec = description.kind.spec();
    if spec.joints == spec.task {
        return Ok(None);
    }
    let device = build_device(description)?;
    let n = unit_normal(normal, spec.task, spec.joints)?;
    let start = TaskPose::of(&device.mechanism, q)?.regular()?;
    let here = posture(&device, q, &n, admissible).ok_or_else(singular_pose)?;
    let mut all = vec![here.clone()];
    for direction in [ORIENTATION_STEP, -ORIENTATION_STEP] {
        let mut at = q.to_vec();
        let mut place = task_position(&start, q);
        // Tries at most a full turn of φ.
        for _ in 0..(std::f64::consts::TAU / ORIENTATION_STEP) as usize {
            place[spec.task] += direction;
            let Some(next) = angles_at(&device, &at, &place) else { break };
            let is_far = next.iter().zip(&at).any(|(next, at)| (next - at).abs() > 0.3);
            let Some(result) = posture(&device, &next, &n, admissible) else { break };
            if is_far || result.clearance < min_sine || !within_limits(&device, &next) {
                break;
            }
            all.push(result);
            at = next;
        }
    }
    let best = |value: &dyn Fn(&Posture) -> f64| {
        all.iter().reduce(|a, b| if value(b) > value(a) { b } else { a }).cloned().unwrap_or_else(|| here.clone())
    };
    Ok(Some(Postures {
        heaviest: best(&|p| p.w_eff),
        lightest: best(&|p| -p.w_eff),
        most_held: best(&|p| p.w_rr),
        least_held: best(&|p| -p.w_rr),
        postures: all.len(),
        here,
    }))
}
