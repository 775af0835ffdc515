//! The general control step, for any scene: contacts → wall forces → the feed-forward → torques. Straight steps do the same
//! for one shape of scene, and share its parts.

use super::guidance::Beside;
use super::regularity::{fade, known_share, nearness};
use super::walls::{Acting, Active, Together};
use super::{Controller, task_part};
use crate::math::{Angle, Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::{Mechanism, Regularity, Shaping, shared_pose};
use crate::model::precomputed::MassModel;
use crate::model::principal::Principal;
use crate::model::solve::solve_symmetric;
use crate::render::scene::{Admissible, MAX_WALLS, VelocityTerms};
use crate::render::step_result::{StepResult, TorqueDemand, clear, put};
use heapless::Vec;
use nalgebra::SVector;

/// The beginning of every step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Begun<'a, T: Real, P, const N: usize> {
    /// Joint angles, whole turns taken off.
    angles: [Angle<T>; N],
    /// Filtered joint velocities, rad/s.
    qd: SVector<T, N>,
    pose: &'a P,
    /// The tip's own coordinates, m; zero beyond the task.
    place: SVector<T, N>,
    regularity: Regularity<T>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// [`Controller::step_generally`] where what it finds is kept.
    #[inline(never)]
    pub(crate) fn render_generally(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        let tip = self.mechanism.tip(&pose);
        let regularity = self.mechanism.regularity(&pose);
        let qd = self.encoders.velocities(counts, |filter, raw| filter.step(&self.coefficients, raw));
        Self::keep(&qd, &tip, found);
        found.parallel = regularity.parallel;
        let mut begun = Begun { angles, qd, pose: &pose, place: task_part::<T, M, N>(&tip), regularity };
        let (mut torque, rendered, force) = self.anywhere(&mut begun, counts, found);
        let asked = &mut found.asked;
        torque += self.weigh(&pose, asked);
        put(&rendered, &mut asked.rendered);
        asked.force_squared = force.dot(&force);
        if self.guidance.pushed {
            torque += self.add(&pose, &force, &self.guidance.pushing(), asked);
        }
        put(&torque, &mut asked.total);
    }

    /// Joint torques (N m) of any scene, what of them renders its forces, and their resultant (N): contacts → wall forces →
    /// the feed-forward → torques.
    #[inline(always)]
    fn anywhere(
        &mut self,
        begun: &mut Begun<'_, T, M::Pose, N>,
        counts: &[i32; N],
        found: &mut StepResult<T>,
    ) -> (SVector<T, N>, SVector<T, N>, SVector<T, N>) {
        let observed = self.coefficients.at_joints();
        let mut along = SVector::zeros();
        if observed {
            (begun.qd, along) = self.observe(begun.pose, counts, &begun.qd);
            put(&begun.qd, &mut found.at.qd);
        }
        let Begun { angles, qd, pose, place, regularity } = &*begun;

        let mut more: Vec<Active<T, N>, MAX_WALLS> = Vec::new();
        let along = observed.then_some(&along);
        let debt = self.debt();
        let touch = self.walls.touch::<K, N>(&self.coefficients, place, along, debt.as_ref(), &mut more);
        found.at.walls = touch.found;
        if touch.found.contacts > 0 {
            put(&self.mechanism.inverse(pose, &touch.normal), &mut found.motion);
        } else {
            clear::<T, N>(&mut found.motion);
        }
        let mut plain = touch.plain;
        let (mut beside, mut guided) = (Beside::none(), SVector::zeros());
        if self.guidance.any {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            guided = self.guidance.force(place, &velocity);
            plain += guided;
            // One joint alone has no other direction to shape into.
            if self.guidance.is_beside() && N > 1 {
                beside = self.guidance.beside(place, &velocity, self.walls.gain());
            }
        }

        // (4): what is shaped goes through M E Wrr⁻¹, the rest straight through Jᵀ.
        let (mut torque, rendered, force);
        if let Some(mut first) = touch.first {
            if let Some(gain) = self.gain
                && more.is_empty()
                && !beside.acts
            {
                let kept = first.shaped * self.below_the_pole(angles, pose, &first.normal, gain);
                plain += first.normal * (first.shaped - kept);
                first.shaped = kept;
            }
            let mut shaped = more.iter().fold(first.normal * first.shaped, |sum, a| sum + a.normal * a.shaped);
            if beside.acts {
                let stiff = self.guidance.sum(&beside);
                plain -= stiff;
                shaped += stiff;
            }
            force = plain + shaped;
            rendered = self.mechanism.transpose(pose, &force);
            let share = fade(nearness(regularity));
            let (through, left) = self.feed_forward(begun, &first, &more, &beside, &shaped, share);
            found.at.walls.shaping = share;
            torque = through + self.mechanism.transpose(pose, &(plain + left));
        } else {
            force = plain;
            torque = self.mechanism.transpose(pose, &plain);
            rendered = torque;
        }
        if touch.found.contacts == 0 {
            self.leave();
        } else if self.guidance.any {
            self.hold(&(torque - self.mechanism.transpose(pose, &guided)), found);
        } else {
            self.hold(&torque, found);
        }
        if M::SPEC.task < N && self.posture.is_some() {
            torque += self.posture_torque(pose, qd);
        }
        (torque, rendered, force)
    }

    /// Joint torques (N m) beside those of walls, springs and fields: what holds the device against gravity.
    #[inline(always)]
    pub(super) fn weigh(&self, pose: &M::Pose, asked: &mut TorqueDemand<T>) -> SVector<T, N> {
        let gravity = if self.gravity { self.mechanism.gravity(pose) } else { SVector::zeros() };
        put(&gravity, &mut asked.gravity);
        gravity
    }

    /// Adds another force (N) to those whose resultant is `force` (N), and to what renders them; its torques, N m.
    #[inline(never)]
    pub(super) fn add(
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

    /// Joint velocities (rad/s) by an estimator that watches joints, and the tip's (m/s). `before`: by what was at work
    /// when it is new.
    #[inline(never)]
    pub(super) fn observe(
        &mut self,
        pose: &M::Pose,
        counts: &[i32; N],
        before: &SVector<T, N>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let pushed = if self.coefficients.predicts() {
            solve_symmetric(&self.mechanism.mass(pose), &self.observers.acting)
        } else {
            SVector::zeros()
        };
        let qd = self.observers.step::<K>(&self.coefficients, counts, &pushed, before);
        (qd, task_part::<T, M, N>(&self.mechanism.velocity(pose, &qd)))
    }

    /// A unit motion of the tip, on a redundant device with the coordinate held that the scene names.
    #[inline(always)]
    pub(super) fn held(&self, shaping: Shaping<T, N>, pose: &M::Pose) -> Shaping<T, N> {
        if M::SPEC.task == N || self.admissible == Admissible::Orientation {
            return shaping;
        }
        self.admissible.hold(&shaping, &self.null(pose))
    }

    /// The motion that moves no tip, on a redundant device.
    #[inline(never)]
    pub(super) fn null(&self, pose: &M::Pose) -> Shaping<T, N> {
        let mut turning = SVector::<T, N>::zeros();
        turning[N - 1] = T::one();
        self.mechanism.shaping(pose, &turning)
    }

    /// The share of the feed-forward that keeps a gain α above 1 away from the inertia's pole. The wall meets
    /// m = Weff/(1 - α ρ), ρ = 1 - Weff/Wrr, which has no bound at α = 1/ρ; half way there, at (1 + 1/ρ)/2, it is twice
    /// Wrr, and no more is given.
    #[inline(never)]
    pub(super) fn below_the_pole(&self, angles: &[Angle<T>; N], pose: &M::Pose, n: &SVector<T, N>, gain: T) -> T {
        let shaping = self.held(self.mass.shaping(&self.mechanism, &radians(angles), pose, n), pose);
        let row = self.mechanism.transpose(pose, n);
        let w_eff = T::one() / row.dot(&solve_symmetric(&self.mechanism.mass(pose), &row));
        let coupling = (T::one() - w_eff / shaping.w_rr).greater(T::EPSILON);
        let most = T::from_f64(0.5) * (T::one() + T::one() / coupling);
        (most / gain).lesser(T::one())
    }

    /// The share `share` of the feed-forward of one or several active walls, and what is stiff beside them, whose
    /// resultant is `force` (N): torques without gravity, and what of the force is left for Jᵀ.
    #[inline(never)]
    pub(super) fn feed_forward(
        &self,
        begun: &Begun<'_, T, M::Pose, N>,
        first: &Active<T, N>,
        more: &[Active<T, N>],
        beside: &Beside<T, N>,
        force: &SVector<T, N>,
        share: T,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let Begun { angles, qd, pose, place, .. } = begun;
        let q = &radians(angles);
        if share <= T::zero() {
            return (SVector::zeros(), *force);
        }
        if more.is_empty() && !beside.acts {
            let shaping = self.held(self.mass.shaping(&self.mechanism, q, pose, &first.normal), pose);
            let (b, met) = self.bias(pose, place, qd, &Acting::One(first));
            (shaping.torque(first.shaped, &b, &met) * share, force * (T::one() - share))
        } else {
            let mut pulls = Vec::new();
            let together = Together::new::<K>(first, more, &self.guidance, beside, place, M::SPEC.task, &mut pulls);
            let along =
                |i| self.held(self.mass.shaping(&self.mechanism, q, pose, &together.principal.direction(i)), pose);
            let unused = Shaping { e: SVector::zeros(), me: SVector::zeros(), w_rr: T::one() };
            let shapings = core::array::from_fn(|i| if i + 1 < N { along(i) } else { unused });
            let of_level = |level| self.bias(pose, place, qd, &Acting::Level(&together, level));
            // Only where walls turn, or compensate damping, one level's is another than the next one's.
            let same = (self.biased && !self.walls.curved && !self.walls.damped).then(|| of_level(1));
            let bias = |level| self.biased.then(|| same.unwrap_or_else(|| of_level(level)));
            let first = &together.principal.direction(0);
            let gained = |gain| {
                let most = gain * self.below_the_pole(angles, pose, first, gain);
                (T::one() + (most - T::one()) * single_wall_weight(&together.principal)) / gain
            };
            let part = share * self.gain.map_or(T::one(), gained);
            together.principal.shaped(&shapings, force, part, bias)
        }
    }

    /// b without gravity: c - M J⁻¹(J̇ q̇ + κ), and B q̇ where a wall asks for it; and the part of it that the walls
    /// meet: the whole by the paper's (4), B q̇ alone where the force is rendered whatever moves. Zero when the scene
    /// has no velocity terms, where nothing moves by more than single counts, and where the estimate lags too far
    /// behind, see [`KNOWN_TURN`].
    #[inline(never)]
    pub(super) fn bias(
        &self,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        acting: &Acting<'_, T, N>,
    ) -> (SVector<T, N>, SVector<T, N>) {
        let mut b = SVector::zeros();
        if self.velocity_terms != VelocityTerms::Off {
            let qd = &self.encoders.certain(qd);
            b = self.mechanism.velocity_torque(pose, qd);
            if M::SPEC.task > 1 && self.walls.curved {
                let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
                let acceleration = self.walls.turning::<K, N>(place, &velocity, acting);
                b += MassModel::Exact.shaping(&self.mechanism, qd, pose, &acceleration).me;
            }
            if M::SPEC.task < N && self.admissible != Admissible::Orientation {
                let bent = self.mechanism.inverse(pose, &(self.mechanism.jacobian_rate(pose, qd) * qd));
                b = self.admissible.hold_bias(&b, &bent, &self.null(pose));
            }
            b *= self.known(pose, qd);
        }
        let share = self.walls.damping_share(acting);
        let damping = if share > T::zero() { self.viscous.component_mul(qd) * share } else { SVector::zeros() };
        let met = if self.velocity_terms == VelocityTerms::Rendered { damping } else { b + damping };
        (b + damping, met)
    }

    /// The share of the velocity terms that estimated velocities can tell, see [`KNOWN_TURN`].
    #[inline(always)]
    pub(super) fn known(&self, pose: &M::Pose, qd: &SVector<T, N>) -> T {
        known_share(&self.mechanism.regularity(pose), qd, self.coefficients.lag())
    }
}

/// Angles in radians, as a prepared mass matrix takes them.
#[inline(always)]
fn radians<T: Real, const N: usize>(angles: &[Angle<T>; N]) -> SVector<T, N> {
    SVector::from_fn(|i, _| angles[i].radians)
}

/// Similarity of several walls to a single one, for which a gain of the feed-forward above 1 is meant: a smooth step
/// from 1, where they coincide, to 0 where the second direction has a hundredth of the stiffness of the first (two
/// equal facets 11° apart). Beyond, the proof that no set of walls is less stable than without the feed-forward needs a
/// gain of 1.
fn single_wall_weight<T: Real, const N: usize>(principal: &Principal<T, N>) -> T {
    let second = principal.along(1) * T::from_f64(100.0);
    let s = (T::one() - second / principal.along(0).greater(T::EPSILON)).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}
