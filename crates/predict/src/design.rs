//! The places and directions in which a device renders walls best: directions at a pose, places in the workspace, what
//! each link, rotor and gear is worth, and the posture of a redundant arm.
//!
//! Places, directions and postures are searched by inertia, Weff without the feed-forward and Wrr with it: without
//! joint damping the stable boundary of a rigid device is that of a single mass, so that the stiffest wall is in
//! proportion to it (docs/model.md). The stiffness beside each, and what each change of the device does to it, is the
//! prediction of `haptic range`, with joint damping and transmissions. Friction and ripple are for `haptic tune`.
//!
//! Inertia grows without bound towards a singular pose along the direction that is lost there. So the best place lies
//! at the edge of what is allowed, which is said: poses nearer to a singularity than a given sine are left out.

pub mod place;
pub mod posture;
pub mod sensitivity;

use haptic_bridge::math::FineTable;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::with_mechanism;
use haptic_host::error::{Choice, Failure};
use haptic_stability::analysis::pose::{TaskPose, angles, regular};
use haptic_stability::analysis::range::BoundaryPoint;
use nalgebra::{DVector, SVector};
use serde::Serialize;

/// The stiffest walls at a place that stay stable, of all dampings, as `haptic range` predicts them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stiffest {
    /// Without the feed-forward.
    pub off: BoundaryPoint,
    /// With it.
    pub full: BoundaryPoint,
}

/// The distance of a pose from the nearest singularity: the lesser sine.
#[must_use]
pub fn clearance(pose: &TaskPose) -> f64 {
    pose.regularity.serial.min(pose.regularity.parallel)
}

/// Returns true if the joint angles lie within the limits.
#[must_use]
pub fn within_limits(device: &Device<f64>, q: &[f64]) -> bool {
    let inside = |(angle, low, high): (f64, f64, f64)| (low - 1e-9..=high + 1e-9).contains(&angle);
    let joints = q.iter().zip(&device.joints);
    joints.filter_map(|(q, joint)| joint.limits.map(|(low, high)| (*q, low, high))).all(inside)
}

/// The whole task position of a pose: the tip, and on a redundant arm its orientation.
fn task_position(pose: &TaskPose, q: &[f64]) -> DVector<f64> {
    DVector::from_fn(q.len(), |i, _| pose.position.get(i).copied().unwrap_or_else(|| q.iter().sum()))
}

/// Joint angles near `from` (rad) that bring a device to a task position (tip in m, then φ): Newton's method. `None`
/// where that is out of reach.
#[must_use]
pub fn reaching(device: &Device<f64>, from: &[f64], place: &DVector<f64>) -> Option<Vec<f64>> {
    with_mechanism!(&device.mechanism, m => newton(m, from, place))
}

fn newton<M: Mechanism<f64, N>, const N: usize>(m: &M, from: &[f64], place: &DVector<f64>) -> Option<Vec<f64>> {
    angles(from, N).ok()?;
    let place = SVector::<f64, N>::from_fn(|i, _| place[i]);
    let mut q = SVector::<f64, N>::from_column_slice(from);
    for _ in 0..40 {
        let pose = m.pose::<FineTable>(&q);
        regular(&m.regularity(&pose)).ok()?;
        let off = place - m.tip(&pose);
        if off.norm() < 1e-12 {
            return Some(q.as_slice().to_vec());
        }
        let step = m.inverse(&pose, &off);
        // Long steps overshoot near the edge of the reach.
        q += step * (0.2 / step.amax().max(1e-300)).min(1.0);
    }
    let there = m.tip(&m.pose::<FineTable>(&q));
    ((place - there).norm() < 1e-9).then(|| q.as_slice().to_vec())
}

/// Of a pose where a question about a direction has no answer.
pub fn singular() -> Failure {
    Failure::impossible("this pose is singular").remedy("choose another").choose(Choice::Pose)
}

/// A device that is analysed, not sent.
fn lumped(description: &Description) -> Result<Device<f64>, Failure> {
    Device::new("", description).map_err(Failure::wrong)
}
