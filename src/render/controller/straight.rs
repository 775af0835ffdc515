//! Straight steps: one function for each shape of scene, chosen once, when a program is built.
//!
//! `Controller::anywhere` renders any scene and is the reference: it goes through a list of walls, and asks at each step
//! for what the scene has not. A straight step estimates, touches and remembers the same, bit for bit, without the list and the
//! questions; its torques it puts together in fewer operations, so they are the same but for roundings.
//! tests/straight_steps.rs holds every one to both. What it meets rarely it leaves to others: a fading feed-forward to the
//! general step, unusual velocity terms to a cold function.
//!
//! Each is a function of its own, not inlined: together in one, they would share a stack frame too large for the FPU's
//! loads, and all become slower.
//!
//! To add one: a file beside wall.rs with its function, a line in [`StepVariant`] and in [`StepVariant::of`], its arm in
//! [`Controller::render`], its scenes in tests/straight_steps.rs, and its functions in emulator/src/stages.rs.

use super::regularity::{FULL_REGULARITY, PARALLEL_REGULARITY};
use super::{Controller, task_part};
use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::{Mechanism, Regularity, Shaped};
use crate::model::precomputed::MassModel;
use crate::render::controller::walls::{Acting, Active};
use crate::render::scene::{Admissible, VelocityTerms};
use crate::render::step_result::{Guided, StepResult, TorqueDemand, put};
use nalgebra::SVector;

mod round;
mod several;
mod wall;

/// The beginning of every straight step.
#[derive(Clone, Copy)]
struct Started<T: Real, P: Copy, const N: usize> {
    pose: P,
    /// The tip's own coordinates, m; zero beyond the task.
    place: SVector<T, N>,
    /// Filtered joint velocities, rad/s.
    qd: SVector<T, N>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Writes what every step finds. Nothing is done, nor written, where the feed-forward does not act in full: the general
    /// step knows how it fades.
    #[inline(always)]
    fn start(&mut self, counts: &[i32; N], found: &mut StepResult<T>) -> Option<Started<T, M::Pose, N>> {
        let least = Regularity {
            serial: T::from_f64(FULL_REGULARITY),
            parallel: T::from_f64(FULL_REGULARITY * PARALLEL_REGULARITY),
        };
        let (_, angles) = self.encoders.angles(counts);
        let pose = self.mechanism.regular_pose::<K>(&angles, &least)?;
        let tip = self.mechanism.tip(&pose);
        let qd = self.encoders.velocities(counts, |filter, raw| filter.pass(&self.coefficients, raw));
        Self::keep(&qd, &tip, found);
        found.parallel = self.mechanism.regularity(&pose).parallel;
        // Without weight that stays zero from where the steps began.
        if self.gravity {
            put(&self.mechanism.gravity(&pose), &mut found.asked.gravity);
        }
        let started = Started { pose, place: task_part::<T, M, N>(&tip), qd };
        Some(started)
    }

    /// Writes what is asked for: these torques (N m), what holds the device against gravity, and what there is beside walls,
    /// whose resultant is `force` (N).
    #[inline(always)]
    fn total(&self, torque: &SVector<T, N>, force: impl FnOnce() -> SVector<T, N>, found: &mut StepResult<T>) {
        let mut total = *torque;
        if self.gravity {
            for i in 0..N.min(MAX_JOINTS) {
                total[i] += found.asked.gravity[i];
            }
        }
        put(&total, &mut found.asked.total);
        if self.guidance.adds {
            add_guided(&force(), &found.guided, &mut found.asked);
        }
    }

    /// The part of springs, fields and the host: computed before the walls, while few numbers have to be kept, and
    /// added last.
    #[inline(never)]
    fn guide(&self, started: &Started<T, M::Pose, N>, guided: &mut Guided<T>) {
        let Started { pose, place, qd } = started;
        let mut force = self.guidance.pushing();
        if self.guidance.any {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            force += self.guidance.force(place, &velocity);
        }
        put(&force, &mut guided.force);
        put(&self.mechanism.transpose(pose, &force), &mut guided.torque);
    }

    /// Equation (4) for the force `force` (N) along `normal`, that of a wall (by its index) or of none.
    #[inline(always)]
    fn shaped(
        &self,
        started: &Started<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> Shaped<T, N> {
        let Started { pose, .. } = started;
        if !self.biased {
            return self.mechanism.shaped(pose, normal, force, None);
        }
        if let Some(certain) = self.certain(started).filter(|_| self.usual_terms) {
            return self.mechanism.shaped(pose, normal, force, Some(&certain));
        }
        self.shaped_rarely(started, normal, force, wall)
    }

    /// The part of the joint velocities that exceeds a doubt (rad/s), where velocity terms act in full.
    #[inline(always)]
    fn certain(&self, started: &Started<T, M::Pose, N>) -> Option<SVector<T, N>> {
        let Started { pose, qd, .. } = started;
        let certain = self.encoders.certain(qd);
        let known = self.encoders.surely_known(qd) || self.known(pose, &certain) >= T::one();
        known.then_some(certain)
    }

    /// [`Controller::shaped`] where it is not usual.
    #[inline(always)]
    fn shaped_rarely(
        &self,
        started: &Started<T, M::Pose, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> Shaped<T, N> {
        let Started { pose, place, qd } = started;
        // Copies, number by number, so that the usual case need not keep these in memory.
        let (pose, place, qd, normal) = (*pose, *place, *qd, *normal);
        let Shaped { e, torque } = self.shaped_otherwise(&pose, &place, &qd, &normal, force, wall);
        Shaped { e: e.map(|e| e), torque: torque.map(|torque| torque) }
    }

    /// The same with any velocity terms, or a part of them: the wall may meet them, its normal may turn, and joint damping
    /// may be compensated.
    #[inline(never)]
    fn shaped_otherwise(
        &self,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        normal: &SVector<T, N>,
        force: T,
        wall: Option<usize>,
    ) -> Shaped<T, N> {
        let acting = Active::along(normal, force, wall);
        let shaping = self.mechanism.shaping(pose, normal);
        let (b, met) = self.bias(pose, place, qd, &Acting::One(&acting));
        Shaped { e: shaping.e, torque: shaping.torque(force, &b, &met) }
    }
}

/// Adds what springs, fields and the host add to what is asked for the walls, whose resultant is `force` (N).
#[inline(never)]
fn add_guided<T: Real, const N: usize>(force: &SVector<T, N>, guided: &Guided<T>, asked: &mut TorqueDemand<T>) {
    let mut squared = T::zero();
    for i in 0..N.min(MAX_JOINTS) {
        let along = force[i] + guided.force[i];
        squared += along * along;
        asked.rendered[i] += guided.torque[i];
        asked.total[i] += guided.torque[i];
    }
    asked.force_squared = squared;
}

/// The step that a scene gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepVariant {
    /// The general one, once, from which the estimators begin; then what fits.
    Anew,
    /// Any scene.
    General,
    /// One wall alone, or none.
    Wall,
    /// One round wall alone whose velocity terms follow its normal, on a device with two joints.
    Round,
    /// Several walls in the plane, or walls with the feed-forward beside springs or a host's plane, on a device with two
    /// joints.
    Several,
}

impl StepVariant {
    /// The variant of a scene as the controller holds it. Straight steps have the closed form, a low-pass behind the
    /// backward difference and α = 1; only in the plane, with two joints, do they have springs, fields or a host's plane
    /// beside walls with the feed-forward.
    pub fn of<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(controller: &Controller<T, M, K, N>) -> Self {
        let Controller { walls, velocity_terms, mass, admissible, posture, coefficients, guidance, .. } = controller;
        let closed_form =
            matches!(mass, MassModel::Exact) && (M::SPEC.task == N || *admissible == Admissible::Orientation);
        let beside = guidance.any && guidance.is_beside();
        let planar = N == 2 && M::SPEC.task == 2;
        // If several walls turn, or compensate damping, each has its part in that.
        let flat = !walls.damped && (*velocity_terms == VelocityTerms::Off || !walls.curved);
        let usual = closed_form && posture.is_none() && walls.gain() == T::one() && coefficients.is_low_pass();
        if !usual {
            Self::General
        } else if walls.at_most_one() && !beside {
            if planar && controller.turning_terms && walls.is_single_ball() { Self::Round } else { Self::Wall }
        } else if planar && walls.are_stiff() && flat {
            Self::Several
        } else {
            Self::General
        }
    }
}
