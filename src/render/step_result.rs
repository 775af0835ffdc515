//! The result of one control step, vectors padded with zeros: written in place once a step, and then read by the control loop
//! and telemetry.

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
    /// Sum of the forces that the walls ask for, N.
    pub wall_force: T,
    /// Share of the feed-forward that acts: 1 away from singularities, fading to 0 near them.
    pub shaping: T,
    /// Energy that the walls' torques, the feed-forward's with them, have taken up since contact began, less what they owed
    /// then, J; negative when they gave some out.
    pub energy: T,
    /// Damping that the passivity controller added, N s/m.
    pub passivity_damping: T,
}

impl<T: Real> AtWalls<T> {
    /// The state without walls.
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
    /// The walls.
    pub walls: AtWalls<T>,
}

/// Joint torques of one control step by what they are for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TorqueDemand<T> {
    /// All of them together, N m.
    pub total: [T; MAX_JOINTS],
    /// The part that holds the device against gravity, N m.
    pub gravity: [T; MAX_JOINTS],
    /// The part that renders the forces of walls, springs and fields, Jᵀ f, N m; the rest is the feed-forward.
    pub rendered: [T; MAX_JOINTS],
    /// |f|², the square of those forces' resultant, N².
    pub force_squared: T,
}

/// The additions of springs, fields and the host.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Guided<T> {
    /// At the tip, N.
    pub force: [T; MAX_JOINTS],
    /// At the joints, N m.
    pub torque: [T; MAX_JOINTS],
}

/// The result of one control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepResult<T> {
    /// Position and velocity of the device, and the walls that touch it.
    pub at: DeviceState<T>,
    /// The joint torques that the scene asks for.
    pub asked: TorqueDemand<T>,
    /// The part of springs, fields and the host, if a straight step has computed it.
    pub(crate) guided: Guided<T>,
    /// J⁻¹ n: joint motion per metre of tip motion along the normal of the deepest wall, rad/m; zero out of contact.
    pub motion: [T; MAX_JOINTS],
    /// The distance of the pose from a parallel singularity, see [`Regularity`](crate::model::mechanism::Regularity).
    pub parallel: T,
}

/// Writes the first N of a vector's entries.
#[inline(always)]
pub(crate) fn put<T: Real, const N: usize>(vector: &nalgebra::SVector<T, N>, into: &mut [T; MAX_JOINTS]) {
    for i in 0..N.min(MAX_JOINTS) {
        into[i] = vector[i];
    }
}

/// Zero in the first N entries.
#[inline(always)]
pub(crate) fn clear<T: Real, const N: usize>(vector: &mut [T; MAX_JOINTS]) {
    put::<T, N>(&nalgebra::SVector::zeros(), vector);
}
