//! Integrates the device's equations of motion M(q) q̈ + c + g + B q̇ + Coulomb = τ + Jᵀ f (docs/model.md section 1).
//!
//! A step is Moreau's midpoint rule (J. J. Moreau 1988, "Unilateral contact and dry friction in finite freedom
//! dynamics"): advance the angles by half a step, solve for the end velocity, advance the angles by the other half. The
//! rule is second order, symplectic for position-dependent forces, and exact for a constant torque on a constant
//! inertia.
//!
//! - Dry friction is a set of admissible impulses instead of a sign function, so that a joint at rest does not creep or
//!   chatter. Stribeck friction is dry friction whose bound depends on the speed at the start of the step.
//! - A transmission (docs/model.md section 4) is a spring and a damper between a motor and its link. The implicit mean
//!   of the midpoint rule is stable at any stiffness and has no numerical damping.
//! - A structural mode is a body on a spring and a damper. Its end velocity is eliminated before the equations are solved.
//! - Cogging acts at the angle in the middle of the step.

use haptic_bridge::control::MIN_PARALLEL_SINE;
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::{
    Cogging, Description, DescriptionError, EncoderAt, Joint, MAX_MODES, StructuralMode, Transmission,
};
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism, Regularity};
use haptic_bridge::render::controller::{FULL_REGULARITY, PARALLEL_REGULARITY};
use haptic_bridge::with_mechanism;
use nalgebra::{SMatrix, SVector};

/// Forces on the device during one step. Only the first N entries (d entries of the tip force) are used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Motor torques, N m.
    pub torque: [f64; 3],
    /// Damping by the motors (torque constant times back-EMF constant over resistance), N m s/rad.
    pub damping: [f64; 3],
    /// Force on the tip, N.
    pub force: [f64; 3],
}

/// Position and velocity of a mechanism with its friction.
#[derive(Clone, Debug)]
pub struct Plant {
    mechanism: AnyMechanism<f64>,
    joints: usize,
    task: usize,
    viscous: [f64; 3],
    /// Joints with their dry friction; default joints if friction is disabled.
    dry_joints: [Joint; 3],
    cogging: [Option<Cogging>; 3],
    stops: [(f64, f64); 3],
    singularity_stop: SingularityStop,
    /// Distance from the nearest singularity, see [`SingularityStop::distance`].
    distance: f64,
    q: [f64; 3],
    qd: [f64; 3],
    /// Acceleration in the last step, rad/s², which centres the velocity terms of the next step.
    qdd: [f64; 3],
    transmissions: [Option<Transmission>; 3],
    /// Motor angles of joints with a transmission, rad.
    theta: [f64; 3],
    /// Motor velocities of joints with a transmission, rad/s.
    theta_d: [f64; 3],
    /// The structural modes of each joint's link, with their states.
    modes: [[Option<ModeState>; MAX_MODES]; 3],
    /// Friction impulse of the last step, N m s, the initial value of the solver.
    friction: [f64; 3],
    tip: [f64; 3],
    tip_velocity: [f64; 3],
}

/// A structural mode with its angle (rad) and velocity (rad/s).
#[derive(Clone, Copy, Debug)]
struct ModeState {
    mode: StructuralMode,
    angle: f64,
    velocity: f64,
}

impl ModeState {
    /// Eliminates the mode from a step of `h` (s) of its joint at `q` (rad) with velocity `qd` (rad/s). Returns the
    /// inertia (kg m²) and momentum (N m s) to add to the two sides of M v⁺ = …, the mode's end velocity (rad/s) for a
    /// joint that ends at rest, and the increase of the mode's end velocity per end velocity of the joint.
    fn eliminate(&self, q: f64, qd: f64, h: f64) -> (f64, f64, f64, f64) {
        let inertia = self.mode.inertia;
        let mean = 0.5 * h * self.mode.viscous() + 0.25 * h * h * self.mode.stiffness();
        let spring_impulse = h * self.mode.stiffness() * (q - self.angle);
        let share = mean / (inertia + mean);
        let alone = ((inertia - mean) * self.velocity + spring_impulse + mean * qd) / (inertia + mean);
        (inertia * share, -inertia * (alone - self.velocity), alone, share)
    }
}

/// Maximum number of sweeps of the friction solver, which starts from the previous step's result, so that two sweeps
/// suffice except in steps in which a joint starts or stops.
const MAX_SWEEPS: usize = 20;

/// A stop at the distance `nearest` from singularities, which limits the speed of the approach to the distance from the
/// stop divided by `softness` (s), and moves a linkage beyond the stop back at the same rate. The stop only absorbs
/// energy.
#[derive(Clone, Copy, Debug)]
struct SingularityStop {
    nearest: f64,
    softness: f64,
    /// True if the stop also acts before serial singularities, which a linkage can pass.
    serial: bool,
}

impl SingularityStop {
    /// The stop of every linkage before a parallel singularity, at which the inertia is unbounded. It is closer to the
    /// singularity than the pose in which a board turns its motors off. The time constant of 1 ms is long compared with a step
    /// of 5 µs.
    const HARD_STOP: Self =
        Self { nearest: 0.5 * MIN_PARALLEL_SINE as f64 / PARALLEL_REGULARITY, softness: 1e-3, serial: false };
    /// A stop that a hand may hit without a hard impact.
    const SOFT_STOP: Self = Self { nearest: FULL_REGULARITY, softness: 0.05, serial: true };

    /// Returns the distance from the nearest singularity, in the regularity of a board's feed-forward (no unit).
    fn distance(&self, regularity: &Regularity<f64>) -> f64 {
        let parallel = regularity.parallel / PARALLEL_REGULARITY;
        if self.serial { regularity.serial.min(parallel) } else { parallel }
    }
}

/// Step of the finite difference of the distance from singularities, rad: a tenth of the angle from
/// [`SingularityStop::HARD_STOP`] to the singularity.
const DIFFERENCE_STEP_RAD: f64 = 1e-7;

fn vector<const N: usize>(values: &[f64; 3]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| values[i])
}

fn array<const N: usize>(values: &SVector<f64, N>) -> [f64; 3] {
    core::array::from_fn(|i| if i < N { values[i] } else { 0.0 })
}

impl Plant {
    /// Creates a device at rest at `q` (rad). `friction` enables viscous and dry friction. `stops` are the angles (low,
    /// high) of each joint's mechanical stops, rad; infinite without stops.
    pub fn new(
        description: &Description,
        q: [f64; 3],
        friction: bool,
        stops: [(f64, f64); 3],
    ) -> Result<Self, DescriptionError> {
        let spec = description.kind.spec();
        let share = if friction { 1.0 } else { 0.0 };
        let mut plant = Self {
            mechanism: AnyMechanism::new(&description.link_side())?,
            joints: spec.joints,
            task: spec.task,
            viscous: description.joints.map(|joint| share * joint.viscous),
            dry_joints: if friction { description.joints } else { [Joint::default(); 3] },
            cogging: description.joints.map(|joint| joint.cogging),
            stops,
            singularity_stop: SingularityStop::HARD_STOP,
            distance: 0.0,
            q,
            qd: [0.0; 3],
            qdd: [0.0; 3],
            transmissions: description.joints.map(|joint| joint.transmission),
            theta: q,
            theta_d: [0.0; 3],
            modes: core::array::from_fn(|i| {
                description.joints[i].modes.map(|mode| mode.map(|mode| ModeState { mode, angle: q[i], velocity: 0.0 }))
            }),
            friction: [0.0; 3],
            tip: [0.0; 3],
            tip_velocity: [0.0; 3],
        };
        plant.add_stop(SingularityStop::HARD_STOP);
        Ok(plant)
    }

    /// Adds a soft stop before every singularity, at the smallest distance at which a board's feed-forward acts in
    /// full, or at the present distance if that is smaller.
    pub fn add_soft_stop(&mut self) {
        self.add_stop(SingularityStop::SOFT_STOP);
    }
    fn add_stop(&mut self, stop: SingularityStop) {
        self.singularity_stop = stop;
        self.refresh();
        self.singularity_stop.nearest = stop.nearest.min(self.distance);
    }

    /// Returns the number of joints N.
    pub fn joints(&self) -> usize {
        self.joints
    }
    /// Returns the task dimension d.
    pub fn task(&self) -> usize {
        self.task
    }
    /// Returns true if any joint has a compliant transmission or a structural mode.
    pub fn is_flexible(&self) -> bool {
        self.transmissions.iter().any(Option::is_some) || self.modes.iter().flatten().any(Option::is_some)
    }
    /// Returns the joint angles, rad.
    pub fn q(&self) -> [f64; 3] {
        self.q
    }
    /// Returns the joint velocities, rad/s.
    pub fn qd(&self) -> [f64; 3] {
        self.qd
    }
    /// Returns the motors' velocities, referred to the joints, rad/s.
    pub fn motor_velocity(&self) -> [f64; 3] {
        core::array::from_fn(|i| if self.transmissions[i].is_some() { self.theta_d[i] } else { self.qd[i] })
    }
    /// Returns the motors' angles, referred to the joints, rad.
    pub fn motor_angle(&self) -> [f64; 3] {
        core::array::from_fn(|i| if self.transmissions[i].is_some() { self.theta[i] } else { self.q[i] })
    }
    /// Returns the angles that the encoders measure, rad.
    pub fn measured(&self) -> [f64; 3] {
        core::array::from_fn(|i| match self.transmissions[i] {
            Some(Transmission { encoder_at: EncoderAt::Motor, .. }) => self.theta[i],
            _ => self.q[i],
        })
    }
    /// Returns the position of the tip, m (the first d entries).
    pub fn tip(&self) -> [f64; 3] {
        self.tip
    }
    /// Returns the tip velocity, m/s.
    pub fn tip_velocity(&self) -> [f64; 3] {
        self.tip_velocity
    }
    /// Moves the device to `q` (rad) with velocities `qd` (rad/s).
    pub fn place(&mut self, q: [f64; 3], qd: [f64; 3]) {
        self.q = q;
        self.qd = qd;
        self.qdd = [0.0; 3];
        (self.theta, self.theta_d) = (q, qd);
        self.friction = [0.0; 3];
        self.reset_modes();
        self.refresh();
    }

    /// Sets the structural modes to the motion of their joints.
    fn reset_modes(&mut self) {
        for (joint, modes) in self.modes.iter_mut().enumerate() {
            for mode in modes.iter_mut().flatten() {
                (mode.angle, mode.velocity) = (self.q[joint], self.qd[joint]);
            }
        }
    }

    /// Sets the tip's velocity, m/s, without motion in the null space of a redundant device.
    pub fn push(&mut self, velocity: [f64; 3]) {
        with_mechanism!(&self.mechanism, m => self.qd = array(&m.inverse(&m.pose::<Libm>(&vector(&self.q)), &vector(&velocity))));
        self.theta_d = self.qd;
        self.reset_modes();
        self.refresh();
    }

    /// Returns the kinetic energy ½ q̇ᵀ M q̇ plus the energies of transmissions, modes and cogging, J.
    pub fn energy(&self) -> f64 {
        fn kinetic_energy<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &[f64; 3], qd: &[f64; 3]) -> f64 {
            let qd: SVector<f64, N> = vector(qd);
            0.5 * qd.dot(&(m.mass(&m.pose::<Libm>(&vector(q))) * qd))
        }
        let links = with_mechanism!(&self.mechanism, m => kinetic_energy(m, &self.q, &self.qd));
        let turned = self.motor_angle();
        let mode_and_cogging_energy = |joint: usize| {
            let state = self.modes[joint].iter().flatten().map(|state| {
                let ModeState { mode, angle, velocity } = state;
                let speed_squared = velocity.powi(2) - self.qd[joint].powi(2);
                0.5 * (mode.inertia * speed_squared + mode.stiffness() * (angle - self.q[joint]).powi(2))
            });
            let magnets = self.cogging[joint].map_or(0.0, |cogging| cogging.energy(turned[joint]));
            state.sum::<f64>() + magnets
        };
        let transmission_energy = |joint: usize| {
            self.transmissions[joint].map_or(0.0, |transmission| {
                let twist = self.theta[joint] - self.q[joint];
                0.5 * (transmission.motor_inertia * self.theta_d[joint].powi(2)
                    + transmission.stiffness * twist.powi(2))
            })
        };
        links + (0..self.joints).map(|joint| transmission_energy(joint) + mode_and_cogging_energy(joint)).sum::<f64>()
    }

    /// Returns the torques that hold the device against gravity at its present pose, N m.
    pub fn gravity(&self) -> [f64; 3] {
        with_mechanism!(&self.mechanism, m => array(&m.gravity(&m.pose::<Libm>(&vector(&self.q)))))
    }
    /// Advances by `h` seconds under a constant load.
    pub fn step(&mut self, load: &Load, h: f64) {
        // Copies the mechanism, so that the match arm may change the rest of the plant.
        let mechanism = self.mechanism;
        with_mechanism!(&mechanism, m => self.advance(m, load, h));
    }

    fn refresh(&mut self) {
        let mechanism = self.mechanism;
        with_mechanism!(&mechanism, m => {
            let pose = m.pose::<Libm>(&vector(&self.q));
            self.observe(m, &pose);
        });
    }

    fn observe<M: Mechanism<f64, N>, const N: usize>(&mut self, m: &M, pose: &M::Pose) {
        self.distance = self.singularity_stop.distance(&m.regularity(pose));
        self.tip = array(&m.tip(pose));
        self.tip_velocity = array(&m.velocity(pose, &vector(&self.qd)));
        self.tip[self.task..].fill(0.0);
        self.tip_velocity[self.task..].fill(0.0);
    }

    /// Updates the values that depend on the pose after a step of `h` (s), and applies the stop before singularities.
    fn finish_step<M: Mechanism<f64, N>, const N: usize>(&mut self, m: &M, h: f64) {
        let (before, q) = (self.distance, vector(&self.q));
        let pose = m.pose::<Libm>(&q);
        self.observe(m, &pose);
        let back = (self.singularity_stop.nearest - self.distance) / self.singularity_stop.softness;
        if self.distance - before >= h * back {
            return;
        }
        // Differentiates the square, which is smooth even where the distance has a corner or an infinite slope.
        let away = SVector::<f64, N>::from_fn(|i, _| {
            let mut turned = q;
            turned[i] += DIFFERENCE_STEP_RAD;
            let there = self.singularity_stop.distance(&m.regularity(&m.pose::<Libm>(&turned)));
            (there.powi(2) - self.distance.powi(2)) / (2.0 * self.distance * DIFFERENCE_STEP_RAD)
        });
        let response = m.mass(&pose).try_inverse().unwrap_or_else(SMatrix::zeros) * away;
        let qd: SVector<f64, N> = vector(&self.qd);
        let missing_speed = back - away.dot(&qd);
        let share = missing_speed / away.dot(&response);
        if missing_speed > 0.0 && share.is_finite() {
            self.qd = array(&(qd + response * share));
            self.observe(m, &pose);
        }
    }

    fn advance<M: Mechanism<f64, N>, const N: usize>(&mut self, m: &M, load: &Load, h: f64) {
        let qd: SVector<f64, N> = vector(&self.qd);
        let middle: SVector<f64, N> = vector::<N>(&self.q) + qd * (0.5 * h);
        let pose = m.pose::<Libm>(&middle);
        let centred = qd + vector::<N>(&self.qdd) * (0.5 * h);

        let mut mass = m.mass(&pose);
        for i in 0..N {
            for state in self.modes[i].iter().flatten() {
                mass[(i, i)] -= state.mode.inertia;
            }
        }
        let (angle, speed) = (self.motor_angle(), self.motor_velocity());
        let bounds: [f64; 3] = core::array::from_fn(|i| self.dry_joints[i].dry_friction(speed[i]) * h);
        let mut load = *load;
        for i in 0..N {
            if let Some(cogging) = self.cogging[i] {
                load.torque[i] += cogging.torque(angle[i] + 0.5 * h * speed[i]);
            }
        }
        let load = &load;
        let mut force: SVector<f64, N> = vector(&load.force);
        for entry in self.task..N {
            force[entry] = 0.0;
        }
        let drive =
            vector::<N>(&load.torque) + m.transpose(&pose, &force) - m.coriolis(&pose, &centred) - m.gravity(&pose);
        if self.transmissions.iter().any(Option::is_some) {
            return self.advance_flexible(m, load, mass, drive - vector::<N>(&load.torque), &bounds, h);
        }
        // Viscous friction acts on the mean velocity: (M + hB/2) v⁺ = (M - hB/2) v + h τ - impulses.
        let mut damped = mass;
        let mut momentum = mass * qd + drive * h;
        for i in 0..N {
            let half = 0.5 * h * (self.viscous[i] + load.damping[i]);
            damped[(i, i)] += half;
            momentum[i] -= half * qd[i];
            for state in self.modes[i].iter().flatten() {
                let (inertia, extra, ..) = state.eliminate(self.q[i], qd[i], h);
                damped[(i, i)] += inertia;
                momentum[i] += extra;
            }
        }
        // The matrix is singular only if the state is not finite; the result is then meaningless anyway.
        let inverse = damped.try_inverse().unwrap_or_else(SMatrix::zeros);
        let unconstrained = inverse * momentum;
        let bounds = core::array::from_fn(|i| bounds[i]);
        let beyond_stops = core::array::from_fn(|i| self.beyond_stops(i, middle[i]));
        let mut friction = vector(&self.friction);
        let after = unconstrained
            - inverse * reaction_impulses::<N>(&inverse, &unconstrained, &bounds, &beyond_stops, &mut friction);
        self.friction = array(&friction);

        self.advance_modes(&array(&after), h);
        self.q = array(&(middle + after * (0.5 * h)));
        self.qdd = array(&((after - qd) / h));
        self.qd = array(&after);
        self.finish_step(m, h);
    }

    /// Like `advance`, for motors behind transmissions. The coordinates are the joints, then the motors of joints with
    /// a transmission. `drive` are the joint torques without the motors' torques, N m.
    fn advance_flexible<M: Mechanism<f64, N>, const N: usize>(
        &mut self,
        m: &M,
        load: &Load,
        mass: SMatrix<f64, N, N>,
        drive: SVector<f64, N>,
        dry: &[f64; 3],
        h: f64,
    ) {
        const SIZE: usize = 6;
        let mut velocity = SVector::<f64, SIZE>::zeros();
        let (mut inertia, mut damping) = (SMatrix::<f64, SIZE, SIZE>::identity(), SMatrix::<f64, SIZE, SIZE>::zeros());
        let (mut stiffness, mut force) = (damping, velocity);
        let mut bounds = [0.0; SIZE];
        let mut beyond_stops = [(false, false); SIZE];
        inertia.view_mut((0, 0), (N, N)).copy_from(&mass);
        for i in 0..N {
            velocity[i] = self.qd[i];
            force[i] = drive[i];
            beyond_stops[i] = self.beyond_stops(i, self.q[i] + 0.5 * h * self.qd[i]);
            let mut turned = i;
            if let Some(transmission) = self.transmissions[i] {
                turned = 3 + i;
                velocity[turned] = self.theta_d[i];
                inertia[(turned, turned)] = transmission.motor_inertia;
                for (a, b, sign) in [(i, i, 1.0), (turned, turned, 1.0), (i, turned, -1.0), (turned, i, -1.0)] {
                    damping[(a, b)] += sign * transmission.damping;
                    stiffness[(a, b)] += sign * transmission.stiffness;
                }
                let pull = transmission.stiffness * (self.theta[i] - self.q[i]);
                force[i] += pull;
                force[turned] -= pull;
            }
            force[turned] += load.torque[i];
            damping[(turned, turned)] += self.viscous[i] + load.damping[i];
            bounds[turned] = dry[i];
        }
        // The spring's mean force over the step is the force at its mean deflection, the present deflection + h/4 (v +
        // v⁺).
        let mean = damping * (0.5 * h) + stiffness * (0.25 * h * h);
        let (mut before, mut momentum) = (inertia + mean, (inertia - mean) * velocity + force * h);
        for i in 0..N {
            for state in self.modes[i].iter().flatten() {
                let (inertia, extra, ..) = state.eliminate(self.q[i], self.qd[i], h);
                before[(i, i)] += inertia;
                momentum[i] += extra;
            }
        }
        let inverse = before.try_inverse().unwrap_or_else(SMatrix::zeros);
        let unconstrained = inverse * momentum;
        let turned = |i: usize| if self.transmissions[i].is_some() { 3 + i } else { i };
        let mut friction = SVector::<f64, SIZE>::zeros();
        for i in 0..N {
            friction[turned(i)] = self.friction[i];
        }
        let after = unconstrained
            - inverse * reaction_impulses::<SIZE>(&inverse, &unconstrained, &bounds, &beyond_stops, &mut friction);
        self.friction = core::array::from_fn(|i| if i < N { friction[turned(i)] } else { 0.0 });
        self.advance_modes(&core::array::from_fn(|i| after[i]), h);
        for i in 0..N {
            self.q[i] += 0.5 * h * (velocity[i] + after[i]);
            self.qdd[i] = (after[i] - velocity[i]) / h;
            self.qd[i] = after[i];
            self.theta[i] += 0.5 * h * (velocity[3 + i] + after[3 + i]);
            self.theta_d[i] = after[3 + i];
        }
        self.finish_step(m, h);
    }

    /// Advances the structural modes by `h` (s). Must be called before the joints advance to the velocities `after`.
    fn advance_modes(&mut self, after: &[f64; 3], h: f64) {
        for (joint, modes) in self.modes.iter_mut().enumerate() {
            for state in modes.iter_mut().flatten() {
                let (_, _, alone, share) = state.eliminate(self.q[joint], self.qd[joint], h);
                let velocity = alone + share * after[joint];
                state.angle += 0.5 * h * (state.velocity + velocity);
                state.velocity = velocity;
            }
        }
    }

    /// Returns, for a joint at `q` (rad), true if it is at or beyond its lower stop, and the same for its upper stop.
    fn beyond_stops(&self, joint: usize, q: f64) -> (bool, bool) {
        (q <= self.stops[joint].0, q >= self.stops[joint].1)
    }
}

/// Computes the impulses of dry friction and end stops, N m s, by projected Gauss-Seidel. The friction of each
/// coordinate opposes its velocity within ± `bounds`, and a stop prevents motion further out. `friction` is the initial
/// value and the result of the solver.
fn reaction_impulses<const S: usize>(
    inverse: &SMatrix<f64, S, S>,
    unconstrained: &SVector<f64, S>,
    bounds: &[f64; S],
    beyond_stops: &[(bool, bool); S],
    friction: &mut SVector<f64, S>,
) -> SVector<f64, S> {
    if bounds.iter().all(|bound| *bound == 0.0) && beyond_stops.iter().all(|&(low, high)| !low && !high) {
        *friction = SVector::zeros();
        return SVector::zeros();
    }
    let mut stop = SVector::<f64, S>::zeros();
    for _ in 0..MAX_SWEEPS {
        let mut change: f64 = 0.0;
        for i in 0..S {
            let mut take = |impulse: &mut SVector<f64, S>, low: f64, high: f64, other: &SVector<f64, S>| {
                let velocity = unconstrained[i] - (inverse.row(i) * (*impulse + other))[0];
                let before = impulse[i];
                impulse[i] = (before + velocity / inverse[(i, i)]).clamp(low, high);
                change = change.max((impulse[i] - before).abs());
            };
            take(friction, -bounds[i], bounds[i], &stop);
            match beyond_stops[i] {
                (true, _) => take(&mut stop, f64::NEG_INFINITY, 0.0, friction),
                (_, true) => take(&mut stop, 0.0, f64::INFINITY, friction),
                _ => {}
            }
        }
        if change <= 1e-18 {
            break;
        }
    }
    *friction + stop
}
