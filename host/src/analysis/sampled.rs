//! The sampled loop around a wall: zero-order hold, computation delay, velocity estimator and feed-forward, in delta
//! form.
//!
//! The loop is cut at the wall force of one sample: s⁺ = s + F s + b f, with the rendered position x and the estimated
//! velocity v as outputs. A wall closes it with f = -kp x - kd v, so both gains are rank-one changes of F.
//!
//! Every state is chosen so that its change over a sample is computed directly and not as a difference of near-equal
//! numbers: the change of position is a state of its own, and filters are trapezoidal integrators.

use haptic_bridge::render::scene::FeedForward;
use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::eigenvalues::eigenvalues;
pub use super::estimator::{LONGEST_DIFFERENCE, LinearEstimator, LowPass};
use super::plant::{ContinuousPlant, Drive, Linearised, reduce};
use super::spectrum::{exp_minus_identity, growth};

/// Longest delay that can be analysed, in samples.
pub const LONGEST_DELAY: f64 = 64.0;

/// Which torque the wall force becomes: a wall's feed-forward with the numbers that it needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// τ = Jrᵀ fr.
    Off,
    /// Equation (4).
    Full,
    /// Equation (4) with the force behind fa high-passed at this frequency, Hz.
    Washout(f64),
}

impl Mode {
    /// What a wall with this feed-forward and this corner of its washout (Hz) does.
    #[must_use]
    pub fn of(feed_forward: FeedForward, washout_hz: f64) -> Self {
        match feed_forward {
            FeedForward::Off => Self::Off,
            FeedForward::Full => Self::Full,
            FeedForward::Washout => Self::Washout(washout_hz),
        }
    }
}

/// Everything about the loop that is not the device.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// Control steps per second, Hz.
    pub rate_hz: f64,
    /// Samples between reading the position and the torque that answers it; fractions allowed.
    pub delay_samples: f64,
    /// Velocity estimator of every wall.
    pub estimator: LinearEstimator,
    /// Motor drives.
    pub drive: Drive,
    /// Whether the feed-forward also compensates the joints' own damping (B q̇ in b).
    pub damping_compensation: bool,
}

/// Why a loop cannot be analysed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AnalysisError {
    /// Rate outside what makes sense.
    #[error("the rate must be a positive number of hertz, not {0}")]
    Rate(f64),
    /// Low-pass or washout at or above the Nyquist frequency, or not positive.
    #[error("a cutoff of {cutoff} Hz cannot be had at {rate} Hz: it must lie above 0 and below half the rate")]
    Cutoff {
        /// Hz.
        cutoff: f64,
        /// Hz.
        rate: f64,
    },
    /// Negative, not finite, or longer than [`LONGEST_DELAY`].
    #[error("the delay must lie between 0 and 64 samples, not {0}")]
    Delay(f64),
    /// Requests of a program that renders the wall.
    #[error("a host asks {rate} times a second, and it must be 1 to {board}, the board's own rate")]
    HostRate {
        /// Hz.
        rate: f64,
        /// Hz.
        board: f64,
    },
    /// Samples of the difference.
    #[error("a difference can be taken over 1 to 64 samples, not {0}")]
    Difference(usize),
    /// Bandwidth of the current loop.
    #[error("the current loop's bandwidth must be a positive number of hertz, not {0}")]
    Bandwidth(f64),
    /// Motor data missing or without resistance.
    #[error("a voltage drive needs the resistance of every joint's motor ([joint.motor] in the device file)")]
    Motor,
    /// Jr, M or B not what a device has.
    #[error("the device has no inertia in this direction here: its mass matrix or Jacobian is singular or not finite")]
    Singular,
    /// A damping value of the boundary.
    #[error("damping values must be finite and not negative, not {0}")]
    Damping(f64),
    /// What the loop compensates is the rigid device's damping.
    #[error("damping compensation is analysed for rigid joints that nobody holds")]
    CompensatedFlexible,
    /// No upper limit of stiffness was found.
    #[error("no stiffness was found at which this loop becomes unstable")]
    Unbounded,
}

impl From<AnalysisError> for crate::error::Failure {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Singular | AnalysisError::Unbounded => Self::impossible(error),
            _ => Self::wrong(error),
        }
    }
}

/// The loop cut at the wall force, in sample units (see [`super::plant`]).
#[derive(Clone, Debug)]
pub(crate) struct OpenLoop {
    /// A - I.
    pub f: DMatrix<f64>,
    /// Effect of the wall force.
    pub input: DVector<f64>,
    /// Rendered position, as a row over the states.
    pub position: DVector<f64>,
    /// Estimated rendered velocity per sample, as a row over the states.
    pub velocity: DVector<f64>,
    /// Reference mass, kg: stiffness unit is `mass/T²`, damping unit `mass/T`.
    pub mass: f64,
    /// Sample period, s.
    pub sample_s: f64,
    /// Motions that no feedback sees by construction (damping compensation alone has any).
    pub(super) drift: Option<Drift>,
    pub(super) resonances: Vec<(f64, f64)>,
}

/// States at which the loop rests whatever the gains: one column per motion for the states, and the force it needs.
#[derive(Clone, Debug)]
pub(super) struct Drift {
    /// States per unit of motion, without the rendered position.
    states: DMatrix<f64>,
    /// Wall force per unit of motion, in force units: the rendered position settles at -force/kp.
    force: DVector<f64>,
    /// The state that is one for each motion and zero for the others.
    pivot: Vec<usize>,
    /// Index of the rendered position.
    position: usize,
}

/// A signal as a linear form over the states and the wall force.
#[derive(Clone)]
struct Signal {
    state: DVector<f64>,
    force: f64,
}

impl Signal {
    fn of_state(size: usize, index: usize) -> Self {
        let mut state = DVector::zeros(size);
        state[index] = 1.0;
        Self { state, force: 0.0 }
    }

    fn plus(&self, factor: f64, other: &Signal) -> Self {
        Self { state: &self.state + &other.state * factor, force: self.force + factor * other.force }
    }

    fn times(&self, factor: f64) -> Self {
        Self { state: &self.state * factor, force: self.force * factor }
    }
}

/// Collects the change per sample of every state.
struct Assembly {
    f: DMatrix<f64>,
    input: DVector<f64>,
}

impl Assembly {
    fn new(size: usize) -> Self {
        Self { f: DMatrix::zeros(size, size), input: DVector::zeros(size) }
    }

    fn size(&self) -> usize {
        self.input.len()
    }

    fn change(&mut self, state: usize, by: &Signal) {
        for (column, value) in by.state.iter().enumerate() {
            self.f[(state, column)] += value;
        }
        self.input[state] += by.force;
    }

    /// An estimator's states from `first` on, driven by the change of position `moved` and by `pushed`, the velocity per
    /// sample that the last command gave; returns the velocity per sample.
    fn estimate(&mut self, estimator: &DMatrix<f64>, first: usize, moved: &Signal, pushed: &Signal) -> Signal {
        let size = self.size();
        let states = estimator.nrows() - 1;
        let row = |row: usize| {
            let own = (0..states).fold(moved.times(estimator[(row, states)]), |sum, state| {
                sum.plus(estimator[(row, state)], &Signal::of_state(size, first + state))
            });
            own.plus(estimator[(row, states + 1)], pushed)
        };
        for state in 0..states {
            self.change(first + state, &row(state));
        }
        row(states)
    }
}

/// Trapezoidal one-pole low-pass: its output, and the change of its state.
fn one_pole(hz: f64, rate_hz: f64, signal: &Signal, state: &Signal) -> (Signal, Signal) {
    let g = (std::f64::consts::PI * hz / rate_hz).tan();
    let step = signal.plus(-1.0, state).times(g / (1.0 + g));
    (state.plus(1.0, &step), step.times(2.0))
}

impl Loop {
    /// Refuses what cannot be sampled.
    pub fn check(&self) -> Result<(), AnalysisError> {
        if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) {
            return Err(AnalysisError::Rate(self.rate_hz));
        }
        if !(0.0..=LONGEST_DELAY).contains(&self.delay_samples) {
            return Err(AnalysisError::Delay(self.delay_samples));
        }
        self.estimator.check(self.rate_hz)?;
        match &self.drive {
            Drive::Current { bandwidth_hz } if !(bandwidth_hz.is_finite() && *bandwidth_hz > 0.0) => {
                Err(AnalysisError::Bandwidth(*bandwidth_hz))
            }
            Drive::Voltage(motors) if motors.iter().any(|m| !(m.resistance > 0.0 && m.inductance >= 0.0)) => {
                Err(AnalysisError::Motor)
            }
            _ => Ok(()),
        }
    }

    pub(super) fn check_cutoff(&self, cutoff: f64) -> Result<(), AnalysisError> {
        if cutoff > 0.0 && cutoff < self.rate_hz / 2.0 {
            Ok(())
        } else {
            Err(AnalysisError::Cutoff { cutoff, rate: self.rate_hz })
        }
    }
}

impl OpenLoop {
    /// Puts the loop around the device.
    pub fn new(device: &Linearised, around: &Loop, mode: Mode) -> Result<Self, AnalysisError> {
        Self::believing(device, device, around, mode)
    }

    /// As [`OpenLoop::new`], with a controller that takes the device for `believed`: its feed-forward, its damping
    /// compensation and what it predicts are that one's.
    pub fn believing(
        device: &Linearised,
        believed: &Linearised,
        around: &Loop,
        mode: Mode,
    ) -> Result<Self, AnalysisError> {
        around.check()?;
        if let Mode::Washout(hz) = mode {
            around.check_cutoff(hz)?;
        }
        let joints = device.row.len();
        if let Drive::Voltage(motors) = &around.drive
            && motors.len() != joints
        {
            return Err(AnalysisError::Motor);
        }
        let w_eff = device.w_eff().ok_or(AnalysisError::Singular)?;
        let mass = match mode {
            Mode::Off => w_eff,
            _ => device.inertia_met().ok_or(AnalysisError::Singular)?,
        };
        if !(mass.is_finite() && mass > 0.0) {
            return Err(AnalysisError::Singular);
        }
        let sample_s = 1.0 / around.rate_hz;
        let compensated = around.damping_compensation && mode != Mode::Off;
        if compensated && !device.flexible.is_rigid() {
            return Err(AnalysisError::CompensatedFlexible);
        }

        // Torque directions, in metres: what one force unit of each input becomes.
        let shaped = believed.shaped_torque();
        let mut directions = match mode {
            Mode::Off => vec![device.row.clone()],
            Mode::Full => vec![shaped.clone()],
            Mode::Washout(_) => vec![device.row.clone(), &shaped - &device.row],
        };
        let walls = directions.len();
        let projected = &believed.mass * &believed.unit_motion / believed.w_rr();
        if compensated {
            // τ += (I - M E Wrr⁻¹ Eᵀ) B q̇, one input per damped joint, its velocity per sample.
            for joint in (0..joints).filter(|&j| damps(device, j, sample_s)) {
                let mut column = &projected * -believed.unit_motion[joint];
                column[joint] += 1.0;
                directions.push(column * (believed.viscous[joint] * sample_s / mass));
            }
        }
        let inputs = DMatrix::from_columns(&directions);
        let plant =
            reduce(device, &around.drive, &inputs, sample_s, mass, compensated).ok_or(AnalysisError::Singular)?;
        // Acceleration per sample² that one unit of each input gives: along the normal, then of each joint.
        let inverse = believed.mass.clone().cholesky().ok_or(AnalysisError::Singular)?.inverse();
        let given = inverse * &inputs * mass;
        let pushes = DMatrix::from_fn(joints + 1, inputs.ncols(), |i, input| match i {
            0 => believed.row.dot(&given.column(input)),
            joint => given[(joint - 1, input)],
        });
        Ok(assemble(device, around, mode, &plant, walls, mass, &pushes))
    }

    /// F of the closed loop for gains in sample units.
    pub fn closed(&self, kp: f64, kd: f64) -> DMatrix<f64> {
        let feedback = &self.position * kp + &self.velocity * kd;
        let f = &self.f - &self.input * feedback.transpose();
        match &self.drift {
            Some(drift) => drift.removed(f, kp),
            None => f,
        }
    }

    /// The modes of a flexible device without the wall, |z| and its angle (rad) where that is not 0: around them the
    /// loop's responses turn quickly.
    pub fn resonances(&self) -> &[(f64, f64)] {
        &self.resonances
    }

    /// Whether all modes decay; gains in sample units.
    pub fn is_stable(&self, kp: f64, kd: f64) -> bool {
        growth(self.closed(kp, kd)) < STILL
    }
}

/// |z|² - 1 below this is rounding: a mode this slow needs 10¹² samples to show.
const STILL: f64 = 1e-12;

/// Whether a joint's own damping acts within the time [`reduce`] looks at.
fn damps(device: &Linearised, joint: usize, sample_s: f64) -> bool {
    let inverse = device.mass.clone().cholesky().map(|c| c.inverse()[(joint, joint)]);
    inverse.is_some_and(|mobility| device.viscous[joint] * sample_s * mobility >= 1e-10)
}

fn assemble(
    device: &Linearised,
    around: &Loop,
    mode: Mode,
    plant: &ContinuousPlant,
    walls: usize,
    mass: f64,
    pushes: &DMatrix<f64>,
) -> OpenLoop {
    let inputs = plant.b.ncols();
    let whole = around.delay_samples.floor();
    let fraction = around.delay_samples - whole;
    let (whole, fraction) = (whole as usize, if fraction < 1e-12 { 0.0 } else { fraction });
    let per_estimate = around.estimator.states();

    // State layout.
    let plant_states = plant.states();
    let moved = plant_states; // change of x over the last sample
    let filter = moved + 1;
    let joint_moved = filter + per_estimate;
    let joint_filter = joint_moved + plant.sensed.len();
    let washout = joint_filter + per_estimate * plant.sensed.len();
    let queue = washout + usize::from(matches!(mode, Mode::Washout(_)));
    let held = queue + whole * inputs;
    let acted = held + if fraction > 0.0 { inputs } else { 0 };
    let size = acted + if around.estimator.predicts() { inputs } else { 0 };
    let estimator = around.estimator.matrix(around.rate_hz);
    // The velocity per sample that the last command gave, along the normal and of each joint.
    let pushed = |row: usize| {
        (acted..size).enumerate().fold(Signal { state: DVector::zeros(size), force: 0.0 }, |sum, (input, state)| {
            sum.plus(pushes[(row, input)], &Signal::of_state(size, state))
        })
    };
    let mut loop_ = Assembly::new(size);

    // What the controller sees and asks for at this sample.
    let velocity = loop_.estimate(&estimator, filter, &Signal::of_state(size, moved), &pushed(0));
    let force = Signal { state: DVector::zeros(size), force: 1.0 };
    let mut asked = vec![force.clone()];
    if let Mode::Washout(hz) = mode {
        let (low, step) = one_pole(hz, around.rate_hz, &force, &Signal::of_state(size, washout));
        loop_.change(washout, &step);
        asked.push(force.plus(-1.0, &low));
    }
    debug_assert_eq!(asked.len(), walls);
    for joint in 0..plant.sensed.len() {
        let seen = Signal::of_state(size, joint_moved + joint);
        let first = joint_filter + per_estimate * joint;
        asked.push(loop_.estimate(&estimator, first, &seen, &pushed(plant.sensed[joint] + 1)));
    }

    // Delay: whole samples in a queue, the rest splits the interval between the last command and this one.
    let steps = Stepped::new(plant, fraction);
    let mut change = vec![Signal { state: DVector::zeros(size), force: 0.0 }; plant.a.nrows()];
    for (row, change) in change.iter_mut().enumerate() {
        for column in 0..plant_states {
            change.state[column] += steps.free[(row, column)];
        }
    }
    for (input, asked) in asked.iter().enumerate() {
        if around.estimator.predicts() {
            loop_.change(acted + input, &asked.plus(-1.0, &Signal::of_state(size, acted + input)));
        }
        let mut now = asked.clone();
        for place in 0..whole {
            let slot = queue + input * whole + place;
            let waiting = Signal::of_state(size, slot);
            loop_.change(slot, &now.plus(-1.0, &waiting));
            now = waiting;
        }
        for (row, change) in change.iter_mut().enumerate() {
            *change = change.plus(steps.now[(row, input)], &now);
        }
        if fraction > 0.0 {
            let before = Signal::of_state(size, held + input);
            loop_.change(held + input, &now.plus(-1.0, &before));
            for (row, change) in change.iter_mut().enumerate() {
                *change = change.plus(steps.before[(row, input)], &before);
            }
        }
    }
    for (state, change) in change.iter().take(plant_states).enumerate() {
        loop_.change(state, change);
    }
    let follow = |loop_: &mut Assembly, state: usize, change: &Signal| {
        loop_.change(state, &change.plus(-1.0, &Signal::of_state(size, state)));
    };
    let nothing = Signal { state: DVector::zeros(size), force: 0.0 };
    let seen =
        |sum: Signal, (change, share): (&Signal, &f64)| if *share == 0.0 { sum } else { sum.plus(*share, change) };
    follow(&mut loop_, moved, &change.iter().zip(&plant.seen).fold(nothing, seen));
    for joint in 0..plant.sensed.len() {
        follow(&mut loop_, joint_moved + joint, &change[plant_states + joint]);
    }

    let drift = drifting(device, around, mode, plant, mass, |columns| {
        let mut states = DMatrix::zeros(size, columns.len());
        for (column, (velocity, share, torque, force)) in columns.iter().enumerate() {
            for (state, v) in velocity.iter().enumerate() {
                states[(state, column)] = *v;
            }
            for (state, tau) in torque.iter().enumerate() {
                states[(plant.damped.len() + state, column)] = *tau;
            }
            if plant.has_share {
                states[(plant.position - 1, column)] = *share;
            }
            let mut constant = vec![*force];
            if walls == 2 {
                constant.push(0.0);
                states[(washout, column)] = *force;
            }
            for (slot, joint) in plant.sensed.iter().enumerate() {
                let v = plant.damped.iter().position(|d| d == joint).map_or(0.0, |i| velocity[i]);
                constant.push(v);
                states[(joint_moved + slot, column)] = v;
            }
            // What the estimators remember of constant velocities (none along the normal) and commands.
            let commands = DVector::from_column_slice(&constant);
            let given = |row: usize| if around.estimator.predicts() { pushes.row(row).tr_dot(&commands) } else { 0.0 };
            let mut remember = |first: usize, v: f64, given: f64| {
                for (state, value) in around.estimator.rest(around.rate_hz, v, given).iter().enumerate() {
                    states[(first + state, column)] = *value;
                }
            };
            remember(filter, 0.0, given(0));
            for (slot, joint) in plant.sensed.iter().enumerate() {
                remember(joint_filter + per_estimate * slot, constant[walls + slot], given(joint + 1));
            }
            for (state, command) in (acted..size).zip(&constant) {
                states[(state, column)] = *command;
            }
            for (input, value) in constant.iter().enumerate() {
                for place in 0..whole {
                    states[(queue + input * whole + place, column)] = *value;
                }
                if fraction > 0.0 {
                    states[(held + input, column)] = *value;
                }
            }
        }
        states
    });
    let resonances = if device.flexible.is_rigid() { Vec::new() } else { resonances(&steps.free, plant_states) };
    OpenLoop {
        f: loop_.f,
        input: loop_.input,
        position: plant.seen.clone().resize_vertically(size, 0.0),
        velocity: velocity.state,
        mass,
        sample_s: 1.0 / around.rate_hz,
        drift,
        resonances,
    }
}

pub(super) fn resonances(free: &DMatrix<f64>, states: usize) -> Vec<(f64, f64)> {
    let modes = eigenvalues(free.view((0, 0), (states, states)).into_owned()).unwrap_or_default();
    let polar = modes.into_iter().map(|gamma| (gamma + 1.0).to_polar());
    polar.filter(|(_, angle)| *angle > 0.0 && *angle < std::f64::consts::PI).collect()
}

/// The plant over one sample: its free change, and what the present and the previous command add.
struct Stepped {
    free: DMatrix<f64>,
    now: DMatrix<f64>,
    before: DMatrix<f64>,
}

impl Stepped {
    fn new(plant: &ContinuousPlant, fraction: f64) -> Self {
        let (n, p) = (plant.a.nrows(), plant.b.ncols());
        let over = |time: f64| {
            let mut joined = DMatrix::zeros(n + p, n + p);
            joined.view_mut((0, 0), (n, n)).copy_from(&(&plant.a * time));
            joined.view_mut((0, n), (n, p)).copy_from(&(&plant.b * time));
            let e = exp_minus_identity(&joined);
            (e.view((0, 0), (n, n)).into_owned(), e.view((0, n), (n, p)).into_owned())
        };
        let (free, all) = over(1.0);
        if fraction == 0.0 {
            return Self { free, now: all, before: DMatrix::zeros(n, p) };
        }
        let (_, early) = over(fraction);
        let (rest, now) = over(1.0 - fraction);
        let before = &early + rest * &early;
        Self { free, now, before }
    }
}

/// (velocities of the damped joints, share of the undamped ones, lagging torques, wall force) of one constant motion.
type Constant = (Vec<f64>, f64, Vec<f64>, f64);

/// The constant motions that damping compensation leaves without any restoring force.
///
/// With the joints' damping exactly compensated, every constant joint velocity with no rendered part is at rest: under
/// full feed-forward the wall holds EᵀB q̇ against it, under washout only where that is zero. A drive that damps by
/// itself (back-EMF) has none.
fn drifting(
    device: &Linearised,
    around: &Loop,
    mode: Mode,
    plant: &ContinuousPlant,
    mass: f64,
    states: impl Fn(&[Constant]) -> DMatrix<f64>,
) -> Option<Drift> {
    if plant.sensed.is_empty() || plant.electrically_damped {
        return None;
    }
    let t = 1.0 / around.rate_hz;
    let d = plant.damped.len();
    let pull = DVector::from_fn(d, |i, _| {
        let joint = plant.damped[i];
        device.unit_motion[joint] * device.viscous[joint] * t / mass
    });
    let mut conditions = Vec::new();
    if !plant.has_share {
        conditions.push(DVector::from_fn(d, |i, _| device.row[plant.damped[i]]));
    }
    if matches!(mode, Mode::Washout(_)) {
        conditions.push(pull.clone());
    }
    let (basis, pivot) = null_space(d, &conditions);
    if basis.is_empty() {
        return None;
    }
    let constants: Vec<Constant> = basis
        .iter()
        .map(|v| {
            let share = -(0..d).map(|i| device.row[plant.damped[i]] * v[i]).sum::<f64>();
            let torque = plant
                .lagging
                .iter()
                .map(|j| {
                    let at = plant.damped.iter().position(|i| i == j);
                    at.map_or(0.0, |i| v[i] * device.viscous[*j] * t / mass)
                })
                .collect();
            let force = if mode == Mode::Full { pull.dot(v) } else { 0.0 };
            (v.iter().copied().collect(), share, torque, force)
        })
        .collect();
    let force = DVector::from_iterator(constants.len(), constants.iter().map(|c| c.3));
    Some(Drift { states: states(&constants), force, pivot, position: plant.position })
}

/// Basis of the vectors orthogonal to all conditions, by Gauss-Jordan elimination: each is one at its own pivot
/// coordinate and zero at the others'.
fn null_space(dimension: usize, conditions: &[DVector<f64>]) -> (Vec<DVector<f64>>, Vec<usize>) {
    let mut rows: Vec<DVector<f64>> = Vec::new();
    let mut bound = Vec::new();
    for condition in conditions {
        let mut row = condition.clone();
        for (other, &at) in rows.iter().zip(&bound) {
            let factor = row[at];
            row -= other * factor;
        }
        let at = row.iamax();
        if row[at].abs() <= 1e-12 * condition.amax() {
            continue;
        }
        row /= row[at];
        for other in &mut rows {
            let factor = other[at];
            *other -= &row * factor;
        }
        rows.push(row);
        bound.push(at);
    }
    let free: Vec<usize> = (0..dimension).filter(|i| !bound.contains(i)).collect();
    let basis = free
        .iter()
        .map(|&at| {
            let mut v = DVector::zeros(dimension);
            v[at] = 1.0;
            for (row, &pivot) in rows.iter().zip(&bound) {
                v[pivot] = -row[at];
            }
            v
        })
        .collect();
    (basis, free)
}

impl Drift {
    /// F on the states that are left when the constant motions are taken out.
    fn removed(&self, f: DMatrix<f64>, kp: f64) -> DMatrix<f64> {
        let mut motion = self.states.clone();
        for column in 0..motion.ncols() {
            motion[(self.position, column)] = -self.force[column] / kp;
        }
        let mut reduced = f.clone();
        for (column, &pivot) in self.pivot.iter().enumerate() {
            reduced -= motion.column(column) * f.row(pivot);
        }
        let kept: Vec<usize> = (0..f.nrows()).filter(|i| !self.pivot.contains(i)).collect();
        DMatrix::from_fn(kept.len(), kept.len(), |i, j| reduced[(kept[i], kept[j])])
    }
}
