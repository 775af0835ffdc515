//! Straight steps: one function for each kind of scene, selected once when a program is built.
//!
//! `Controller::render_any_scene` is the reference for any scene: it iterates over a list of walls and tests for every
//! feature that a scene may have. A straight step computes the same estimates, contacts and states, bit for bit,
//! without the list and the tests. Its torques take fewer operations and are equal up to rounding.
//! tests/straight_steps.rs checks both. The general step fades the feed-forward.
//!
//! Each straight step is a separate function that is not inlined, because one function for all would need a stack frame
//! beyond the reach of the FPU's loads.
//!
//! To add a straight step, add a file next to wall.rs, a line in [`StepVariant`] and [`StepVariant::of`], an arm in
//! [`Controller::render`], and scenes in tests/straight_steps.rs.

use super::regularity::{FULL_REGULARITY, PARALLEL_REGULARITY};
use super::{Controller, task_part};
use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::{Mechanism, Regularity, ShapedTorque};
use crate::render::controller::walls::{BiasScope, ShapedContact};
use crate::render::scene::{Admissible, VelocityTerms};
use crate::render::step_result::{GuidanceDemand, StepResult, TorqueDemand, put};
use nalgebra::SVector;

mod round;
mod several;
mod wall;

/// Values that every straight step uses.
#[derive(Clone, Copy)]
struct Start<T: Real, P: Copy, const N: usize> {
    pose: P,
    /// Position of the tip, m; zero beyond the task.
    place: SVector<T, N>,
    /// Filtered joint velocities, rad/s.
    qd: SVector<T, N>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Computes and writes the values that every step needs. Returns `None` and writes nothing if the feed-forward
    /// fades, because only the general step fades it.
    #[inline(always)]
    fn start(&mut self, counts: &[i32; N], result: &mut StepResult<T>) -> Option<Start<T, M::Pose, N>> {
        let least = Regularity {
            serial: T::from_f64(FULL_REGULARITY),
            parallel: T::from_f64(FULL_REGULARITY * PARALLEL_REGULARITY),
        };
        let (_, angles) = self.encoders.angles(counts);
        let pose = self.mechanism.regular_pose::<K>(&angles, &least)?;
        let tip = self.mechanism.tip(&pose);
        let qd = self.encoders.velocities(counts, |filter, raw| filter.step_low_pass(&self.coefficients, raw));
        Self::write_motion(&qd, &tip, result);
        result.parallel = self.mechanism.regularity(&pose).parallel;
        // Without gravity compensation the entries stay zero from the restart.
        if self.gravity {
            put(&self.mechanism.gravity(&pose), &mut result.asked.gravity);
        }
        let start = Start { pose, place: task_part::<T, M, N>(&tip), qd };
        Some(start)
    }

    /// Writes the sum of these torques (N m), gravity and guidance. `force` returns the walls' resultant, N.
    #[inline(always)]
    fn write_total(&self, torque: &SVector<T, N>, force: impl FnOnce() -> SVector<T, N>, result: &mut StepResult<T>) {
        let mut total = *torque;
        if self.gravity {
            for i in 0..N.min(MAX_JOINTS) {
                total[i] += result.asked.gravity[i];
            }
        }
        put(&total, &mut result.asked.total);
        if self.guidance.adds_force {
            add_guidance(&force(), &result.guidance, &mut result.asked);
        }
    }

    /// Writes the forces of springs, fields and the host. Runs before the walls, while few values are live.
    #[inline(never)]
    fn write_guidance(&self, start: &Start<T, M::Pose, N>, guidance: &mut GuidanceDemand<T>) {
        let Start { pose, place, qd } = start;
        let mut force = self.guidance.push_force();
        if self.guidance.is_active {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            force += self.guidance.force(place, &velocity);
        }
        put(&force, &mut guidance.force);
        put(&self.mechanism.transpose(pose, &force), &mut guidance.torque);
    }

    /// Computes equation (4) for `force` (N) along `normal`. `wall` is the index of the force's wall, if any.
    #[inline(always)]
    fn shaped_torque(
        &self,
        start: &Start<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> ShapedTorque<T, N> {
        let Start { pose, .. } = start;
        if !self.has_bias {
            return self.mechanism.shaped_torque(pose, normal, force, None);
        }
        if let Some(certain) = self.certain_velocities(start).filter(|_| self.has_usual_terms) {
            return self.mechanism.shaped_torque(pose, normal, force, Some(&certain));
        }
        self.shaped_torque_with_partial_terms(start, normal, force, wall)
    }

    /// Returns the joint velocities beyond single counts (rad/s); `None` unless velocity terms act in full.
    #[inline(always)]
    fn certain_velocities(&self, start: &Start<T, M::Pose, N>) -> Option<SVector<T, N>> {
        let Start { pose, qd, .. } = start;
        let certain = self.encoders.velocities_beyond_one_count(qd);
        let known = self.encoders.are_velocity_terms_full(qd) || self.velocity_term_share(pose, &certain) >= T::one();
        known.then_some(certain)
    }

    /// Implements [`Controller::shaped_torque`] if the velocity terms act only in part.
    #[inline(always)]
    fn shaped_torque_with_partial_terms(
        &self,
        start: &Start<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> ShapedTorque<T, N> {
        let Start { pose, place, qd } = start;
        // Passes copies, so that the usual case can keep the values in registers.
        let (pose, place, qd, normal) = (*pose, *place, *qd, *normal);
        let ShapedTorque { e, torque } = self.shaped_torque_with_any_terms(&pose, &place, &qd, &normal, force, wall);
        ShapedTorque { e: e.map(|e| e), torque: torque.map(|torque| torque) }
    }

    /// Computes [`Controller::shaped_torque`] for any velocity terms, normals and damping compensation.
    #[inline(never)]
    fn shaped_torque_with_any_terms(
        &self,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> ShapedTorque<T, N> {
        let contact = ShapedContact::along(normal, force, wall);
        let shaping = self.mechanism.shaping(pose, normal);
        let (b, subtracted) = self.bias(pose, place, qd, &BiasScope::One(&contact));
        ShapedTorque { e: shaping.e, torque: shaping.torque(force, &b, &subtracted) }
    }
}

/// Adds springs, fields and the host to the requested torques of the walls, whose resultant is `force` (N).
#[inline(never)]
fn add_guidance<T: Real, const N: usize>(
    force: &SVector<T, N>,
    guidance: &GuidanceDemand<T>,
    asked: &mut TorqueDemand<T>,
) {
    let mut squared = T::zero();
    for i in 0..N.min(MAX_JOINTS) {
        let along = force[i] + guidance.force[i];
        squared += along * along;
        asked.rendered[i] += guidance.torque[i];
        asked.total[i] += guidance.torque[i];
    }
    asked.force_squared = squared;
}

/// The step variant of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepVariant {
    /// One general step that starts the estimators, before the scene's own variant.
    Restart,
    /// Any scene.
    General,
    /// A single wall, or no wall.
    Wall,
    /// A single round wall whose velocity terms follow its normal, on a device with two joints.
    Round,
    /// Several walls, or shaped walls together with springs or a host's plane, for two joints in the plane.
    Several,
}

impl StepVariant {
    /// Returns the variant of the controller's scene. Straight steps use a low-pass after the backward difference
    /// and α = 1. Only straight steps in the plane combine guidance with walls that have the feed-forward.
    pub fn of<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(controller: &Controller<T, M, K, N>) -> Self {
        let Controller { walls, velocity_terms, admissible, posture, coefficients, guidance, .. } = controller;
        let holds_orientation = M::SPEC.task == N || *admissible == Admissible::Orientation;
        let shares_feed_forward = guidance.is_active && guidance.shares_feed_forward();
        let planar = N == 2 && M::SPEC.task == 2;
        // Each wall contributes to the bias if normals of several walls turn or walls compensate damping.
        let flat = !walls.compensates_damping && (*velocity_terms == VelocityTerms::Off || !walls.has_curved_wall);
        let usual = holds_orientation && posture.is_none() && walls.gain() == T::one() && coefficients.is_low_pass();
        if !usual {
            Self::General
        } else if walls.has_at_most_one_wall() && !shares_feed_forward {
            if planar && controller.has_turning_terms && walls.is_single_ball() { Self::Round } else { Self::Wall }
        } else if planar && walls.are_stiff() && flat {
            Self::Several
        } else {
            Self::General
        }
    }
}
