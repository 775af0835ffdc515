//! Finds the best walls of a device: direction, place, posture, and changes of links, rotors and gears.
//!
//! Places, directions and postures are rated by inertia: Weff without the feed-forward and Wrr with it. Without joint
//! damping a rigid device has the stable boundary of a single mass, so the largest stiffness is proportional to
//! the inertia (docs/model.md). The stiffness at each place, and its change with each number of the device, is the
//! prediction of `haptic range` with joint damping and transmissions. `haptic tune` includes friction and ripple.
//!
//! Towards a singular pose inertia grows without bound along the lost direction, so the best place is on the edge of
//! the allowed poses, and the output says so. Poses nearer to a singularity than a given sine are not allowed.

pub mod place;
pub mod posture;
pub mod sensitivity;

use haptic_bridge::math::FineTable;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::with_mechanism;
use haptic_host::error::{Choice, Failure};
use haptic_stability::analysis::pose::{TaskPose, check_angles, check_regular};
use haptic_stability::analysis::range::BoundaryPoint;
use nalgebra::{DVector, SVector};
use serde::Serialize;

/// The stiffest stable walls at a place over all dampings, as predicted by `haptic range`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StiffestWalls {
    /// Wall without the feed-forward.
    pub off: BoundaryPoint,
    /// Wall with the feed-forward.
    pub full: BoundaryPoint,
}

/// Returns the sine of the nearest singular angle of a pose.
#[must_use]
pub fn clearance(pose: &TaskPose) -> f64 {
    pose.regularity.serial.min(pose.regularity.parallel)
}

/// Returns true if the joint angles are within the limits.
#[must_use]
pub fn within_limits(device: &Device<f64>, q: &[f64]) -> bool {
    let inside = |(angle, low, high): (f64, f64, f64)| (low - 1e-9..=high + 1e-9).contains(&angle);
    let joints = q.iter().zip(&device.joints);
    joints.filter_map(|(q, joint)| joint.limits.map(|(low, high)| (*q, low, high))).all(inside)
}

/// Returns the complete task position of a pose: the tip and, on a redundant arm, the orientation.
fn task_position(pose: &TaskPose, q: &[f64]) -> DVector<f64> {
    DVector::from_fn(q.len(), |i, _| pose.position.get(i).copied().unwrap_or_else(|| q.iter().sum()))
}

/// Returns joint angles near `from` (rad) at a task position (m, then φ) by Newton's method; `None` out of reach.
#[must_use]
pub fn angles_at(device: &Device<f64>, from: &[f64], place: &DVector<f64>) -> Option<Vec<f64>> {
    with_mechanism!(&device.mechanism, m => newton(m, from, place))
}

fn newton<M: Mechanism<f64, N>, const N: usize>(m: &M, from: &[f64], place: &DVector<f64>) -> Option<Vec<f64>> {
    check_angles(from, N).ok()?;
    let place = SVector::<f64, N>::from_fn(|i, _| place[i]);
    let mut q = SVector::<f64, N>::from_column_slice(from);
    for _ in 0..40 {
        let pose = m.pose::<FineTable>(&q);
        check_regular(&m.regularity(&pose)).ok()?;
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

/// Returns the error for a singular pose.
pub fn singular_pose() -> Failure {
    Failure::impossible("this pose is singular").remedy("choose another").choose(Choice::Pose)
}

fn build_device(description: &Description) -> Result<Device<f64>, Failure> {
    Device::new("", description).map_err(Failure::wrong)
}
