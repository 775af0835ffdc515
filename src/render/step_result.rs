//! The result of one control step, padded with zeros and written in place.

use crate::math::Real;
use crate::model::catalogue::MAX_JOINTS;

/// The state at the walls in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AtWalls<T> {
    /// Number of walls touched.
    pub contacts: u8,
    /// Distance to the deepest wall, m; negative inside it. Zero without walls.
    pub distance: T,
    /// Velocity along the normal of the deepest wall, m/s.
    pub normal_velocity: T,
    /// Sum of the wall forces, N.
    pub wall_force: T,
    /// Active share of the feed-forward, 1 far from singularities and 0 at a singularity.
    pub shaping: T,
    /// Energy that the walls' torques (with feed-forward) have absorbed since contact began, less the initial debt, J;
    /// negative if the walls have given out energy.
    pub energy: T,
    /// Damping added by the passivity controller, N s/m.
    pub passivity_damping: T,
}

impl<T: Real> AtWalls<T> {
    /// Returns the state without walls.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { shaping: T::one(), ..Self::default() }
    }
}

/// Position and velocity of the device, and the walls that touch it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceState<T> {
    /// Joint angles, rad.
    pub q: [T; MAX_JOINTS],
    /// Filtered joint velocities, rad/s.
    pub qd: [T; MAX_JOINTS],
    /// Task position: the tip, m (and φ, rad).
    pub tip: [T; MAX_JOINTS],
    /// State at the walls.
    pub walls: AtWalls<T>,
}

/// Joint torques of one control step, by purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TorqueDemand<T> {
    /// Total, N m.
    pub total: [T; MAX_JOINTS],
    /// Part that holds the device against gravity, N m.
    pub gravity: [T; MAX_JOINTS],
    /// Part that renders the forces f of walls, springs and fields, Jᵀ f, N m. The rest is the feed-forward.
    pub rendered: [T; MAX_JOINTS],
    /// |f|², the squared resultant of the rendered forces, N².
    pub force_squared: T,
}

/// Force and torques of springs, fields and the host.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct GuidanceDemand<T> {
    /// Force at the tip, N.
    pub force: [T; MAX_JOINTS],
    /// Torques at the joints, N m.
    pub torque: [T; MAX_JOINTS],
}

/// The result of one control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepResult<T> {
    /// Position and velocity of the device, and the walls that touch it.
    pub at: DeviceState<T>,
    /// Joint torques that the scene requests.
    pub asked: TorqueDemand<T>,
    /// Demand of springs, fields and the host, if a straight step has computed it.
    pub(crate) guidance: GuidanceDemand<T>,
    /// J⁻¹ n: joint motion per metre of tip motion along the normal of the deepest wall, rad/m; zero without contact.
    pub motion: [T; MAX_JOINTS],
    /// Distance of the pose from a parallel singularity, see [`Regularity`](crate::model::mechanism::Regularity).
    pub parallel: T,
}

/// Writes the first N entries of a vector.
#[inline(always)]
pub(crate) fn put<T: Real, const N: usize>(vector: &nalgebra::SVector<T, N>, into: &mut [T; MAX_JOINTS]) {
    for i in 0..N.min(MAX_JOINTS) {
        into[i] = vector[i];
    }
}

/// Sets the first N entries to zero.
#[inline(always)]
pub(crate) fn clear<T: Real, const N: usize>(vector: &mut [T; MAX_JOINTS]) {
    put::<T, N>(&nalgebra::SVector::zeros(), vector);
}
