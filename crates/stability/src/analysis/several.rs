//! Walls that act together: the totals of stiffness and damping at which they are stable.
//!
//! Each wall has a share of both totals. In the principal directions of the walls' stiffness their forces are φ_k =
//! -κ_k (kp x_k + kd v_k), with κ the eigenvalues of Σ shareᵢ nᵢ nᵢᵀ. Any number of walls is therefore one feedback
//! loop per direction. The torques of φ follow the board's law (docs/model.md section 2), or are Jᵀ φ. Transmissions,
//! modes and a hand are included as for one wall.
//!
//! A single loop has exact crossings ([`super::boundary`]). For several loops coupled by joint damping, the stable
//! intervals of a gain are searched on a fine grid and refined by bisection of the eigenvalues.

use super::boundary::{Interval, SMALLEST_STIFFNESS};
use super::flexible::{Flexible, Hand, Posture};
use super::flexible_reduction::{ObservedDevice, ReducedDevice, reduce_observed};
use super::oscillation::Oscillation;
use super::plant::{Drive, Lags, Linearised};
use super::pose::{PoseError, TaskPose, unit_normal};
use super::sampled::{AnalysisError, Loop, Mode, OpenLoop, resonances};
use super::spectrum::{exp_minus_identity, growth};
use super::subject::Subject;
use haptic_bridge::math::FineTable;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::inertia::MIN_STIFFNESS_SHARE;
use haptic_bridge::model::mechanism::{Mechanism, Shaping};
use haptic_bridge::model::principal::{Principal, Pull};
use haptic_bridge::with_mechanism;
use nalgebra::{DMatrix, DVector, SVector};

/// One of several walls that act together.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Normal in the task frame, d entries, any length but zero.
    pub normal: Vec<f64>,
    /// Share of the total stiffness and damping, positive, in any unit common to all walls.
    pub share: f64,
    /// True if the wall uses the feed-forward.
    pub feed_forward: bool,
}

impl Member {
    /// Creates a wall with the feed-forward.
    #[must_use]
    pub fn new(normal: Vec<f64>, share: f64) -> Self {
        Self { normal, share, feed_forward: true }
    }
}

/// Several walls on a device at rest at one pose.
#[derive(Clone, Debug)]
pub struct WallSet {
    /// Unit normal of the first wall, d entries.
    first: DVector<f64>,
    /// M, N x N, kg m².
    mass: DMatrix<f64>,
    /// B of each joint, N m s/rad.
    viscous: DVector<f64>,
    /// Rendered directions as columns, d x R, unit vectors.
    directions: DMatrix<f64>,
    /// Rendered directions as rows, R x N, m/rad.
    rows: DMatrix<f64>,
    /// Share κ of the total stiffness along each direction, R entries.
    stiffness: DVector<f64>,
    /// Torques for a unit force along each direction with the feed-forward, N x R, m.
    shaped: DMatrix<f64>,
    /// Torques that the feed-forward commands for the joint torques b, N x N.
    bias: DMatrix<f64>,
    /// Compliant parts of the device, and the hand that holds it.
    flexible: Flexible,
}

/// Builds the loop of one wall, with posture control if the device has it, for a controller with this `model`.
pub(super) fn open_loop(
    device: &Linearised,
    model: &Linearised,
    around: &Loop,
    mode: Mode,
) -> Result<OpenLoop, AnalysisError> {
    match device.flexible.posture {
        Some(_) => Ok(WallLoops::new(&WallSet::of_one(device, model), around, mode)?.single_loop()),
        None => OpenLoop::with_model(device, model, around, mode),
    }
}

impl WallSet {
    /// Linearises the device for these walls. The feed-forward of a redundant device holds `admissible`.
    pub fn at(
        description: &Description,
        q: &[f64],
        walls: &[Member],
        admissible: Admissible,
    ) -> Result<Self, PoseError> {
        Self::of(&Subject::new(description)?, q, walls, admissible)
    }

    /// Like [`WallSet::at`], for a [`Subject`].
    pub fn of(subject: &Subject, q: &[f64], walls: &[Member], admissible: Admissible) -> Result<Self, PoseError> {
        let mechanism = &subject.device.mechanism;
        TaskPose::of(mechanism, q)?.regular()?;
        with_mechanism!(mechanism, m => linearise_walls(m, subject, q, walls, admissible))
    }

    /// Creates a set of one wall on a device whose controller has this `model`.
    fn of_one(device: &Linearised, model: &Linearised) -> Self {
        let joints = device.mass.nrows();
        let unit = &model.unit_motion;
        let back = &model.mass * unit * unit.transpose() / model.w_rr();
        Self {
            first: device.flexible.normal.clone(),
            mass: device.mass.clone(),
            viscous: device.viscous.clone(),
            directions: DMatrix::from_columns(std::slice::from_ref(&device.flexible.normal)),
            rows: DMatrix::from_rows(&[device.row.transpose()]),
            stiffness: DVector::from_element(1, 1.0),
            shaped: DMatrix::from_columns(&[model.shaped_torque()]),
            bias: DMatrix::identity(joints, joints) - back,
            flexible: device.flexible.clone(),
        }
    }

    /// Sets the posture control with the Jacobian row of the orientation.
    pub(super) fn in_posture(mut self, posture: Option<(Posture, DVector<f64>)>) -> Self {
        self.flexible.posture = posture;
        self
    }

    /// Removes joint damping.
    pub fn undamped(mut self) -> Self {
        self.viscous.fill(0.0);
        self
    }

    /// Adds a hand.
    pub fn with_hand(mut self, hand: Hand) -> Self {
        self.flexible.hand = hand;
        self
    }

    /// Returns the effective inertia in the stiffest motion, kg. For one wall this is Weff or Wrr.
    pub fn effective_inertia(&self, feed_forward: bool) -> Option<f64> {
        let stiffest = self.acceleration(feed_forward)?.complex_eigenvalues();
        let largest = stiffest.iter().map(|value| value.norm()).fold(0.0, f64::max);
        (largest > 0.0 && largest.is_finite()).then(|| 1.0 / largest)
    }

    /// Returns the tip's unit direction in the stiffest motion, on the first wall's side.
    pub fn stiffest_direction(&self, feed_forward: bool) -> Option<DVector<f64>> {
        let answer = self.acceleration(feed_forward)?;
        let fastest = 1.0 / self.effective_inertia(feed_forward)?;
        let rest = &answer - DMatrix::identity(answer.nrows(), answer.ncols()) * fastest;
        let still = rest.svd(false, true);
        let least = still.singular_values.imin();
        let along = &self.directions * still.v_t?.row(least).transpose();
        Some(if along.dot(&self.first) < 0.0 { -along } else { along })
    }

    /// Returns the direction half way between the stiffest directions without and with the feed-forward.
    pub fn middle_of_stiffest_directions(&self) -> Option<DVector<f64>> {
        let (without, with) = (self.stiffest_direction(false)?, self.stiffest_direction(true)?);
        let turned = if with.dot(&without) < 0.0 { -with } else { with };
        Some((without + turned).normalize())
    }

    /// Returns the walls' force at 1 m along `direction` (d entries) for a total stiffness of 1 N/m, N (d entries).
    pub fn force(&self, direction: &DVector<f64>) -> DVector<f64> {
        &self.directions * self.parts(direction)
    }

    /// Returns the joint torques for [`WallSet::force`], N m (N entries), without or with the feed-forward.
    pub fn torque(&self, direction: &DVector<f64>, feed_forward: bool) -> DVector<f64> {
        let force = self.parts(direction);
        if feed_forward { &self.shaped * force } else { self.rows.tr_mul(&force) }
    }

    /// Returns the components of [`WallSet::force`] along the rendered directions, R entries.
    fn parts(&self, direction: &DVector<f64>) -> DVector<f64> {
        self.directions.tr_mul(direction).component_mul(&self.stiffness)
    }

    /// Returns acceleration over displacement in the rendered directions at 1 N/m, R x R, 1/kg.
    fn acceleration(&self, feed_forward: bool) -> Option<DMatrix<f64>> {
        let levers = if feed_forward { self.shaped.clone() } else { self.rows.transpose() };
        let mobility = &self.rows * self.mass.clone().cholesky()?.solve(&levers);
        Some(mobility * DMatrix::from_diagonal(&self.stiffness))
    }
}

fn linearise_walls<const N: usize, M: Mechanism<f64, N>>(
    m: &M,
    subject: &Subject,
    q: &[f64],
    walls: &[Member],
    admissible: Admissible,
) -> Result<WallSet, PoseError> {
    let pose = m.pose::<FineTable>(&SVector::from_column_slice(q));
    let total: f64 = walls.iter().map(|wall| wall.share).sum();
    let mut pulls: Vec<Pull<f64, N>> = Vec::new();
    for wall in walls {
        let unit = unit_normal(&wall.normal, M::SPEC.task, N)?;
        pulls.push(Pull {
            normal: SVector::from_fn(|i, _| unit[i]),
            across: false,
            stiffness: wall.share / total,
            feed_forward: wall.feed_forward,
        });
    }
    let principal = Principal::new::<FineTable>(&pulls, M::SPEC.task);
    let most = pulls.iter().map(|pull| pull.stiffness).fold(0.0, f64::max);
    let rendered_indices: Vec<usize> =
        (0..N).filter(|i| principal.stiffness_along(*i) > MIN_STIFFNESS_SHARE * principal.stiffness_along(0)).collect();
    let null = m.shaping(&pose, &SVector::from_fn(|i, _| f64::from(u8::from(i == N - 1))));
    let shapings: [Shaping<f64, N>; N] = core::array::from_fn(|i| {
        let along = m.shaping(&pose, &principal.direction(i));
        let holds = i < M::SPEC.task && M::SPEC.task < N && admissible != Admissible::Orientation;
        if holds { admissible.hold(&along, &null) } else { along }
    });
    let torque = |force: &SVector<f64, N>, b: Option<SVector<f64, N>>| {
        let (torque, plain) = principal.feed_forward(&shapings, force, 1.0, |_| b.map(|b| (b, b)));
        let torque = torque + m.transpose(&pose, &plain);
        DVector::from_iterator(N, torque.iter().copied())
    };
    let dense = |v: SVector<f64, N>| DVector::from_iterator(N, v.iter().copied());
    let rows: Vec<DVector<f64>> =
        rendered_indices.iter().map(|i| dense(m.transpose(&pose, &principal.direction(*i)))).collect();
    let shaped: Vec<DVector<f64>> = rendered_indices.iter().map(|i| torque(&principal.direction(*i), None)).collect();
    let bias: Vec<DVector<f64>> =
        (0..N).map(|j| torque(&SVector::zeros(), Some(SVector::from_fn(|i, _| f64::from(u8::from(i == j)))))).collect();
    let mass = m.mass(&pose);
    let tips: Vec<DVector<f64>> = (0..M::SPEC.task)
        .map(|axis| dense(m.transpose(&pose, &SVector::from_fn(|i, _| f64::from(u8::from(i == axis))))))
        .collect();
    let flexible = Flexible { tip: DMatrix::from_columns(&tips).transpose(), ..subject.compliant_parts() };
    Ok(WallSet {
        flexible,
        mass: DMatrix::from_fn(N, N, |i, j| mass[(i, j)]),
        viscous: DVector::from_fn(N, |j, _| subject.device.joints[j].viscous),
        first: DVector::from_fn(M::SPEC.task, |i, _| pulls.first().map_or(0.0, |pull| pull.normal[i])),
        directions: DMatrix::from_fn(M::SPEC.task, rendered_indices.len(), |i, column| {
            principal.direction(rendered_indices[column])[i]
        }),
        rows: DMatrix::from_columns(&rows).transpose(),
        stiffness: DVector::from_iterator(
            rendered_indices.len(),
            rendered_indices.iter().map(|i| principal.stiffness_along(*i) * most),
        ),
        shaped: DMatrix::from_columns(&shaped),
        bias: DMatrix::from_columns(&bias),
    })
}

/// The walls' loops, opened at their forces φ, in sample units: each sample adds `f` s + `input` φ to the states s.
pub(crate) struct WallLoops {
    f: DMatrix<f64>,
    input: DMatrix<f64>,
    position: DMatrix<f64>,
    velocity: DMatrix<f64>,
    stiffness: DVector<f64>,
    /// Reference mass, kg; the unit of stiffness is `mass/T²`, and of damping `mass/T`.
    pub mass: f64,
    pub sample_s: f64,
}

/// Largest |z|² - 1 that counts as rounding. Motions that no wall measures rest on the unit circle, and eigenvalues are
/// exact to 1e-15 of the fastest change.
const ROUNDING: f64 = 1.0e-11;

/// Smallest analysed gain, in sample units.
const SMALLEST_GAIN: f64 = 1.0e-6;
/// Ratio of neighbouring gains on the grid.
const GAIN_RATIO: f64 = 1.15;
const LARGEST_GAIN: f64 = 40.0;

impl WallLoops {
    /// Builds the loops of the device.
    pub fn new(set: &WallSet, around: &Loop, mode: Mode) -> Result<Self, AnalysisError> {
        around.check()?;
        if let Mode::Washout(hz) = mode {
            around.check_cutoff(hz)?;
        }
        let (walls, joints) = set.rows.shape();
        // The posture control is an additional direction; its loop is closed below.
        let rows = match &set.flexible.posture {
            Some((_, row)) => {
                DMatrix::from_fn(walls + 1, joints, |i, j| if i < walls { set.rows[(i, j)] } else { row[j] })
            }
            None => set.rows.clone(),
        };
        let directions = rows.nrows();
        let mass = set.effective_inertia(mode != Mode::Off).ok_or(AnalysisError::Singular)?;
        let inverse = set.mass.clone().cholesky().ok_or(AnalysisError::Singular)?.inverse();
        let t = 1.0 / around.rate_hz;
        if matches!(&around.drive, Drive::Voltage(motors) if motors.len() != joints) {
            return Err(AnalysisError::Motor);
        }
        let compensated = around.damping_compensation && mode != Mode::Off;
        if compensated && !set.flexible.is_rigid() {
            return Err(AnalysisError::CompensatedFlexible);
        }
        let lags = Lags::new(&around.drive, joints, t);
        // With posture control, uses the reduction for compliant devices because it removes unmeasured motions.
        let rendered_plant = match set.flexible.is_rigid() && (set.flexible.posture.is_none() || compensated) {
            true => rigid_plant(set, &rows, &lags, &inverse, t, mass, compensated),
            false => {
                let WallSet { mass: m, viscous, flexible, directions, .. } = set;
                let observed = ObservedDevice { mass: m, viscous, flexible, rows: &rows, directions };
                // Torques are divided by m/T².
                let reduced = reduce_observed(&observed, &lags, &DMatrix::identity(joints, joints), t, mass);
                let ReducedDevice { a, b, rendered_rows } = reduced.ok_or(AnalysisError::Singular)?;
                let joint_velocities = DMatrix::zeros(0, a.nrows());
                RenderedPlant { a, b, positions: rendered_rows, joint_velocities }
            }
        };
        // The joints with compensated damping add their angles to the states; the plant's states do not depend on them.
        let (plant, sensed) = (rendered_plant.a.nrows(), rendered_plant.joint_velocities.nrows());
        let all = plant + sensed;
        let mut joined = DMatrix::zeros(all + joints, all + joints);
        joined.view_mut((0, 0), (plant, plant)).copy_from(&rendered_plant.a);
        joined.view_mut((0, all), (plant, joints)).copy_from(&rendered_plant.b);
        joined.view_mut((plant, 0), (sensed, plant)).copy_from(&rendered_plant.joint_velocities);
        let over = |time: f64| {
            let e = exp_minus_identity(&(&joined * time));
            (e.view((0, 0), (all, plant)).into_owned(), e.view((0, all), (all, joints)).into_owned())
        };
        let whole = around.delay_samples.floor();
        let fraction = around.delay_samples - whole;
        let (whole, fraction) = (whole as usize, if fraction < 1e-12 { 0.0 } else { fraction });
        let (free, mut now) = over(1.0);
        let mut before = DMatrix::zeros(all, joints);
        if fraction > 0.0 {
            let (_, early) = over(fraction);
            let (rest, late) = over(1.0 - fraction);
            before = &early + rest * early.rows(0, plant);
            now = late;
        }

        // More states follow: the filters of each direction and joint, and the commands in the delay.
        let per = around.estimator.states();
        let moved = plant;
        let filters = moved + directions + sensed;
        let washout = filters + per * (directions + sensed);
        let queue = washout + if matches!(mode, Mode::Washout(_)) { walls } else { 0 };
        let held = queue + whole * joints;
        let acted = held + if fraction > 0.0 { joints } else { 0 };
        let size = acted + if around.estimator.uses_commands() { joints } else { 0 };
        let estimator = around.estimator.matrix(around.rate_hz);

        let change = |s: &DVector<f64>, forces: &DVector<f64>| {
            let mut change = DVector::zeros(size);
            let force = forces.rows(0, walls).into_owned();
            let mut command = match mode {
                Mode::Off => set.rows.tr_mul(&force),
                Mode::Full => &set.shaped * force,
                Mode::Washout(hz) => {
                    let g = (std::f64::consts::PI * hz * t).tan();
                    let mut high = force.clone();
                    for k in 0..walls {
                        let step = (force[k] - s[washout + k]) * g / (1.0 + g);
                        high[k] -= s[washout + k] + step;
                        change[washout + k] = 2.0 * step;
                    }
                    set.rows.tr_mul(&(force - &high)) + &set.shaped * high
                }
            };
            command += rows.rows(walls, directions - walls).tr_mul(&forces.rows(walls, directions - walls));
            let mut estimates = DVector::zeros(directions + sensed);
            // Effect of the last command on the directions and on the joints.
            let given = &inverse * s.rows(acted, size - acted).into_owned().resize_vertically(joints, 0.0) * mass;
            let along = &rows * &given;
            for k in 0..directions + sensed {
                let first = filters + per * k;
                let pushed = if k < directions { along[k] } else { given[k - directions] };
                let filter_input = s.rows(first, per).into_owned().push(s[moved + k]).push(pushed);
                let answer = &estimator * filter_input;
                estimates[k] = answer[per];
                change.rows_mut(first, per).copy_from(&answer.rows(0, per));
            }
            if compensated {
                let damping = DVector::from_fn(joints, |j, _| set.viscous[j] * estimates[directions + j] * t / mass);
                command += &set.bias * damping;
            }
            for (state, command) in (acted..size).zip(command.iter()) {
                change[state] = command - s[state];
            }
            for place in 0..whole {
                let at = queue + place * joints;
                let waiting = s.rows(at, joints).into_owned();
                change.rows_mut(at, joints).copy_from(&(&command - &waiting));
                command = waiting;
            }
            let mut motion = &free * s.rows(0, plant) + &now * &command;
            if fraction > 0.0 {
                let last = s.rows(held, joints).into_owned();
                motion += &before * &last;
                change.rows_mut(held, joints).copy_from(&(&command - &last));
            }
            let along = &rendered_plant.positions * motion.rows(0, plant);
            for k in 0..directions {
                change[moved + k] = along[k] - s[moved + k];
            }
            for j in 0..sensed {
                change[moved + directions + j] = motion[plant + j] - s[moved + directions + j];
            }
            change.rows_mut(0, plant).copy_from(&motion.rows(0, plant));
            (change, estimates)
        };

        let none = DVector::zeros(directions);
        let unit = |size: usize, at: usize| DVector::from_fn(size, |i, _| f64::from(u8::from(i == at)));
        let mut f = DMatrix::zeros(size, size);
        let mut velocity = DMatrix::zeros(directions, size);
        let mut position = DMatrix::zeros(directions, size);
        position.view_mut((0, 0), (directions, plant)).copy_from(&rendered_plant.positions);
        for column in 0..size {
            let (changed, estimates) = change(&unit(size, column), &none);
            f.set_column(column, &changed);
            velocity.set_column(column, &estimates.rows(0, directions));
        }
        let mut input = DMatrix::zeros(size, directions);
        for k in 0..directions {
            input.set_column(k, &change(&DVector::zeros(size), &unit(directions, k)).0);
        }
        if let Some((held, _)) = &set.flexible.posture {
            let feedback =
                position.row(walls) * (held.stiffness * t * t / mass) + velocity.row(walls) * (held.damping * t / mass);
            f -= input.column(walls) * feedback;
            input = input.remove_column(walls);
            (position, velocity) = (position.remove_row(walls), velocity.remove_row(walls));
        }
        Ok(Self { f, input, position, velocity, stiffness: set.stiffness.clone(), mass, sample_s: t })
    }

    fn single_loop(self) -> OpenLoop {
        let first = |rows: &DMatrix<f64>| rows.row(0).transpose();
        OpenLoop {
            resonances: resonances(&self.f, self.f.nrows()),
            input: self.input.column(0).into_owned(),
            position: first(&self.position),
            velocity: first(&self.velocity),
            f: self.f,
            mass: self.mass,
            sample_s: self.sample_s,
            drift: None,
            rounding: ROUNDING,
        }
    }

    /// Returns F of the closed loops for the totals in sample units.
    fn closed(&self, kp: f64, kd: f64) -> DMatrix<f64> {
        let mut feedback = &self.position * kp + &self.velocity * kd;
        for (mut row, stiffness) in feedback.row_iter_mut().zip(self.stiffness.iter()) {
            row *= *stiffness;
        }
        &self.f - &self.input * feedback
    }

    fn is_stable(&self, kp: f64, kd: f64) -> bool {
        growth(self.closed(kp, kd)) < ROUNDING
    }

    /// Returns the least damped oscillation for totals in sample units.
    pub fn oscillation(&self, kp: f64, kd: f64) -> Option<Oscillation> {
        Oscillation::least_damped(self.closed(kp, kd), self.sample_s)
    }

    /// Returns the stable intervals of the total stiffness at one damping, in sample units. An interval from the
    /// smallest grid value begins at [`SMALLEST_STIFFNESS`], like those of a single loop.
    pub fn stiffness_intervals(&self, kd: f64) -> Result<Vec<Interval>, AnalysisError> {
        let mut result = intervals(|kp| self.is_stable(kp, kd))?;
        if let Some(first) = result.first_mut().filter(|first| first.low <= SMALLEST_GAIN) {
            first.low = SMALLEST_STIFFNESS;
        }
        Ok(result)
    }

    /// Returns the stable intervals of the total damping at the smallest stiffness, in sample units.
    pub fn damping_intervals(&self) -> Result<Vec<Interval>, AnalysisError> {
        let mut result = intervals(|kd| self.is_stable(SMALLEST_GAIN, kd))?;
        if let Some(first) = result.first_mut().filter(|first| first.low <= SMALLEST_GAIN)
            && self.is_stable(SMALLEST_GAIN, 0.0)
        {
            first.low = 0.0;
        }
        Ok(result)
    }
}

/// The continuous plant ẋ = a x + b τ per sample, with rows of rendered positions and of the velocities of joints with
/// compensated damping (rad per sample). τ are all joint torques divided by m/T², m is the effective inertia and T the
/// sample period.
struct RenderedPlant {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    positions: DMatrix<f64>,
    joint_velocities: DMatrix<f64>,
}

/// Returns the plant of a rigid device without a hand: joint velocities, lagging torques, positions.
fn rigid_plant(
    set: &WallSet,
    rows: &DMatrix<f64>,
    lags: &Lags,
    inverse: &DMatrix<f64>,
    t: f64,
    mass: f64,
    compensated: bool,
) -> RenderedPlant {
    let (directions, joints) = rows.shape();
    let Lags { rate: lag, emf } = lags;
    let lagging: Vec<usize> = (0..joints).filter(|j| lag[*j].is_some()).collect();
    let (torques, positions) = (joints, joints + lagging.len());
    let plant = positions + directions;
    let (mut a, mut b) = (DMatrix::zeros(plant, plant), DMatrix::zeros(plant, joints));
    for i in 0..joints {
        for j in 0..joints {
            let direct = if lag[j].is_none() { emf[j] } else { 0.0 };
            a[(i, j)] -= t * inverse[(i, j)] * (set.viscous[j] + direct);
            // Torques are divided by m/T².
            if lag[j].is_none() {
                b[(i, j)] = mass * inverse[(i, j)];
            }
        }
        for (slot, j) in lagging.iter().enumerate() {
            a[(i, torques + slot)] = mass * inverse[(i, *j)];
        }
    }
    for (slot, j) in lagging.iter().enumerate() {
        let rate = lag[*j].unwrap_or_default();
        a[(torques + slot, torques + slot)] = -rate;
        a[(torques + slot, *j)] = -rate * emf[*j] * t / mass;
        b[(torques + slot, *j)] = rate;
    }
    a.view_mut((positions, 0), (directions, joints)).copy_from(rows);
    let pick = |rows: usize, from: usize| DMatrix::from_fn(rows, plant, |i, j| f64::from(u8::from(j == from + i)));
    let joint_velocities = pick(if compensated { joints } else { 0 }, 0);
    RenderedPlant { a, b, positions: pick(directions, positions), joint_velocities }
}

/// Returns the stable intervals of a gain from a search on a grid; their ends are refined by bisection.
fn intervals(is_stable: impl Fn(f64) -> bool) -> Result<Vec<Interval>, AnalysisError> {
    let edge = |stable: f64, unstable: f64| {
        let (mut stable, mut unstable) = (stable, unstable);
        while (stable - unstable).abs() > 1.0e-9 * stable.max(unstable) {
            let middle = (stable + unstable) / 2.0;
            if is_stable(middle) { stable = middle } else { unstable = middle }
        }
        stable
    };
    let mut result: Vec<Interval> = Vec::new();
    let (mut last, mut last_stable) = (SMALLEST_GAIN, is_stable(SMALLEST_GAIN));
    if last_stable {
        result.push(Interval { low: SMALLEST_GAIN, high: f64::INFINITY });
    }
    while last < LARGEST_GAIN {
        let next = last * GAIN_RATIO;
        let stable = is_stable(next);
        match (last_stable, stable) {
            (false, true) => result.push(Interval { low: edge(next, last), high: f64::INFINITY }),
            (true, false) => {
                let high = edge(last, next);
                if let Some(open) = result.last_mut() {
                    open.high = high;
                }
            }
            _ => {}
        }
        (last, last_stable) = (next, stable);
    }
    if last_stable { Err(AnalysisError::Unbounded) } else { Ok(result) }
}
