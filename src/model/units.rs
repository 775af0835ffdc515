//! The units of a joint, and the lever by which a slide's limits follow from those of a joint that turns.

/// Lever that makes a slide's limits from those of a revolute joint, m: a radian becomes 0.08 m, a newton metre 12.5 N.
///
/// A handle at this distance from its axis is typical of the shipped devices. A hand on a slide therefore meets at most
/// the speed, the travel and the force that it would meet on such a handle.
pub const SLIDE_LEVER: f32 = 0.08;

/// Units of a joint's quantities, and its lever.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointUnits {
    /// Unit of the coordinate: an angle or a travel.
    pub travel: &'static str,
    /// Unit of the speed.
    pub speed: &'static str,
    /// Unit of the torque or force.
    pub torque: &'static str,
    /// Unit of the viscous friction.
    pub viscous: &'static str,
    /// Unit of the inertia or mass.
    pub inertia: &'static str,
    /// Unit of the tip's motion by the joint's.
    pub jacobian: &'static str,
    /// Travel that counts as one radian in limits: 1 for a revolute joint, [`SLIDE_LEVER`] for a slide.
    pub lever: f32,
}

impl JointUnits {
    /// Units of a joint that turns.
    pub const REVOLUTE: Self = Self {
        travel: "rad",
        speed: "rad/s",
        torque: "N m",
        viscous: "N m s/rad",
        inertia: "kg m²",
        jacobian: "m/rad",
        lever: 1.0,
    };
    /// Units of a slide.
    pub const PRISMATIC: Self = Self {
        travel: "m",
        speed: "m/s",
        torque: "N",
        viscous: "N s/m",
        inertia: "kg",
        jacobian: "m/m",
        lever: SLIDE_LEVER,
    };

    /// Returns the units of a joint that slides or turns.
    pub const fn of(prismatic: bool) -> &'static Self {
        if prismatic { &Self::PRISMATIC } else { &Self::REVOLUTE }
    }
}
