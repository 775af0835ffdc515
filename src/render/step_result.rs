//! What one control step finds and decides, vectors padded with zeros: written in place once a step, and then read by
//! the servo and telemetry.

use crate::math::Real;
use crate::model::catalogue::MAX_JOINTS;

/// What a step found at the walls.
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
    /// Where there is no wall.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { shaping: T::one(), ..Self::default() }
    }
}

/// Where the device is and what touches it.
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
    /// What holds the device against gravity, N m.
    pub gravity: [T; MAX_JOINTS],
    /// What renders the forces that walls, springs and fields ask for, Jᵀ f, N m; the rest is the feed-forward.
    pub rendered: [T; MAX_JOINTS],
    /// |f|², the square of those forces' resultant, N².
    pub force_squared: T,
}

/// What springs, fields and the host add.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Guided<T> {
    /// At the tip, N.
    pub force: [T; MAX_JOINTS],
    /// At the joints, N m.
    pub torque: [T; MAX_JOINTS],
}

/// All of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepResult<T> {
    /// Where the device is and what touches it.
    pub at: DeviceState<T>,
    /// What the scene asks of the joints.
    pub asked: TorqueDemand<T>,
    /// What of that springs, fields and the host add, where a straight step has worked it out.
    pub(crate) guided: Guided<T>,
    /// J⁻¹ n: joint motion per metre of tip motion along the normal of the deepest wall, rad/m; zero out of contact.
    pub motion: [T; MAX_JOINTS],
    /// What torques of the joints are worth at the tip, by task directions, 1/m, where there are as many of both.
    pub(crate) leverage: [[T; MAX_JOINTS]; 3],
    /// How far from a parallel singularity the pose is, see [`Regularity`](crate::model::mechanism::Regularity).
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
