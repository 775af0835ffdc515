//! One control step: encoder counts in, joint torques out.
//!
//! [`Controller::step_generally`] is the whole of it, in the order the data flows:
//! counts → angles → pose → contacts → wall forces → the feed-forward → torques
//! (`general.rs`, or a straight step for one shape of scene). It owns no hardware, allocates
//! nothing, and cannot panic: every index is bounded by a constant, every division is by something clamped. It is
//! generic over the float and the trigonometry, so the board's f32 step and the analysis' f64 are the same code.
//!
//! "Model only what a scene needs": a scene without feed-forward computes no mass matrix, one without velocity terms no
//! Coriolis forces, one without springs no tip velocity; the choices are made once, in [`Controller::new`].

use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::Device;
use crate::model::mechanism::{Mechanism, shared_pose};
use crate::model::precomputed::MassModel;
use crate::render::scene::{Admissible, Posture, Scene, SceneError, VelocityTerms};
use crate::render::step_result::{AtWalls, StepResult, clear, put};
use crate::render::velocity::{Coefficients, Washout};
use core::marker::PhantomData;
use encoders::Encoders;
pub use encoders::beyond;
pub use gains::Gains;
use guidance::Guidance;
use nalgebra::SVector;
use observers::Observers;
use passivity::{Debt, Passivity};
pub use push::{Push, PushedPlane};
pub use regularity::{FULL_REGULARITY, KNOWN_TURN, NO_REGULARITY, PARALLEL_REGULARITY, UNKNOWN_TURN, known_share};
use straight::StepVariant;
use walls::Walls;
pub use walls::{TOUCH_DEPTH, TOUCH_SHARE};

mod encoders;
mod gains;
mod general;
mod guidance;
mod observers;
mod passivity;
mod posture;
mod push;
mod regularity;
mod stiffness;
mod straight;
mod walls;

/// The result of one step, as vectors of the mechanism's N joints; its fields for the walls can be read directly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T: Real, const N: usize> {
    /// See [`StepResult`].
    pub q: SVector<T, N>,
    /// See [`StepResult`].
    pub qd: SVector<T, N>,
    /// See [`StepResult`].
    pub tip: SVector<T, N>,
    /// Joint torques, N m: [`TorqueDemand::total`](crate::render::step_result::TorqueDemand::total).
    pub torque: SVector<T, N>,
    /// See [`TorqueDemand`](crate::render::step_result::TorqueDemand).
    pub gravity: SVector<T, N>,
    /// See [`TorqueDemand`](crate::render::step_result::TorqueDemand).
    pub rendered: SVector<T, N>,
    /// See [`TorqueDemand`](crate::render::step_result::TorqueDemand).
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
    /// The walls' energy is counted: to be paid back, or because it is shown.
    counts_energy: bool,
    /// The passivity controller is on.
    pays_energy: bool,
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
            counts_energy: false,
            pays_energy: false,
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
        if self.counts_energy {
            self.observe_energy(counts);
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
        if self.counts_energy {
            self.observe_energy(counts);
        }
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

    /// Counts the energy of the period that ends with these counts, unless the estimators begin with them.
    #[inline(never)]
    fn observe_energy(&mut self, counts: &[i32; N]) {
        if self.variant != StepVariant::Anew {
            self.passivity.observe(&self.encoders.turned(counts));
        }
    }

    /// The walls ask for these joint torques (N m) until the next step.
    #[inline(always)]
    fn hold(&mut self, torque: &SVector<T, N>, found: &mut StepResult<T>) {
        if self.counts_energy {
            found.at.walls.energy = self.passivity.energy();
            self.passivity.hold(torque);
        }
    }

    /// No wall is touched.
    #[inline(always)]
    fn leave(&mut self) {
        if self.counts_energy {
            self.passivity.leave();
        }
    }

    /// The walls' energy debt, if the passivity controller is on.
    #[inline(always)]
    fn debt(&self) -> Option<Debt<T>> {
        if self.pays_energy { self.passivity.debt(self.coefficients.rate()) } else { None }
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

    /// Keeps joint velocities (rad/s) and the tip.
    #[inline(always)]
    fn keep(qd: &SVector<T, N>, tip: &SVector<T, N>, found: &mut StepResult<T>) {
        put(qd, &mut found.at.qd);
        put(tip, &mut found.at.tip);
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

    /// Turns the passivity controller on or off; without it the walls' energy is counted only where it is `shown`. What was
    /// counted is forgotten.
    pub fn set_passivity(&mut self, on: bool, shown: bool) {
        let counts = on || shown;
        if (self.counts_energy, self.pays_energy) != (counts, on) {
            self.passivity.forget();
        }
        (self.counts_energy, self.pays_energy) = (counts, on);
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

/// The tip's own coordinates; those beyond the task dimension (φ) zero.
#[inline(always)]
fn task_part<T: Real, M: Mechanism<T, N>, const N: usize>(v: &SVector<T, N>) -> SVector<T, N> {
    let mut part = *v;
    for i in M::SPEC.task..N {
        part[i] = T::zero();
    }
    part
}
