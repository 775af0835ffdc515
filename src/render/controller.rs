//! One control step, which computes joint torques from encoder counts.
//!
//! [`Controller::step_generally`] runs a complete step in the order of the data flow: counts → angles → pose → contacts
//! → wall forces → the feed-forward → torques (`general.rs`). A straight step does the same for one kind of scene. The
//! controller owns no hardware, allocates nothing, and cannot panic, because every index is bounded and every divisor
//! is clamped. It is generic over float and trigonometry, so the board's f32 and the analysis' f64 share the code.
//!
//! The controller computes only what the scene needs: without feed-forward no mass matrix, without velocity terms no
//! Coriolis forces, without springs no tip velocity. [`Controller::new`] makes these choices once.

use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::Device;
use crate::model::mechanism::{Mechanism, shared_pose};
use crate::render::scene::{Admissible, Posture, Scene, SceneError, VelocityTerms};
use crate::render::step_result::{AtWalls, StepResult, clear, put};
use crate::render::velocity::{Coefficients, Washout};
use core::marker::PhantomData;
use encoders::Encoders;
pub use encoders::beyond_uncertainty;
pub use gains::Gains;
use guidance::Guidance;
use nalgebra::SVector;
use observers::Observers;
use passivity::{Debt, Passivity};
pub use push::{Push, PushedPlane};
pub use regularity::{
    FULL_REGULARITY, FULL_TERMS_TURN, NO_REGULARITY, NO_TERMS_TURN, PARALLEL_REGULARITY, velocity_term_share,
};
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

/// The result of one step, as vectors of the mechanism's N joints. Dereferences to the state at the walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T: Real, const N: usize> {
    /// Joint angles, rad.
    pub q: SVector<T, N>,
    /// Filtered joint velocities, rad/s.
    pub qd: SVector<T, N>,
    /// Task position: the tip, m (and φ, rad).
    pub tip: SVector<T, N>,
    /// Total joint torques, N m.
    pub torque: SVector<T, N>,
    /// Torques that hold the device against gravity, N m.
    pub gravity: SVector<T, N>,
    /// Torques that render the forces of walls, springs and fields, N m.
    pub rendered: SVector<T, N>,
    /// Squared resultant of the rendered forces, N².
    pub force_squared: T,
    /// Joint motion per metre of tip motion along the normal of the deepest wall, rad/m.
    pub motion: SVector<T, N>,
    /// Distance of the pose from a parallel singularity.
    pub parallel: T,
    /// State at the walls.
    pub walls: AtWalls<T>,
}

impl<T: Real, const N: usize> Step<T, N> {
    fn from_result(result: &StepResult<T>) -> Self {
        let StepResult { at, asked, motion, parallel, .. } = result;
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

/// The control step of one mechanism with N joints, its scene, and its state between steps.
///
/// The field order keeps the fields of a usual step within the 1 KB that FPU loads can address.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Controller<T: Real, M, K, const N: usize> {
    variant: StepVariant,
    velocity_terms: VelocityTerms,
    gravity: bool,
    /// True if b of the shaped torque can be nonzero.
    has_bias: bool,
    /// True if b is c - M J⁻¹ J̇ q̇ only, and no part of b is subtracted from a wall's force.
    has_usual_terms: bool,
    /// True if b also contains the rotation of normals.
    has_turning_terms: bool,
    /// True if the walls' energy is counted, for the passivity controller or for display.
    is_counting_energy: bool,
    is_passivity_on: bool,
    mechanism: M,
    coefficients: Coefficients<T>,
    encoders: Encoders<T, N>,
    walls: Walls<T>,
    observers: Observers<T, N>,
    viscous: SVector<T, N>,
    /// α of the feed-forward if α exceeds 1, because only a larger α can reach the pole of the inertia.
    gain: Option<T>,
    admissible: Admissible,
    posture: Option<Posture<T>>,
    guidance: Guidance<T>,
    /// Placed last, because other fields need to be near for the FPU's loads.
    passivity: Passivity<T, N>,
    math: PhantomData<K>,
}

/// The part of a scene that does not depend on the mechanism.
struct PreparedScene<T: Real> {
    coefficients: Coefficients<T>,
    walls: Walls<T>,
    guidance: Guidance<T>,
}

/// Checks a scene and designs its filters. Not inlined, because the mechanisms share it.
#[inline(never)]
fn prepare<T: Real, K: Math<T>>(
    device: &Device<T>,
    scene: &Scene<T>,
    task: usize,
) -> Result<PreparedScene<T>, SceneError> {
    scene.check(task)?;
    let coefficients = Coefficients::of_device::<K>((scene.estimator, scene.rate_hz, scene.cutoff_hz), device)
        .map_err(|_| SceneError::Cutoff)?;
    let (walls, mut guidance) = (Walls::new(scene)?, Guidance::new(scene));
    guidance.set_shared_feed_forward(walls.shared_feed_forward());
    Ok(PreparedScene { coefficients, walls, guidance })
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Makes the run-time form of `scene` on this mechanism, or returns an error of [`Scene::check`]. Designs filters,
    /// so do not call this function in the control step.
    #[inline(never)]
    pub fn new(mechanism: M, device: &Device<T>, scene: &Scene<T>) -> Result<Self, SceneError> {
        let PreparedScene { coefficients, walls, guidance } = prepare::<T, K>(device, scene, M::SPEC.task)?;
        if scene.posture.is_some() && M::SPEC.task == N {
            return Err(SceneError::Posture);
        }
        let has_bias = scene.velocity_terms != VelocityTerms::Off || walls.compensates_damping;
        // True if no part of b is subtracted from a wall's force.
        let rendered = scene.velocity_terms == VelocityTerms::Rendered && !walls.compensates_damping;
        let turns = walls.has_curved_wall && M::SPEC.task > 1;
        let moving = has_bias || guidance.is_active || scene.posture.is_some();
        Ok(Self {
            mechanism,
            observers: Observers::new(device, &coefficients),
            encoders: Encoders::new(device, &coefficients, moving),
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
            has_bias,
            has_usual_terms: rendered && !turns,
            has_turning_terms: rendered && turns,
            is_counting_energy: false,
            is_passivity_on: false,
            variant: StepVariant::Restart,
            math: PhantomData,
        })
    }

    /// Runs one control step for these encoder counts. Call at the control rate.
    pub fn step(&mut self, counts: &[i32; N]) -> Step<T, N> {
        self.step_with_torque(&[T::zero(); MAX_JOINTS], counts)
    }

    /// Runs [`Controller::step`] with the motor torques since the last step (N m), for an estimator that predicts.
    pub fn step_with_torque(&mut self, acted: &[T; MAX_JOINTS], counts: &[i32; N]) -> Step<T, N> {
        let mut result = StepResult::default();
        self.render(counts, acted, &mut result);
        self.angles(counts, &mut result);
        Step::from_result(&result)
    }

    /// Runs [`Controller::step`] by the general step, which is the reference of every straight step.
    pub fn step_generally(&mut self, counts: &[i32; N]) -> Step<T, N> {
        let mut result = StepResult::default();
        if self.variant == StepVariant::Restart {
            self.restart(counts, &mut result);
        }
        if self.is_counting_energy {
            self.observe_energy(counts);
        }
        self.render_generally(counts, &mut result);
        self.angles(counts, &mut result);
        Step::from_result(&result)
    }

    /// Runs [`Controller::step_with_torque`] and writes the first N entries of every vector of `result` except the
    /// joint angles, see [`Controller::angles`]. `acted` holds the motor torques since the last step after limits, N m.
    #[inline(always)]
    pub fn render(&mut self, counts: &[i32; N], acted: &[T; MAX_JOINTS], result: &mut StepResult<T>) {
        if self.is_counting_energy {
            self.observe_energy(counts);
        }
        match self.variant {
            StepVariant::Wall => self.render_wall(counts, result),
            StepVariant::Round if N == 2 => self.render_round(counts, result),
            StepVariant::Several if N == 2 => self.render_several(counts, result),
            _ => self.render_without_straight_step(counts, acted, result),
        }
    }

    /// Implements [`Controller::render`] if no straight step is ready.
    #[inline(never)]
    fn render_without_straight_step(&mut self, counts: &[i32; N], acted: &[T; MAX_JOINTS], result: &mut StepResult<T>) {
        // Only an estimator that predicts uses the torques.
        if self.coefficients.uses_joints() {
            self.observers.motor_torque = SVector::from_fn(|i, _| acted[i.min(MAX_JOINTS - 1)]);
        }
        if self.variant == StepVariant::Restart {
            self.restart(counts, result);
        }
        match self.variant {
            StepVariant::Wall => self.render_wall(counts, result),
            StepVariant::Round if N == 2 => self.render_round(counts, result),
            StepVariant::Several if N == 2 => self.render_several(counts, result),
            _ => self.render_generally(counts, result),
        }
    }

    /// Counts the energy of the period that ends with these counts.
    #[inline(never)]
    fn observe_energy(&mut self, counts: &[i32; N]) {
        if self.variant != StepVariant::Restart {
            self.passivity.observe(&self.encoders.raw_velocities(counts));
        }
    }

    /// Records the walls' joint torques (N m), which act until the next step.
    #[inline(always)]
    fn record_wall_torques(&mut self, torque: &SVector<T, N>, result: &mut StepResult<T>) {
        if self.is_counting_energy {
            result.at.walls.energy = self.passivity.energy();
            self.passivity.record_wall_torques(torque);
        }
    }

    #[inline(always)]
    fn record_no_contact(&mut self) {
        if self.is_counting_energy {
            self.passivity.record_no_contact();
        }
    }

    /// Returns the walls' energy debt, if the passivity controller is on.
    #[inline(always)]
    fn debt(&self) -> Option<Debt<T>> {
        if self.is_passivity_on { self.passivity.debt(self.coefficients.rate()) } else { None }
    }

    /// Writes the joint angles (rad) of these counts.
    #[inline(always)]
    pub fn angles(&self, counts: &[i32; N], result: &mut StepResult<T>) {
        put(&self.encoders.angles(counts).0, &mut result.at.q);
    }

    /// Starts the estimators at these counts.
    fn restart(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        clear::<T, N>(&mut result.asked.gravity);
        self.encoders.begin(counts);
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        self.walls.begin::<K, N>(&task_part::<T, M, N>(&self.mechanism.tip(&pose)));
        self.variant = StepVariant::of(self);
    }

    /// Writes joint velocities (rad/s) and the tip position.
    #[inline(always)]
    fn write_motion(qd: &SVector<T, N>, tip: &SVector<T, N>, result: &mut StepResult<T>) {
        put(qd, &mut result.at.qd);
        put(tip, &mut result.at.tip);
    }

    /// Declares that the joints are at `q` (rad) for these counts, and restarts the estimators.
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        self.encoders.home(counts, q);
        self.forget();
    }

    /// Returns the counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.encoders.zero()
    }

    /// Takes over the homing of the previous controller.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.encoders.set_zero(zero);
    }

    /// Restarts all estimators, so that earlier counts do not appear as a motion.
    pub fn forget(&mut self) {
        self.variant = StepVariant::Restart;
        self.observers.forget();
        self.walls.forget();
        self.guidance.forget();
    }

    /// Turns the passivity controller on or off. The walls' energy is counted if the controller is on or the energy is
    /// `shown`. A change clears the count.
    pub fn set_passivity(&mut self, on: bool, shown: bool) {
        let counts = on || shown;
        if (self.is_counting_energy, self.is_passivity_on) != (counts, on) {
            self.passivity.forget();
        }
        (self.is_counting_energy, self.is_passivity_on) = (counts, on);
    }

    /// Returns true if the tip touches a one-sided wall, so that arming and scene changes are refused.
    pub fn is_inside_wall(&self, counts: &[i32; N]) -> bool {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        self.walls.is_any_touched::<K, N>(&task_part::<T, M, N>(&self.mechanism.tip(&pose)))
    }

    /// Sets the host's force and plane for the next steps.
    pub fn set_push(&mut self, push: Option<&Push<T>>) {
        self.guidance.set_push(push);
        self.select_variant();
    }

    /// Returns the tip velocity (m/s) and the force of the host's push (N) for these counts and joint velocities
    /// (rad/s). Computes a pose, so do not call this function inside the control step.
    pub fn velocity_and_push(&self, counts: &[i32; N], qd: &SVector<T, N>) -> (SVector<T, N>, SVector<T, N>) {
        let (_, angles) = self.encoders.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &angles);
        let place = task_part::<T, M, N>(&self.mechanism.tip(&pose));
        let velocity = task_part::<T, M, N>(&self.mechanism.velocity(&pose, qd));
        let force = self.guidance.push().map_or(SVector::zeros(), |push| push.force_at(&place, &velocity));
        (velocity, force)
    }

    /// Applies checked gains between two steps. The states of estimators and washout continue.
    pub fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        self.walls.set_gains(gains, washout);
        self.guidance.set_shared_feed_forward(self.walls.shared_feed_forward());
        self.select_variant();
    }

    /// Applies checked coefficients of the velocity estimators between two steps. Their states continue; a new joint
    /// estimator starts from the velocities of the low-pass.
    pub fn set_coefficients(&mut self, coefficients: &Coefficients<T>) {
        if coefficients.kind() != self.coefficients.kind() {
            self.observers.forget();
        }
        self.coefficients = *coefficients;
        self.encoders.retune(coefficients);
        self.select_variant();
    }

    /// Selects the step variant, unless the estimators must restart at the next step.
    fn select_variant(&mut self) {
        if self.variant != StepVariant::Restart {
            self.variant = StepVariant::of(self);
        }
    }
}

/// Returns the tip's own coordinates, without the orientation φ.
#[inline(always)]
fn task_part<T: Real, M: Mechanism<T, N>, const N: usize>(v: &SVector<T, N>) -> SVector<T, N> {
    let mut part = *v;
    for i in M::SPEC.task..N {
        part[i] = T::zero();
    }
    part
}
