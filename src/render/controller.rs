//! One control step: encoder counts in, joint torques out.
//!
//! [`Controller::step_generally`] is the whole of it, in the order the data flows:
//! counts → angles → pose → contacts → wall forces → the feed-forward → torques
//! (`anywhere`, or a straight step for one shape of scene). It owns no hardware, allocates
//! nothing, and cannot panic: every index is bounded by a constant, every division is by something clamped. It is
//! generic over the float and the trigonometry, so the board's f32 step and the analysis' f64 are the same code.
//!
//! "Model only what a scene needs": a scene without feed-forward computes no mass matrix, one without velocity terms no
//! Coriolis forces, one without springs no tip velocity; the choices are made once, in [`Controller::new`].

use crate::math::{Angle, Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::{Device, weigh_directions};
use crate::model::mechanism::{Mechanism, Regularity, Shaping, shared_pose};
use crate::model::precomputed::MassModel;
use crate::model::principal::Principal;
use crate::model::solve::solve_symmetric;
use crate::render::scene::{Admissible, FeedForward, MAX_WALLS, Posture, Scene, SceneError, VelocityTerms};
use crate::render::step_result::{AtWalls, StepResult, TorqueDemand, clear, put};
use crate::render::velocity::{Coefficients, Washout};
use core::marker::PhantomData;
use encoders::Encoders;
pub use encoders::beyond;
use guidance::{Beside, Guidance};
use heapless::Vec;
use nalgebra::SVector;
use observers::Observers;
use passivity::Passivity;
use postcard_schema::Schema;
pub use push::{Push, PushedPlane};
use serde::{Deserialize, Serialize};
use straight::StepVariant;
use walls::{Acting, Active, Together, Walls};
pub use walls::{TOUCH_DEPTH, TOUCH_SHARE};

mod encoders;
mod guidance;
mod observers;
mod passivity;
mod posture;
mod push;
mod stiffness;
mod straight;
mod walls;

/// Sine of a serial singularity at and above which the feed-forward acts in full.
///
/// At 0.05 an elbow is 3° from stretched and cond J is about 40 on the shipped devices; f32 keeps the torque within
/// 2e-5 there (docs/hard-cases.md), so the limit protects the hand from a feed-forward that grows as 1/sin, not the
/// numbers.
pub const FULL_REGULARITY: f64 = 0.05;
/// Sine at and below which the feed-forward is off; in between it fades, so nothing jumps.
pub const NO_REGULARITY: f64 = 0.02;
/// A parallel singularity counts as this many times nearer: in full from a sine of 0.15 (rods 9° from one line), off
/// at 0.06. There it is the numbers: Jᵀ itself loses digits as 1/sin², and 0.15 is where f32 still keeps the torque
/// of a moving tip within 1e-4 (docs/hard-cases.md).
pub const PARALLEL_REGULARITY: f64 = 3.0;
/// Angle that the fastest joint may turn while its velocity estimate lags (rad), as a share of the sine of the nearest
/// singularity, for the velocity terms to act in full.
///
/// b grows as 1/sin³ at a steady speed of the tip, so within the lag it changes by three times this share. Here that
/// is 15 %, beyond [`UNKNOWN_TURN`] 30 %: there b is mostly what the motion was, and pushes a tip that slides towards a
/// stretched arm on into it (docs/model.md).
pub const KNOWN_TURN: f64 = 0.05;
/// The same share at and above which velocity terms are off; in between they fade, so nothing jumps.
pub const UNKNOWN_TURN: f64 = 0.1;

/// A scene's gains of one wall, as they may change while the wall is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gains<T> {
    /// Which wall, from 0.
    pub wall: u8,
    /// N/m
    pub stiffness: T,
    /// N s/m
    pub damping: T,
    /// True if its force is shaped.
    pub feed_forward: FeedForward,
    /// Corner of its washout, Hz.
    pub washout_hz: T,
}

/// The result of one step, as vectors of the mechanism's N joints; its fields for the walls can be read directly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T: Real, const N: usize> {
    /// See [`StepResult`].
    pub q: SVector<T, N>,
    /// See [`StepResult`].
    pub qd: SVector<T, N>,
    /// See [`StepResult`].
    pub tip: SVector<T, N>,
    /// Joint torques, N m: [`TorqueDemand::total`].
    pub torque: SVector<T, N>,
    /// See [`TorqueDemand`].
    pub gravity: SVector<T, N>,
    /// See [`TorqueDemand`].
    pub rendered: SVector<T, N>,
    /// See [`TorqueDemand`].
    pub force_squared: T,
    /// See [`StepResult`].
    pub motion: SVector<T, N>,
    /// See [`StepResult`].
    pub parallel: T,
    /// The state at the walls.
    pub walls: AtWalls<T>,
}

impl<T: Real, const N: usize> Step<T, N> {
    fn of(found: &StepResult<T>) -> Self {
        let StepResult { at, asked, motion, parallel, .. } = found;
        let first = |values: &[T; MAX_JOINTS]| SVector::from_fn(|i, _| values[i]);
        Self {
            q: first(&at.q),
            qd: first(&at.qd),
            tip: first(&at.tip),
            torque: first(&asked.total),
            gravity: first(&asked.gravity),
            rendered: first(&asked.rendered),
            force_squared: asked.force_squared,
            motion: first(motion),
            parallel: *parallel,
            walls: at.walls,
        }
    }
}

impl<T: Real, const N: usize> core::ops::Deref for Step<T, N> {
    type Target = AtWalls<T>;

    fn deref(&self) -> &AtWalls<T> {
        &self.walls
    }
}

/// The control step of one mechanism with N joints, its scene, and its memory between steps.
///
/// In this order in memory, so that what a usual step needs lies within the 1 KB that the FPU's loads reach.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Controller<T: Real, M, K, const N: usize> {
    variant: StepVariant,
    velocity_terms: VelocityTerms,
    gravity: bool,
    /// b of the shaped torque is not zero.
    biased: bool,
    /// It is c - M J⁻¹ J̇ q̇ and nothing else, and no wall meets any of it.
    usual_terms: bool,
    /// The same, and what the turning of normals adds to it.
    turning_terms: bool,
    mechanism: M,
    coefficients: Coefficients<T>,
    encoders: Encoders<T, N>,
    walls: Walls<T>,
    observers: Observers<T, N>,
    viscous: SVector<T, N>,
    /// α of the feed-forward where the inertia's pole could be reached: above 1.
    gain: Option<T>,
    admissible: Admissible,
    posture: Option<Posture<T>>,
    guidance: Guidance<T>,
    mass: MassModel<T, N>,
    /// Behind what those loads reach: it needs one address of its own, and would push others out.
    passivity: Passivity<T, N>,
    math: PhantomData<K>,
}

/// The beginning of every step.
#[derive(Clone, Copy, Debug)]
struct Begun<'a, T: Real, P, const N: usize> {
    /// Joint angles, whole turns taken off.
    angles: [Angle<T>; N],
    /// Filtered joint velocities, rad/s.
    qd: SVector<T, N>,
    pose: &'a P,
    /// The tip's own coordinates, m; zero beyond the task.
    place: SVector<T, N>,
    regularity: Regularity<T>,
}

/// The part of a scene that is the same for every mechanism.
struct Prepared<T: Real> {
    coefficients: Coefficients<T>,
    walls: Walls<T>,
    guidance: Guidance<T>,
}

/// Checks a scene and designs its filters. Not inlined: the mechanisms share it.
#[inline(never)]
fn prepare<T: Real, K: Math<T>>(device: &Device<T>, scene: &Scene<T>, task: usize) -> Result<Prepared<T>, SceneError> {
    scene.check(task)?;
    let coefficients = Coefficients::of_device::<K>((scene.estimator, scene.rate_hz, scene.cutoff_hz), device)
        .map_err(|_| SceneError::Cutoff)?;
    let (walls, mut guidance) = (Walls::new(scene)?, Guidance::new(scene));
    guidance.agree(walls.others());
    Ok(Prepared { coefficients, walls, guidance })
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// The run-time form of `scene` on this mechanism. Designs the filters, so not for use inside the step.
    ///
    /// Errors: whatever [`Scene::check`] finds.
    #[inline(never)]
    pub fn new(mechanism: M, device: &Device<T>, scene: &Scene<T>) -> Result<Self, SceneError> {
        let Prepared { coefficients, walls, guidance } = prepare::<T, K>(device, scene, M::SPEC.task)?;
        if scene.posture.is_some() && M::SPEC.task == N {
            return Err(SceneError::Posture);
        }
        let biased = scene.velocity_terms != VelocityTerms::Off || walls.damped;
        // The part that is rendered whatever moves; along a line no normal turns.
        let rendered = scene.velocity_terms == VelocityTerms::Rendered && !walls.damped;
        let turns = walls.curved && M::SPEC.task > 1;
        let moving = biased || guidance.any || scene.posture.is_some();
        Ok(Self {
            mechanism,
            mass: MassModel::Exact,
            observers: Observers::new(device, &coefficients),
            encoders: Encoders::new(device, &coefficients, M::SPEC.periodic, moving),
            passivity: Passivity::new(coefficients.rate()),
            coefficients,
            walls,
            guidance,
            viscous: SVector::from_fn(|i, _| device.joints[i].viscous),
            gravity: scene.gravity_compensation && device.weight,
            velocity_terms: scene.velocity_terms,
            gain: (scene.feed_forward_gain > T::one()).then_some(scene.feed_forward_gain),
            admissible: scene.admissible,
            posture: scene.posture,
            biased,
            usual_terms: rendered && !turns,
            turning_terms: rendered && turns,
            variant: StepVariant::Anew,
            math: PhantomData,
        })
    }

    /// Takes the mass matrix from `mass` from now on instead of the mechanism's closed form.
    pub fn set_mass(&mut self, mass: MassModel<T, N>) {
        self.mass = mass;
        self.choose();
    }

    /// One control step for these encoder counts. Call at the control rate.
    pub fn step(&mut self, counts: &[i32; N]) -> Step<T, N> {
        self.step_after(&[T::zero(); MAX_JOINTS], counts)
    }

    /// [`Controller::step`] where the motors gave these torques since the last one (N m), which an estimator that predicts
    /// wants to know.
    pub fn step_after(&mut self, acted: &[T; MAX_JOINTS], counts: &[i32; N]) -> Step<T, N> {
        let mut found = StepResult::default();
        self.render(counts, acted, &mut found);
        self.angles(counts, &mut found);
        Step::of(&found)
    }

    /// As [`Controller::step`] for any scene, the slow way: what every straight step is held to.
    pub fn step_generally(&mut self, counts: &[i32; N]) -> Step<T, N> {
        let mut found = StepResult::default();
        if self.variant == StepVariant::Anew {
            self.restart(counts, &mut found);
        }
        self.render_generally(counts, &mut found);
        self.angles(counts, &mut found);
        Step::of(&found)
    }

    /// [`Controller::step`] where what it finds is kept: writes the first N entries of every vector of `found` but the joint
    /// angles, which are worked out only where somebody looks ([`Controller::angles`]). `acted`: what the motors gave since
    /// the last step (N m), which is what was asked less what limits took.
    #[inline(always)]
    pub fn render(&mut self, counts: &[i32; N], acted: &[T; MAX_JOINTS], found: &mut StepResult<T>) {
        match self.variant {
            StepVariant::Wall => self.render_wall(counts, found),
            StepVariant::Round if N == 2 => self.render_round(counts, found),
            StepVariant::Several if N == 2 => self.render_several(counts, found),
            _ => self.render_otherwise(counts, acted, found),
        }
    }

    /// [`Controller::render`] where no straight step is ready.
    #[inline(never)]
    fn render_otherwise(&mut self, counts: &[i32; N], acted: &[T; MAX_JOINTS], found: &mut StepResult<T>) {
        // Only an estimator that predicts wants to know.
        if self.coefficients.at_joints() {
            self.observers.acting = SVector::from_fn(|i, _| acted[i.min(MAX_JOINTS - 1)]);
        }
        if self.variant == StepVariant::Anew {
            self.restart(counts, found);
        }
        match self.variant {
            StepVariant::Wall => self.render_wall(counts, found),
            StepVariant::Round if N == 2 => self.render_round(counts, found),
            StepVariant::Several if N == 2 => self.render_several(counts, found),
            _ => self.render_generally(counts, found),
        }
    }

    /// Writes the joint angles (rad) of these counts.
    #[inline(always)]
    pub fn angles(&self, counts: &[i32; N], found: &mut StepResult<T>) {
        put(&self.encoders.angles(counts).0, &mut found.at.q);
    }

    /// Lets the estimators begin where these counts are.
    fn restart(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        clear::<T, N>(&mut found.asked.gravity);
        self.encoders.begin(counts);
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        self.walls.begin::<K, N>(&task_part::<T, M, N>(&self.mechanism.tip(&pose)));
        self.variant = StepVariant::of(self);
    }

    /// [`Controller::step_generally`] where what it finds is kept.
    #[inline(never)]
    pub(crate) fn render_generally(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        let tip = self.mechanism.tip(&pose);
        let regularity = self.mechanism.regularity(&pose);
        let turned = self.encoders.turned(counts);
        self.passivity.observe(&turned);
        let qd = self.encoders.velocities(&turned, |filter, raw| filter.step(&self.coefficients, raw));
        Self::keep(&qd, &tip, found);
        found.parallel = regularity.parallel;
        weigh_directions(&self.mechanism, &pose, &mut found.leverage);
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

    /// Keeps joint velocities (rad/s) and the tip.
    #[inline(always)]
    fn keep(qd: &SVector<T, N>, tip: &SVector<T, N>, found: &mut StepResult<T>) {
        put(qd, &mut found.at.qd);
        put(tip, &mut found.at.tip);
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
        let debt = self.passivity.debt(self.coefficients.rate());
        let touch = self.walls.touch::<K, N>(&self.coefficients, place, along, debt.as_ref(), &mut more);
        found.at.walls = touch.found;
        if touch.found.contacts > 0 {
            found.at.walls.energy = self.passivity.energy();
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
            self.passivity.leave();
        } else if self.guidance.any {
            self.passivity.hold(&(torque - self.mechanism.transpose(pose, &guided)));
        } else {
            self.passivity.hold(&torque);
        }
        if M::SPEC.task < N && self.posture.is_some() {
            torque += self.posture_torque(pose, qd);
        }
        (torque, rendered, force)
    }

    /// Joint torques (N m) beside those of walls, springs and fields: what holds the device against gravity.
    #[inline(always)]
    fn weigh(&self, pose: &M::Pose, asked: &mut TorqueDemand<T>) -> SVector<T, N> {
        let gravity = if self.gravity { self.mechanism.gravity(pose) } else { SVector::zeros() };
        put(&gravity, &mut asked.gravity);
        gravity
    }

    /// Adds another force (N) to those whose resultant is `force` (N), and to what renders them; its torques, N m.
    #[inline(never)]
    fn add(
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
    fn observe(&mut self, pose: &M::Pose, counts: &[i32; N], before: &SVector<T, N>) -> (SVector<T, N>, SVector<T, N>) {
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
    fn held(&self, shaping: Shaping<T, N>, pose: &M::Pose) -> Shaping<T, N> {
        if M::SPEC.task == N || self.admissible == Admissible::Orientation {
            return shaping;
        }
        self.admissible.hold(&shaping, &self.null(pose))
    }

    /// The motion that moves no tip, on a redundant device.
    #[inline(never)]
    fn null(&self, pose: &M::Pose) -> Shaping<T, N> {
        let mut turning = SVector::<T, N>::zeros();
        turning[N - 1] = T::one();
        self.mechanism.shaping(pose, &turning)
    }

    /// The share of the feed-forward that keeps a gain α above 1 away from the inertia's pole. The wall meets
    /// m = Weff/(1 - α ρ), ρ = 1 - Weff/Wrr, which has no bound at α = 1/ρ; half way there, at (1 + 1/ρ)/2, it is twice
    /// Wrr, and no more is given.
    #[inline(never)]
    fn below_the_pole(&self, angles: &[Angle<T>; N], pose: &M::Pose, n: &SVector<T, N>, gain: T) -> T {
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
    fn feed_forward(
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
    fn bias(
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
    fn known(&self, pose: &M::Pose, qd: &SVector<T, N>) -> T {
        known_share(&self.mechanism.regularity(pose), qd, self.coefficients.lag())
    }

    /// Declares the joints to be at `q` (rad) for these counts, and restarts the estimators.
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        self.encoders.home(counts, q);
        self.forget();
    }

    /// Counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.encoders.zero()
    }

    /// Takes over homing from the controller this one replaces.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.encoders.set_zero(zero);
    }

    /// Restarts all estimators, so that earlier counts are not taken for a motion.
    pub fn forget(&mut self) {
        self.variant = StepVariant::Anew;
        self.observers.forget();
        self.walls.forget();
        self.guidance.forget();
    }

    /// Turns the passivity controller on or off; what was counted is forgotten.
    pub fn set_passivity(&mut self, on: bool) {
        self.passivity.set(on);
    }

    /// Returns true if a one-sided wall of this scene is touched at these counts: arming and scene changes are refused
    /// then.
    pub fn inside_a_wall(&self, counts: &[i32; N]) -> bool {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        self.walls.any_touched::<K, N>(&task_part::<T, M, N>(&self.mechanism.tip(&pose)))
    }

    /// Sets the host's force and plane from the next step on.
    pub fn set_push(&mut self, push: Option<&Push<T>>) {
        self.guidance.set_push(push);
        self.choose();
    }

    /// Tip velocity (m/s) at these counts and joint velocities (rad/s), and the force (N) that the host's push makes
    /// there. Computes a pose, so not for the step.
    pub fn pushed(&self, counts: &[i32; N], qd: &SVector<T, N>) -> (SVector<T, N>, SVector<T, N>) {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        let place = task_part::<T, M, N>(&self.mechanism.tip(&pose));
        let velocity = task_part::<T, M, N>(&self.mechanism.velocity(&pose, qd));
        let force = self.guidance.push().map_or(SVector::zeros(), |push| push.at(&place, &velocity));
        (velocity, force)
    }

    /// Applies checked gains between two steps; estimators and the washout's state go on.
    pub fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        self.walls.set_gains(gains, washout);
        self.guidance.agree(self.walls.others());
        self.choose();
    }

    /// Applies checked coefficients of the velocity estimators between two steps; their states go on. Another estimator
    /// that watches joints starts from the velocities by the low-pass.
    pub fn set_coefficients(&mut self, coefficients: &Coefficients<T>) {
        if coefficients.kind() != self.coefficients.kind() {
            self.observers.forget();
        }
        self.coefficients = *coefficients;
        self.encoders.retune(coefficients);
        self.choose();
    }

    /// Takes the step that fits, unless the estimators must restart at the next one.
    fn choose(&mut self) {
        if self.variant != StepVariant::Anew {
            self.variant = StepVariant::of(self);
        }
    }
}

/// Angles in radians, as a prepared mass matrix takes them.
#[inline(always)]
fn radians<T: Real, const N: usize>(angles: &[Angle<T>; N]) -> SVector<T, N> {
    SVector::from_fn(|i, _| angles[i].radians)
}

/// The tip's own coordinates; those beyond the task dimension (φ) zero.
#[inline(always)]
fn task_part<T: Real, M: Mechanism<T, N>, const N: usize>(v: &SVector<T, N>) -> SVector<T, N> {
    let mut part = *v;
    for i in M::SPEC.task..N {
        part[i] = T::zero();
    }
    part
}

/// The share of the velocity terms that acts at joint velocities `qd` (rad/s) whose estimate lags by `lag` (s), see
/// [`KNOWN_TURN`].
#[inline(always)]
pub fn known_share<T: Real, const N: usize>(regularity: &Regularity<T>, qd: &SVector<T, N>, lag: T) -> T {
    let near = regularity.serial.lesser(regularity.parallel);
    let turned = qd.iter().fold(T::zero(), |most, v| most.greater(v.abs())) * lag;
    if turned <= near * T::from_f64(KNOWN_TURN) {
        return T::one();
    }
    let unknown = near * T::from_f64(UNKNOWN_TURN);
    if turned >= unknown {
        return T::zero();
    }
    let s = (unknown - turned) / (near * T::from_f64(UNKNOWN_TURN - KNOWN_TURN));
    s * s * (T::from_f64(3.0) - s - s)
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

/// Distance from singularity, as the feed-forward needs it: see [`FULL_REGULARITY`] and [`PARALLEL_REGULARITY`].
#[inline(always)]
fn nearness<T: Real>(regularity: &Regularity<T>) -> T {
    regularity.serial.lesser(regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY))
}

/// The share of the feed-forward at [`nearness`]: a smooth step from [`NO_REGULARITY`] to [`FULL_REGULARITY`].
#[inline(always)]
fn fade<T: Real>(regularity: T) -> T {
    let (low, high) = (T::from_f64(NO_REGULARITY), T::from_f64(FULL_REGULARITY));
    if regularity >= high {
        return T::one();
    }
    let s = ((regularity - low) * T::from_f64(1.0 / (FULL_REGULARITY - NO_REGULARITY))).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}
