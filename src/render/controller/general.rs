//! The general control step, which renders any scene: contacts → wall forces → the feed-forward → torques. A straight
//! step does the same for one kind of scene, and shares these parts.

use super::guidance::SharedGuidance;
use super::regularity::{clearance, fade, velocity_term_share};
use super::walls::{BiasScope, ContactGroup, ShapedContact};
use super::{Controller, task_part};
use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::{Mechanism, Regularity, Shaping, shared_pose, shared_shaping};
use crate::model::principal::Principal;
use crate::model::solve::solve_symmetric;
use crate::render::scene::{Admissible, MAX_WALLS, VelocityTerms};
use crate::render::step_result::{StepResult, TorqueDemand, clear, put};
use heapless::Vec;
use nalgebra::SVector;

/// Values that every part of the general step uses.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepStart<'a, T: Real, P, const N: usize> {
    /// Filtered joint velocities, rad/s.
    qd: SVector<T, N>,
    pose: &'a P,
    /// Position of the tip, m. Components beyond the task dimension are zero.
    place: SVector<T, N>,
    regularity: Regularity<T>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Runs [`Controller::step_generally`], but writes into `result`.
    #[inline(never)]
    pub(crate) fn render_generally(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        let tip = self.mechanism.tip(&pose);
        let regularity = self.mechanism.regularity(&pose);
        let qd = self.encoders.velocities(counts, |filter, raw| filter.step(&self.coefficients, raw));
        Self::write_motion(&qd, &tip, result);
        result.parallel = regularity.parallel;
        let mut start = StepStart { qd, pose: &pose, place: task_part::<T, M, N>(&tip), regularity };
        let (mut torque, rendered, force) = self.render_any_scene(&mut start, counts, result);
        let asked = &mut result.asked;
        torque += self.write_gravity(&pose, asked);
        put(&rendered, &mut asked.rendered);
        asked.force_squared = force.dot(&force);
        if self.guidance.is_pushed {
            torque += self.add_force(&pose, &force, &self.guidance.push_force(), asked);
        }
        put(&torque, &mut asked.total);
    }

    /// Returns the joint torques of any scene, the part that renders its forces (N m), and their resultant (N).
    #[inline(always)]
    fn render_any_scene(
        &mut self,
        start: &mut StepStart<'_, T, M::Pose, N>,
        counts: &[i32; N],
        result: &mut StepResult<T>,
    ) -> (SVector<T, N>, SVector<T, N>, SVector<T, N>) {
        let uses_joints = self.coefficients.uses_joints();
        let mut along = SVector::zeros();
        if uses_joints {
            (start.qd, along) = self.observe(start.pose, counts, &start.qd);
            put(&start.qd, &mut result.at.qd);
        }
        let StepStart { qd, pose, place, regularity } = &*start;

        let mut more: Vec<ShapedContact<T, N>, MAX_WALLS> = Vec::new();
        let along = uses_joints.then_some(&along);
        let debt = self.debt();
        let touch = self.walls.compute_contacts::<K, N>(&self.coefficients, place, along, debt.as_ref(), &mut more);
        result.at.walls = touch.at_walls;
        if touch.at_walls.contacts > 0 {
            put(&self.mechanism.inverse(pose, &touch.normal), &mut result.motion);
        } else {
            clear::<T, N>(&mut result.motion);
        }
        let mut plain = touch.plain;
        let (mut shared, mut guidance_force) = (SharedGuidance::none(), SVector::zeros());
        if self.guidance.is_active {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            guidance_force = self.guidance.force(place, &velocity);
            plain += guidance_force;
            // A single joint has no other direction to shape.
            if self.guidance.shares_feed_forward() && N > 1 {
                shared = self.guidance.shared_part(place, &velocity, self.walls.gain());
            }
        }

        // Equation (4): the shaped force goes through M E Wrr⁻¹, the rest of the force through Jᵀ.
        let (mut torque, rendered, force);
        if let Some(mut first) = touch.first {
            if let Some(gain) = self.gain
                && more.is_empty()
                && !shared.acts
            {
                let limited = first.shaped * self.share_below_pole(pose, &first.normal, gain);
                plain += first.normal * (first.shaped - limited);
                first.shaped = limited;
            }
            let mut shaped = more.iter().fold(first.normal * first.shaped, |sum, a| sum + a.normal * a.shaped);
            if shared.acts {
                let stiff = self.guidance.shared_force(&shared);
                plain -= stiff;
                shaped += stiff;
            }
            force = plain + shaped;
            rendered = self.mechanism.transpose(pose, &force);
            let share = fade(clearance(regularity));
            let (through, left) = self.feed_forward(start, &first, &more, &shared, &shaped, share);
            result.at.walls.shaping = share;
            torque = through + self.mechanism.transpose(pose, &(plain + left));
        } else {
            force = plain;
            torque = self.mechanism.transpose(pose, &plain);
            rendered = torque;
        }
        if touch.at_walls.contacts == 0 {
            self.record_no_contact();
        } else if self.guidance.is_active {
            self.record_wall_torques(&(torque - self.mechanism.transpose(pose, &guidance_force)), result);
        } else {
            self.record_wall_torques(&torque, result);
        }
        if M::SPEC.task < N && self.posture.is_some() {
            torque += self.posture_torque(pose, qd);
        }
        (torque, rendered, force)
    }

    /// Writes and returns the joint torques (N m) that hold the device against gravity.
    #[inline(always)]
    pub(super) fn write_gravity(&self, pose: &M::Pose, asked: &mut TorqueDemand<T>) -> SVector<T, N> {
        let gravity = if self.gravity { self.mechanism.gravity(pose) } else { SVector::zeros() };
        put(&gravity, &mut asked.gravity);
        gravity
    }

    /// Adds the force `other` (N) to the resultant `force` (N). Adds and returns the torques of `other` (N m).
    #[inline(never)]
    pub(super) fn add_force(
        &self,
        pose: &M::Pose,
        force: &SVector<T, N>,
        other: &SVector<T, N>,
        asked: &mut TorqueDemand<T>,
    ) -> SVector<T, N> {
        let all = force + other;
        asked.force_squared = all.dot(&all);
        let torque = self.mechanism.transpose(pose, other);
        for i in 0..N.min(MAX_JOINTS) {
            asked.rendered[i] += torque[i];
        }
        torque
    }

    /// Returns the joint velocities (rad/s) of the joint estimators, and the tip velocity (m/s). `before` is the
    /// initial velocity of a new estimator.
    #[inline(never)]
    pub(super) fn observe(
        &mut self,
        pose: &M::Pose,
        counts: &[i32; N],
        before: &SVector<T, N>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let pushed = if self.coefficients.predicts() {
            solve_symmetric(&self.mechanism.mass(pose), &self.observers.motor_torque)
        } else {
            SVector::zeros()
        };
        let qd = self.observers.step::<K>(&self.coefficients, counts, &pushed, before);
        (qd, task_part::<T, M, N>(&self.mechanism.velocity(pose, &qd)))
    }

    /// Returns the joint motion for a unit motion of the tip. On a redundant device, the scene's coordinate is held.
    #[inline(always)]
    pub(super) fn hold_coordinate(&self, shaping: Shaping<T, N>, pose: &M::Pose) -> Shaping<T, N> {
        if M::SPEC.task == N || self.admissible == Admissible::Orientation {
            return shaping;
        }
        self.admissible.hold(&shaping, &self.null_motion(pose))
    }

    /// Returns the motion of a redundant device that does not move the tip.
    #[inline(never)]
    pub(super) fn null_motion(&self, pose: &M::Pose) -> Shaping<T, N> {
        let mut turning = SVector::<T, N>::zeros();
        turning[N - 1] = T::one();
        self.mechanism.shaping(pose, &turning)
    }

    /// Returns the share of the feed-forward that keeps a gain α above 1 away from the inertia's pole. The wall meets m
    /// = Weff/(1 - α ρ) with ρ = 1 - Weff/Wrr, which is unbounded at α = 1/ρ. The largest effective gain is half way
    /// from 1 to the pole, at (1 + 1/ρ)/2, where m is twice Wrr.
    #[inline(never)]
    pub(super) fn share_below_pole(&self, pose: &M::Pose, n: &SVector<T, N>, gain: T) -> T {
        let shaping = self.hold_coordinate(shared_shaping(&self.mechanism, pose, n), pose);
        let row = self.mechanism.transpose(pose, n);
        let w_eff = T::one() / row.dot(&solve_symmetric(&self.mechanism.mass(pose), &row));
        let coupling = (T::one() - w_eff / shaping.w_rr).greater(T::EPSILON);
        let limit = T::from_f64(0.5) * (T::one() + T::one() / coupling);
        (limit / gain).lesser(T::one())
    }

    /// Applies `share` of the feed-forward to the resultant `force` (N) of the active walls and the stiff guidance.
    /// Returns the torques without gravity (N m), and the force that is left for Jᵀ (N).
    #[inline(never)]
    pub(super) fn feed_forward(
        &self,
        start: &StepStart<'_, T, M::Pose, N>,
        first: &ShapedContact<T, N>,
        more: &[ShapedContact<T, N>],
        shared: &SharedGuidance<T, N>,
        force: &SVector<T, N>,
        share: T,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let StepStart { qd, pose, place, .. } = start;
        if share <= T::zero() {
            return (SVector::zeros(), *force);
        }
        if more.is_empty() && !shared.acts {
            let shaping = self.hold_coordinate(shared_shaping(&self.mechanism, pose, &first.normal), pose);
            let (b, subtracted) = self.bias(pose, place, qd, &BiasScope::One(first));
            (shaping.torque(first.shaped, &b, &subtracted) * share, force * (T::one() - share))
        } else {
            let mut pulls = Vec::new();
            let group = ContactGroup::new::<K>(first, more, &self.guidance, shared, place, M::SPEC.task, &mut pulls);
            let along =
                |i| self.hold_coordinate(shared_shaping(&self.mechanism, pose, &group.principal.direction(i)), pose);
            let unused = Shaping { e: SVector::zeros(), me: SVector::zeros(), w_rr: T::one() };
            let shapings = core::array::from_fn(|i| if i + 1 < N { along(i) } else { unused });
            let of_level = |level| self.bias(pose, place, qd, &BiasScope::Level(&group, level));
            // The bias of the levels differs only if normals turn or walls compensate damping.
            let same =
                (self.has_bias && !self.walls.has_curved_wall && !self.walls.compensates_damping).then(|| of_level(1));
            let bias = |level| self.has_bias.then(|| same.unwrap_or_else(|| of_level(level)));
            let first = &group.principal.direction(0);
            let share_of_gain = |gain| {
                let limit = gain * self.share_below_pole(pose, first, gain);
                (T::one() + (limit - T::one()) * single_wall_weight(&group.principal)) / gain
            };
            let part = share * self.gain.map_or(T::one(), share_of_gain);
            group.principal.feed_forward(&shapings, force, part, bias)
        }
    }

    /// Returns b without gravity, c - M J⁻¹(J̇ q̇ + κ), plus B q̇ if a wall requests it, and the part of b that is
    /// subtracted from the walls' force. That part is all of b by the paper's (4), and B q̇ alone if the force is
    /// rendered in every motion. Velocity terms are zero if the scene has none, if no joint moves by more than single
    /// counts, and if the velocity estimate lags too far behind, see [`FULL_TERMS_TURN`].
    #[inline(never)]
    pub(super) fn bias(
        &self,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        scope: &BiasScope<'_, T, N>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let mut b = SVector::zeros();
        if self.velocity_terms != VelocityTerms::Off {
            let qd = &self.encoders.velocities_beyond_one_count(qd);
            b = self.mechanism.velocity_torque(pose, qd);
            if M::SPEC.task > 1 && self.walls.has_curved_wall {
                let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
                let acceleration = self.walls.normal_turn_acceleration::<K, N>(place, &velocity, scope);
                b += shared_shaping(&self.mechanism, pose, &acceleration).me;
            }
            if M::SPEC.task < N && self.admissible != Admissible::Orientation {
                let qdd_bias = self.mechanism.inverse(pose, &(self.mechanism.jacobian_rate(pose, qd) * qd));
                b = self.admissible.hold_bias(&b, &qdd_bias, &self.null_motion(pose));
            }
            b *= self.velocity_term_share(pose, qd);
        }
        let share = self.walls.damping_share(scope);
        let damping = if share > T::zero() { self.viscous.component_mul(qd) * share } else { SVector::zeros() };
        let subtracted = if self.velocity_terms == VelocityTerms::Rendered { damping } else { b + damping };
        (b + damping, subtracted)
    }

    /// Returns the share of the velocity terms that acts with estimated velocities, see [`FULL_TERMS_TURN`].
    #[inline(always)]
    pub(super) fn velocity_term_share(&self, pose: &M::Pose, qd: &SVector<T, N>) -> T {
        velocity_term_share(&self.mechanism.regularity(pose), qd, self.coefficients.lag())
    }
}

/// Returns the similarity of several walls to a single wall: a smooth step from 1 for coinciding walls to 0 if the
/// second direction has a hundredth of the stiffness of the first (two equal facets 11° apart). A feed-forward gain
/// above 1 is only for a single wall, because the stability proof for several walls needs a gain of 1.
fn single_wall_weight<T: Real, const N: usize>(principal: &Principal<T, N>) -> T {
    let second = principal.stiffness_along(1) * T::from_f64(100.0);
    let s = (T::one() - second / principal.stiffness_along(0).greater(T::EPSILON)).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}
