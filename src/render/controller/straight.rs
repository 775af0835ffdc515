//! Straight steps: one function for each shape of scene that is worth one, chosen once, when a program is built.
//!
//! [`Controller::step_generally`] renders any scene and is the reference: it goes through a list of walls, and asks at
//! each step for what the scene has not. A straight step is the same computations in the same order without the list
//! and the questions, so it returns the same numbers, bit for bit; tests/straight_steps.rs holds every one to that.
//! What it meets rarely (a fading feed-forward) it leaves to the same cold functions.
//!
//! To add one: a file beside plane.rs with its function, a line in [`StepVariant`] and in [`StepVariant::of`], its arm in
//! [`Controller::step`], and its scenes in tests/straight_steps.rs.

use super::Controller;
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use crate::model::precomputed::MassModel;
use crate::render::scene::{Admissible, Surface};

mod plane;

/// The step that a scene gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepVariant {
    /// Any scene.
    General,
    /// One plane alone, with its feed-forward by the closed form; while springs, fields or a host add nothing.
    Plane,
}

impl StepVariant {
    /// The variant of a scene as the controller holds it.
    pub fn of<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(
        controller: &mut Controller<T, M, K, N>,
    ) -> Self {
        let plain = controller.gain.is_none()
            && !controller.coefficients.at_joints()
            && controller.walls.gain() == T::one()
            && !controller.walls.damped
            && matches!(controller.mass, MassModel::Exact)
            && controller.posture.is_none()
            && (M::SPEC.task == N || controller.admissible == Admissible::Orientation);
        match controller.walls.lone() {
            Some((wall, _)) if plain && matches!(wall.surface(), Surface::Plane(_)) => Self::Plane,
            _ => Self::General,
        }
    }
}
