//! The sampled loop of a wall: zero-order hold, computation delay, velocity estimator and feed-forward, in delta form.
//!
//! The loop is opened at the wall force of one sample: s⁺ = s + F s + b f, with the rendered position x and the
//! estimated velocity v as outputs. A wall closes the loop with f = -kp x - kd v, so both gains are rank-one changes of
//! F.
//!
//! Each state is chosen so that its change over a sample is computed directly, because a difference of nearly equal
//! numbers loses precision. So the change of position is a state, and filters are trapezoidal integrators.

pub use super::control_loop::{CARRIER_HZ, CURRENT_LOOP_HZ, LONGEST_DELAY, Loop, Mode, usual_delay};
use super::drift::{Drift, find_drift};
use super::eigenvalues::eigenvalues;
pub use super::error::AnalysisError;
pub use super::estimator::{LONGEST_DIFFERENCE, LinearEstimator, LowPass};
use super::oscillation::Oscillation;
use super::plant::{ContinuousPlant, Drive, Linearised};
use super::reduction::reduce;
use super::spectrum::{exp_minus_identity, growth};
use nalgebra::{DMatrix, DVector};

/// The loop opened at the wall force, in sample units (see [`super::plant`]).
#[derive(Clone, Debug)]
pub(crate) struct OpenLoop {
    /// F = A - I.
    pub f: DMatrix<f64>,
    /// Effect of the wall force.
    pub input: DVector<f64>,
    /// Rendered position, as a row over the states.
    pub position: DVector<f64>,
    /// Estimated rendered velocity per sample, as a row over the states.
    pub velocity: DVector<f64>,
    /// Reference mass, kg; the unit of stiffness is `mass/T²`, and of damping `mass/T`.
    pub mass: f64,
    /// Sample period, s.
    pub sample_s: f64,
    /// Motions without feedback; only damping compensation causes them.
    pub(super) drift: Option<Drift>,
    pub(super) resonances: Vec<(f64, f64)>,
    /// Largest |z|² - 1 that counts as rounding.
    pub(super) rounding: f64,
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

/// Sums the changes of all states over a sample.
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

    /// Adds an estimator whose states begin at `first` and returns its velocity per sample. The inputs are the change
    /// of position `moved` and the velocity per sample from the last command, `pushed`.
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

/// Returns the output of a trapezoidal one-pole low-pass, and the change of its state.
fn one_pole(hz: f64, rate_hz: f64, signal: &Signal, state: &Signal) -> (Signal, Signal) {
    let g = (std::f64::consts::PI * hz / rate_hz).tan();
    let step = signal.plus(-1.0, state).times(g / (1.0 + g));
    (state.plus(1.0, &step), step.times(2.0))
}

impl OpenLoop {
    /// Builds the loop of a device without posture control, for a controller with this `model` of the device.
    pub fn with_model(
        device: &Linearised,
        model: &Linearised,
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

        // Each direction is the torque of one force unit of an input, in metres.
        let shaped = model.shaped_torque();
        let mut directions = match mode {
            Mode::Off => vec![device.row.clone()],
            Mode::Full => vec![shaped.clone()],
            Mode::Washout(_) => vec![device.row.clone(), &shaped - &device.row],
        };
        let walls = directions.len();
        let projected = &model.mass * &model.unit_motion / model.w_rr();
        if compensated {
            // Equation: τ += (I - M E Wrr⁻¹ Eᵀ) B q̇. Each damped joint has an input, its velocity per sample.
            for joint in (0..joints).filter(|&j| is_damped(device, j, sample_s)) {
                let mut column = &projected * -model.unit_motion[joint];
                column[joint] += 1.0;
                directions.push(column * (model.viscous[joint] * sample_s / mass));
            }
        }
        let inputs = DMatrix::from_columns(&directions);
        let plant =
            reduce(device, &around.drive, &inputs, sample_s, mass, compensated).ok_or(AnalysisError::Singular)?;
        // Acceleration per sample² for one unit of each input: first along the normal, then of each joint.
        let inverse = model.mass.clone().cholesky().ok_or(AnalysisError::Singular)?.inverse();
        let given = inverse * &inputs * mass;
        let pushes = DMatrix::from_fn(joints + 1, inputs.ncols(), |i, input| match i {
            0 => model.row.dot(&given.column(input)),
            joint => given[(joint - 1, input)],
        });
        Ok(assemble(device, around, mode, &plant, walls, mass, &pushes))
    }

    /// Returns F of the closed loop for gains in sample units.
    pub fn closed(&self, kp: f64, kd: f64) -> DMatrix<f64> {
        let feedback = &self.position * kp + &self.velocity * kd;
        let f = &self.f - &self.input * feedback.transpose();
        match &self.drift {
            Some(drift) => drift.remove_from(f, kp),
            None => f,
        }
    }

    /// Returns radius and angle (rad) of the oscillating modes of a compliant device without the wall.
    pub fn resonances(&self) -> &[(f64, f64)] {
        &self.resonances
    }

    /// Returns the least damped oscillation for gains in sample units.
    pub fn oscillation(&self, kp: f64, kd: f64) -> Option<Oscillation> {
        Oscillation::least_damped(self.closed(kp, kd), self.sample_s)
    }

    /// Returns true if all modes decay for gains in sample units.
    pub fn is_stable(&self, kp: f64, kd: f64) -> bool {
        growth(self.closed(kp, kd)) < self.rounding
    }
}

/// Largest |z|² - 1 that counts as rounding. A mode this slow needs 10¹² samples to grow.
const ROUNDING: f64 = 1e-12;

/// Returns true if a joint's own damping is large enough for [`reduce`] to include it.
fn is_damped(device: &Linearised, joint: usize, sample_s: f64) -> bool {
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

    // Indices of the states.
    let plant_states = plant.states();
    let moved = plant_states; // change of x over the last sample
    let filter = moved + 1;
    let joint_moved = filter + per_estimate;
    let joint_filter = joint_moved + plant.sensed.len();
    let washout = joint_filter + per_estimate * plant.sensed.len();
    let queue = washout + usize::from(matches!(mode, Mode::Washout(_)));
    let held = queue + whole * inputs;
    let acted = held + if fraction > 0.0 { inputs } else { 0 };
    let size = acted + if around.estimator.uses_commands() { inputs } else { 0 };
    let estimator = around.estimator.matrix(around.rate_hz);
    // Returns the velocity per sample from the last command: along the normal for row 0, then of each joint.
    let pushed = |row: usize| {
        (acted..size).enumerate().fold(Signal { state: DVector::zeros(size), force: 0.0 }, |sum, (input, state)| {
            sum.plus(pushes[(row, input)], &Signal::of_state(size, state))
        })
    };
    let mut loop_ = Assembly::new(size);

    // Computes the controller's inputs and its command at this sample.
    let velocity = loop_.estimate(&estimator, filter, &Signal::of_state(size, moved), &pushed(0));
    let force = Signal { state: DVector::zeros(size), force: 1.0 };
    let mut commands = vec![force.clone()];
    if let Mode::Washout(hz) = mode {
        let (low, step) = one_pole(hz, around.rate_hz, &force, &Signal::of_state(size, washout));
        loop_.change(washout, &step);
        commands.push(force.plus(-1.0, &low));
    }
    debug_assert_eq!(commands.len(), walls);
    for joint in 0..plant.sensed.len() {
        let sensed_motion = Signal::of_state(size, joint_moved + joint);
        let first = joint_filter + per_estimate * joint;
        commands.push(loop_.estimate(&estimator, first, &sensed_motion, &pushed(plant.sensed[joint] + 1)));
    }

    // Whole samples of delay are a queue; the fraction splits the interval between two commands.
    let steps = DiscretePlant::new(plant, fraction);
    let mut change = vec![Signal { state: DVector::zeros(size), force: 0.0 }; plant.a.nrows()];
    for (row, change) in change.iter_mut().enumerate() {
        for column in 0..plant_states {
            change.state[column] += steps.free[(row, column)];
        }
    }
    for (input, commands) in commands.iter().enumerate() {
        if around.estimator.uses_commands() {
            loop_.change(acted + input, &commands.plus(-1.0, &Signal::of_state(size, acted + input)));
        }
        let mut now = commands.clone();
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
    let rendered_change =
        |sum: Signal, (change, share): (&Signal, &f64)| if *share == 0.0 { sum } else { sum.plus(*share, change) };
    follow(&mut loop_, moved, &change.iter().zip(&plant.rendered_rows).fold(nothing, rendered_change));
    for joint in 0..plant.sensed.len() {
        follow(&mut loop_, joint_moved + joint, &change[plant_states + joint]);
    }

    let drift = find_drift(device, around, mode, plant, mass, |columns| {
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
            // Sets the estimators' states for constant velocities (zero along the normal) and commands.
            let commands = DVector::from_column_slice(&constant);
            let given =
                |row: usize| if around.estimator.uses_commands() { pushes.row(row).tr_dot(&commands) } else { 0.0 };
            let mut remember = |first: usize, v: f64, given: f64| {
                for (state, value) in around.estimator.steady_states(around.rate_hz, v, given).iter().enumerate() {
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
        position: plant.rendered_rows.clone().resize_vertically(size, 0.0),
        velocity: velocity.state,
        mass,
        sample_s: 1.0 / around.rate_hz,
        drift,
        resonances,
        rounding: ROUNDING,
    }
}

pub(super) fn resonances(free: &DMatrix<f64>, states: usize) -> Vec<(f64, f64)> {
    let modes = eigenvalues(free.view((0, 0), (states, states)).into_owned()).unwrap_or_default();
    let polar = modes.into_iter().map(|gamma| (gamma + 1.0).to_polar());
    polar.filter(|(_, angle)| *angle > 0.0 && *angle < std::f64::consts::PI).collect()
}

/// The plant over one sample: its free change, and the effects of the present and of the previous command.
struct DiscretePlant {
    free: DMatrix<f64>,
    now: DMatrix<f64>,
    before: DMatrix<f64>,
}

impl DiscretePlant {
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
