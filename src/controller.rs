//! One control step: encoder counts in, joint torques out.
//!
//! [`Controller::step`] is the whole of it, in the order the data flows:
//! counts → angles → pose → contacts → wall forces → the feed-forward → torques. It owns no hardware, allocates nothing,
//! and cannot panic: every index is bounded by a constant, every division is by something clamped. It is generic over
//! the float and the trigonometry, so the board's f32 step and the analysis' f64 are the same code.
//!
//! "Model only what a scene needs": a scene without feed-forward computes no mass matrix, one without velocity terms no
//! Coriolis forces, one without springs no tip velocity; the choices are made once, in [`Controller::new`].

use crate::device::Device;
use crate::inertia::{Split, frame_rate, shaped_torque, shaped_torque_in_span};
use crate::math::{Math, Real};
use crate::mechanism::{Mechanism, Regularity, Shaping, shared_pose};
use crate::precomputed::MassModel;
use crate::scene::{FeedForward, MAX_SPRINGS, MAX_WALLS, Scene, SceneError, Spring, Wall, task_vector};
use crate::velocity::{Coefficients, LowPass, Velocity, Washout};
use core::marker::PhantomData;
use heapless::Vec;
use nalgebra::SVector;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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

/// A scene's gains of one wall, as they may change while the wall is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gains<T> {
    /// Which wall, from 0.
    pub wall: u8,
    /// N/m
    pub stiffness: T,
    /// N s/m
    pub damping: T,
    /// Whether its force is shaped.
    pub feed_forward: FeedForward,
    /// Corner of its washout, Hz.
    pub washout_hz: T,
}

/// One wall at run time.
#[derive(Clone, Copy, Debug)]
struct RunningWall<T: Real> {
    wall: Wall<T>,
    velocity: Velocity<T>,
    washout: Washout<T>,
    passivity: Passivity<T>,
}

impl<T: Real> RunningWall<T> {
    /// Not inlined: the same for every mechanism, and rare.
    #[inline(never)]
    fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        if self.wall.feed_forward == FeedForward::Washout {
            self.washout.retune(washout);
        } else {
            // It was not stepped, so what it remembers is no longer true.
            self.washout = *washout;
        }
        self.wall.stiffness = gains.stiffness;
        self.wall.damping = gains.damping;
        self.wall.feed_forward = gains.feed_forward;
        self.wall.washout_hz = gains.washout_hz;
    }
}

/// What of a scene is the same for every mechanism of a task dimension: designed filters, walls that run.
#[inline(never)]
fn prepare<T: Real>(
    scene: &Scene<T>,
    task: usize,
) -> Result<(Coefficients<T>, Vec<RunningWall<T>, MAX_WALLS>), SceneError> {
    scene.check(task)?;
    let rate = scene.rate_hz.to_f64();
    let coefficients =
        Coefficients::new(scene.estimator, rate, scene.cutoff_hz.to_f64()).map_err(|_| SceneError::Cutoff)?;
    let mut walls = Vec::new();
    for (index, wall) in scene.walls.iter().enumerate() {
        let washout = match wall.feed_forward {
            FeedForward::Washout => {
                Washout::new(wall.washout_hz.to_f64(), rate).map_err(|_| SceneError::Washout(index as u8))?
            }
            _ => Washout::default(),
        };
        // The two vectors have the same capacity.
        let _ = walls.push(RunningWall {
            wall: *wall,
            velocity: Velocity::default(),
            washout,
            passivity: Passivity::default(),
        });
    }
    Ok((coefficients, walls))
}

/// Counts that make up an angle (rad) at so many radians per count; none when there is no scale.
#[inline(never)]
fn counts_of<T: Real>(angle: T, radians_per_count: T) -> i32 {
    let scale = radians_per_count.to_f64();
    if scale == 0.0 { 0 } else { libm::round(angle.to_f64() / scale) as i32 }
}

/// A wall's passivity observer and controller (Hannaford and Ryu 2002, in the form that is exact for a force held
/// between two samples): energy taken up = -Σ f(k-1) (x(k) - x(k-1)); when it falls below zero, damping is added that
/// takes up the missing part in one step.
#[derive(Clone, Copy, Debug, Default)]
struct Passivity<T> {
    /// J
    energy: T,
    /// Force held since the last step, N.
    held: T,
}

/// Most damping the passivity controller adds, as a share of the damping at which a mass of 1 kg would stop in a step:
/// beyond it the controller itself would be the instability.
const PASSIVITY_SHARE: f64 = 0.01;

impl<T: Real> Passivity<T> {
    /// Counts the energy of the last period, in which the tip moved by `moved` (m), and returns the damping (N s/m)
    /// that pays back what the wall has given out. `v` in m/s, `rate` in Hz.
    #[inline(always)]
    fn damping(&mut self, moved: T, v: T, rate: T) -> T {
        self.energy -= self.held * moved;
        if self.energy >= T::zero() || v == T::zero() {
            return T::zero();
        }
        let most = rate * T::from_f64(PASSIVITY_SHARE);
        (-self.energy * rate / (v * v).greater(T::from_f64(1.0e-12))).lesser(most)
    }

    fn hold(&mut self, force: T) {
        self.held = force;
    }

    /// The tip has left the wall: counts the last period's energy and keeps what the wall still owes for its next touch.
    #[inline(always)]
    fn leave(&mut self, moved: T) {
        self.energy = (self.energy - self.held * moved).lesser(T::zero());
        self.held = T::zero();
    }
}

/// A contact whose force goes through the feed-forward in this step.
#[derive(Clone, Copy, Debug)]
struct Active<T: Real, const N: usize> {
    wall: usize,
    normal: SVector<T, N>,
    /// What of its force is shaped, N.
    shaped: T,
}

/// What one step found and decided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T: Real, const N: usize> {
    /// Joint angles, rad.
    pub q: SVector<T, N>,
    /// Filtered joint velocities, rad/s.
    pub qd: SVector<T, N>,
    /// Task position: the tip, m (and φ, rad).
    pub tip: SVector<T, N>,
    /// Joint torques, N m.
    pub torque: SVector<T, N>,
    /// Distance to the deepest wall, m; negative inside it. Zero without walls.
    pub distance: T,
    /// Velocity along the normal of the deepest wall, m/s.
    pub normal_velocity: T,
    /// Sum of the walls' forces, N.
    pub wall_force: T,
    /// Number of walls touched.
    pub contacts: u8,
    /// Energy the touched walls have taken up since contact began, less what they owed then, J; negative when they gave
    /// some out.
    pub energy: T,
    /// Damping that the passivity controller added, N s/m.
    pub passivity_damping: T,
    /// Share of the feed-forward that acts: 1 away from singularities, fading to 0 near them.
    pub shaping: T,
    /// How far from a singularity the pose is.
    pub regularity: Regularity<T>,
}

/// A mechanism in a scene.
#[derive(Clone, Copy, Debug)]
pub struct Encoding<T> {
    radians_per_count: T,
    /// Angular velocity of one count per control period, rad/s.
    speed_per_count: T,
    counts_per_turn: i32,
    /// Counts from zero up to which no whole turn has to be taken off.
    counts_unturned: u32,
    offset: T,
}

/// The control step of one mechanism with N joints, its scene, and its memory between steps.
#[derive(Clone, Debug)]
pub struct Controller<T: Real, M, K, const N: usize> {
    mechanism: M,
    mass: MassModel<T, N>,
    joints: [Encoding<T>; N],
    viscous: SVector<T, N>,
    zero: [i32; N],
    last_counts: [i32; N],
    primed: bool,
    joint_filters: [LowPass<T>; N],
    coefficients: Coefficients<T>,
    /// Gain of the joints' filters where only guard and telemetry look at them.
    watch: T,
    walls: Vec<RunningWall<T>, MAX_WALLS>,
    springs: Vec<Spring<T>, MAX_SPRINGS>,
    field_damping: T,
    gravity: bool,
    velocity_terms: bool,
    /// b of the shaped torque is not zero.
    biased: bool,
    /// Whether something is rendered or compensated with joint velocities.
    moving: bool,
    /// Some wall is curved.
    curved: bool,
    /// Some wall compensates joint damping.
    damped: bool,
    /// There are springs or a field.
    guided: bool,
    passivity: bool,
    math: PhantomData<K>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// The run-time form of `scene` on this mechanism. Designs the filters, so not for use inside the step.
    ///
    /// Errors: whatever [`Scene::check`] finds.
    #[inline(never)]
    pub fn new(mechanism: M, device: &Device<T>, scene: &Scene<T>, mass: MassModel<T, N>) -> Result<Self, SceneError> {
        let (coefficients, walls) = prepare(scene, M::SPEC.task)?;
        Ok(Self {
            mechanism,
            mass,
            joints: core::array::from_fn(|i| {
                let joint = &device.joints[i];
                let counts_per_turn = if M::SPEC.periodic { joint.counts_per_turn } else { 0 };
                Encoding {
                    radians_per_count: joint.radians_per_count,
                    speed_per_count: joint.radians_per_count * scene.rate_hz,
                    counts_per_turn,
                    counts_unturned: if counts_per_turn > 0 { counts_per_turn.unsigned_abs() } else { u32::MAX },
                    offset: joint.offset,
                }
            }),
            viscous: SVector::from_fn(|i, _| device.joints[i].viscous),
            zero: [0; N],
            last_counts: [0; N],
            primed: false,
            joint_filters: [LowPass::default(); N],
            coefficients,
            watch: coefficients.first_order_gain(),
            walls,
            springs: scene.springs.clone(),
            field_damping: scene.field_damping,
            gravity: scene.gravity_compensation && device.weight,
            velocity_terms: scene.velocity_terms,
            biased: scene.velocity_terms || scene.walls.iter().any(|wall| wall.damping_compensation),
            moving: scene.velocity_terms
                || scene.walls.iter().any(|wall| wall.damping_compensation)
                || !scene.springs.is_empty()
                || scene.field_damping > T::zero(),
            curved: scene.walls.iter().any(|wall| wall.surface.curved()),
            damped: scene.walls.iter().any(|wall| wall.damping_compensation),
            guided: !scene.springs.is_empty() || scene.field_damping > T::zero(),
            passivity: false,
            math: PhantomData,
        })
    }

    /// Joint torques for these encoder counts. Call at the control rate.
    #[inline(always)]
    pub fn step(&mut self, counts: &[i32; N]) -> Step<T, N> {
        self.step_with(counts, &[])
    }

    /// As [`Controller::step`], with the values of the table that a [`MassModel::Table`] looks into.
    #[inline(always)]
    pub fn step_with(&mut self, counts: &[i32; N], table: &[T]) -> Step<T, N> {
        let (q, turned) = self.angles(counts);
        let qd = self.joint_velocities(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &turned);
        let tip = self.mechanism.tip(&pose);
        let place = task_part::<T, M, N>(&tip);
        let regularity = self.mechanism.regularity(&pose);

        // Contacts and wall forces; every estimator runs at every step, so contact never starts it from zero.
        let mut step = Step {
            q,
            qd,
            tip,
            torque: SVector::zeros(),
            distance: T::zero(),
            normal_velocity: T::zero(),
            wall_force: T::zero(),
            contacts: 0,
            energy: T::zero(),
            passivity_damping: T::zero(),
            shaping: T::one(),
            regularity,
        };
        // What goes straight through Jᵀ, what is shaped, and the walls that shape it: the first by itself, because one
        // wall is the usual case and need not go through memory.
        let mut plain = SVector::<T, N>::zeros();
        let mut straight = false;
        let mut first = None;
        let mut more: Vec<Active<T, N>, MAX_WALLS> = Vec::new();
        for (index, running) in self.walls.iter_mut().enumerate() {
            let wall = &running.wall;
            let contact = wall.surface.contact::<K, N>(&place);
            let moved = running.velocity.moved(contact.distance);
            let v = running.velocity.step(&self.coefficients, contact.distance);
            if index == 0 || contact.distance < step.distance {
                step.distance = contact.distance;
                step.normal_velocity = v;
            }
            let inside = contact.distance < T::zero();
            if !inside && !wall.bilateral {
                if self.passivity {
                    running.passivity.leave(moved);
                }
                if wall.feed_forward == FeedForward::Washout {
                    running.washout.step(T::zero());
                }
                continue;
            }
            let mut force = -wall.stiffness * contact.distance - wall.damping * v;
            let mut extra = T::zero();
            if self.passivity {
                extra = running.passivity.damping(moved, v, self.coefficients.rate());
                force -= extra * v;
            }
            // Written so that what is not a number stays one, and is found out.
            if !wall.bilateral && force < T::zero() {
                force = T::zero();
            }
            step.contacts += 1;
            step.wall_force += force;
            if self.passivity {
                step.passivity_damping += extra;
                running.passivity.hold(force);
                step.energy += running.passivity.energy;
            }
            let shaped = match wall.feed_forward {
                FeedForward::Off => T::zero(),
                FeedForward::Full => force,
                FeedForward::Washout => running.washout.step(force),
            };
            if wall.feed_forward != FeedForward::Full {
                plain += contact.normal * (force - shaped);
                straight = true;
            }
            if wall.feed_forward != FeedForward::Off {
                let active = Active { wall: index, normal: contact.normal, shaped };
                match first {
                    None => first = Some(active),
                    Some(_) => {
                        let _ = more.push(active);
                    }
                }
            }
        }
        if self.guided {
            plain += self.guidance(&place, &task_part::<T, M, N>(&self.mechanism.velocity(&pose, &qd)));
            straight = true;
        }

        // (4): what is shaped goes through M E Wrr⁻¹, the rest straight through Jᵀ.
        if let Some(first) = first {
            let parallel = regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY);
            let share = fade(regularity.serial.lesser(parallel));
            if share < T::one() || !more.is_empty() {
                // Copies, so that the usual case need not keep these in memory.
                let (pose, place, qd, turned, first) = (pose, place, qd, turned, first);
                let resultant = more.iter().fold(first.normal * first.shaped, |sum, a| sum + a.normal * a.shaped);
                if share > T::zero() {
                    step.torque =
                        self.shaped_by_several(table, &turned, &pose, &place, &qd, &first, &more, &resultant) * share;
                }
                step.shaping = share;
                plain += resultant * (T::one() - share);
                straight = true;
            } else {
                step.torque = self.shaped_by_one(table, &turned, &pose, &place, &qd, &first);
            }
        }
        if straight {
            step.torque += self.mechanism.transpose(&pose, &plain);
        }
        if self.gravity {
            step.torque += self.mechanism.gravity(&pose);
        }
        step
    }

    /// The feed-forward torques of a single active wall, without gravity.
    #[inline(always)]
    fn shaped_by_one(
        &self,
        table: &[T],
        q: &SVector<T, N>,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        only: &Active<T, N>,
    ) -> SVector<T, N> {
        let shaping = self.mass.shaping(&self.mechanism, table, q, pose, &only.normal);
        if !self.biased {
            return shaping.me * (only.shaped / shaping.w_rr);
        }
        let b = self.bias(pose, place, qd, core::slice::from_ref(only), &only.normal);
        shaped_torque(&shaping, only.shaped, &b)
    }

    /// The feed-forward torques of one or several active walls, without gravity. Out of line: the usual single wall
    /// away from singularities does not come here.
    #[allow(clippy::too_many_arguments)]
    #[inline(never)]
    fn shaped_by_several(
        &self,
        table: &[T],
        q: &SVector<T, N>,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        first: &Active<T, N>,
        more: &[Active<T, N>],
        resultant: &SVector<T, N>,
    ) -> SVector<T, N> {
        let mut active: Vec<Active<T, N>, MAX_WALLS> = Vec::new();
        let mut normals: Vec<SVector<T, N>, MAX_WALLS> = Vec::new();
        for a in core::iter::once(first).chain(more) {
            let _ = active.push(*a);
            let _ = normals.push(a.normal);
        }
        if more.is_empty() {
            let shaping = self.mass.shaping(&self.mechanism, table, q, pose, &first.normal);
            return shaped_torque(&shaping, first.shaped, &self.bias(pose, place, qd, &active, &first.normal));
        }
        let split = Split::new::<K>(&normals, M::SPEC.task);
        if split.rendered == N {
            // Everything is rendered: nothing is admissible, and (4) adds nothing.
            return self.mechanism.transpose(pose, resultant);
        }
        let shapings: [Shaping<T, N>; N] =
            core::array::from_fn(|i| self.mass.shaping(&self.mechanism, table, q, pose, &split.direction(i)));
        // One rendered direction, or two in space with one admissible across them.
        let turning = if split.rendered == 1 { 0 } else { N - 1 };
        let b = self.bias(pose, place, qd, &active, &split.direction(turning));
        shaped_torque_in_span(&split, &shapings, resultant, &b)
    }

    /// b without gravity: c - M J⁻¹(J̇ q̇ + κ), and B q̇ where a wall asks for it. Zero when the scene has no velocity
    /// terms. `line` is the direction that turns with curved walls (see [`frame_rate`]).
    #[inline(never)]
    fn bias(
        &self,
        pose: &M::Pose,
        place: &SVector<T, N>,
        qd: &SVector<T, N>,
        active: &[Active<T, N>],
        line: &SVector<T, N>,
    ) -> SVector<T, N> {
        let mut b = SVector::zeros();
        if self.velocity_terms {
            let mut acceleration = SVector::zeros();
            if M::SPEC.task > 1 && self.curved {
                let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
                acceleration = -frame_rate(line, &self.line_rate(place, &velocity, active, line), &velocity);
            }
            b = self.mechanism.inverse_dynamics(pose, qd, &acceleration);
        }
        let damped = |a: &Active<T, N>| self.walls.get(a.wall).is_some_and(|w| w.wall.damping_compensation);
        if self.damped && active.iter().any(damped) {
            b += self.viscous.component_mul(qd);
        }
        b
    }

    /// The rate of the turning direction: ṅ itself for one wall; for the admissible line t across several, the rate
    /// that keeps it across all of them, ṫ = -Σ (t·ṅᵢ) nᵢ', with n' the reciprocal basis of the first two normals.
    #[inline(always)]
    fn line_rate(
        &self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
        active: &[Active<T, N>],
        line: &SVector<T, N>,
    ) -> SVector<T, N> {
        let rate = |a: &Active<T, N>| match self.walls.get(a.wall) {
            Some(running) => running.wall.surface.normal_rate::<K, N>(place, velocity),
            None => SVector::zeros(),
        };
        match active {
            [only] => rate(only),
            [first, rest @ ..] => {
                // The wall least parallel to the first spans the plane with it.
                let aligned = |a: &Active<T, N>| a.normal.dot(&first.normal).abs();
                let Some(second) = rest.iter().reduce(|x, y| if aligned(y) < aligned(x) { y } else { x }) else {
                    return SVector::zeros();
                };
                if line.dot(&first.normal).abs() > T::from_f64(0.5) {
                    return rate(first);
                }
                let cosine = first.normal.dot(&second.normal);
                let sine_squared = (T::one() - cosine * cosine).greater(T::EPSILON);
                let (r1, r2) = (line.dot(&rate(first)), line.dot(&rate(second)));
                -(first.normal * (r1 - cosine * r2) + second.normal * (r2 - cosine * r1)) / sine_squared
            }
            [] => SVector::zeros(),
        }
    }

    /// The force of springs and fields at the tip.
    #[inline(always)]
    fn guidance(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        let mut force = velocity * -self.field_damping;
        for spring in &self.springs {
            force += spring_force(spring, place, velocity);
        }
        force
    }

    /// Joint angles (rad), and the same wrapped to within a turn for the mechanism's sines.
    #[inline(always)]
    fn angles(&self, counts: &[i32; N]) -> (SVector<T, N>, SVector<T, N>) {
        let mut q = SVector::zeros();
        let mut turned = SVector::zeros();
        for i in 0..N {
            let joint = &self.joints[i];
            let relative = counts[i].wrapping_sub(self.zero[i]);
            q[i] = T::from_i32(relative) * joint.radians_per_count + joint.offset;
            turned[i] = q[i];
            if relative.unsigned_abs() > joint.counts_unturned {
                let within = relative.checked_rem(joint.counts_per_turn).unwrap_or(relative);
                turned[i] = T::from_i32(within) * joint.radians_per_count + joint.offset;
            }
        }
        (q, turned)
    }

    /// Filtered joint velocities from integer count differences, which wrap. Where nothing is rendered with them, only
    /// guard and telemetry watch, and a first-order filter at the same cutoff is enough.
    #[inline(always)]
    fn joint_velocities(&mut self, counts: &[i32; N]) -> SVector<T, N> {
        if !self.primed {
            self.last_counts = *counts;
            self.primed = true;
        }
        let mut qd = SVector::zeros();
        for i in 0..N {
            let moved = counts[i].wrapping_sub(self.last_counts[i]);
            let raw = T::from_i32(moved) * self.joints[i].speed_per_count;
            qd[i] = if self.moving {
                self.joint_filters[i].step(&self.coefficients, raw)
            } else {
                self.joint_filters[i].step_first_order(self.watch, raw)
            };
        }
        self.last_counts = *counts;
        qd
    }

    /// Declares the joints to be at `q` (rad) for these counts. Estimators start anew.
    pub fn home(&mut self, counts: &[i32; N], q: &[T; N]) {
        for i in 0..N {
            let joint = &self.joints[i];
            self.zero[i] = counts[i].wrapping_sub(counts_of(q[i] - joint.offset, joint.radians_per_count));
        }
        self.forget();
    }

    /// Counts that homing has subtracted.
    pub fn zero(&self) -> [i32; N] {
        self.zero
    }

    /// Takes over homing from the controller this one replaces.
    pub fn set_zero(&mut self, zero: [i32; N]) {
        self.zero = zero;
    }

    /// Starts all estimators anew, so that what happened before is not a motion.
    pub fn forget(&mut self) {
        self.primed = false;
        self.joint_filters = [LowPass::default(); N];
        for running in &mut self.walls {
            running.velocity.forget();
            let mut fresh = Washout::default();
            fresh.retune(&running.washout);
            running.washout = fresh;
        }
    }

    /// Turns the passivity controller on or off.
    pub fn set_passivity(&mut self, on: bool) {
        if self.passivity != on {
            self.walls.iter_mut().for_each(|running| running.passivity = Passivity::default());
        }
        self.passivity = on;
    }

    /// Whether a one-sided wall of this scene is touched at these counts: arming and scene changes are refused then.
    pub fn inside_a_wall(&self, counts: &[i32; N]) -> bool {
        let (_, turned) = self.angles(counts);
        let pose = shared_pose::<T, K, M, N>(&self.mechanism, &turned);
        let place = task_part::<T, M, N>(&self.mechanism.tip(&pose));
        self.walls.iter().any(|running| {
            let wall = &running.wall;
            !wall.bilateral && wall.surface.contact::<K, N>(&place).distance < T::zero()
        })
    }

    /// Applies checked gains between two steps; estimators and the washout's state go on.
    pub fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        if let Some(running) = self.walls.get_mut(usize::from(gains.wall)) {
            running.set_gains(gains, washout);
        }
    }

    /// Applies checked coefficients of the velocity estimators between two steps; their states go on.
    pub fn set_coefficients(&mut self, coefficients: &Coefficients<T>) {
        self.coefficients = *coefficients;
        self.watch = coefficients.first_order_gain();
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

/// The share of the feed-forward at a regularity: a smooth step from [`NO_REGULARITY`] to [`FULL_REGULARITY`].
#[inline(always)]
fn fade<T: Real>(regularity: T) -> T {
    let (low, high) = (T::from_f64(NO_REGULARITY), T::from_f64(FULL_REGULARITY));
    if regularity >= high {
        return T::one();
    }
    let s = ((regularity - low) * T::from_f64(1.0 / (FULL_REGULARITY - NO_REGULARITY))).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}

/// The force (N) of one spring at the tip. Not inlined: few scenes have springs, and mechanisms share it.
#[inline(never)]
fn spring_force<T: Real, const N: usize>(
    spring: &Spring<T>,
    place: &SVector<T, N>,
    velocity: &SVector<T, N>,
) -> SVector<T, N> {
    let direction = task_vector::<T, N>(&spring.direction);
    let across = |v: SVector<T, N>| v - direction * direction.dot(&v);
    let stretch = across(place - task_vector::<T, N>(&spring.point));
    -(stretch * spring.stiffness + across(*velocity) * spring.damping)
}
