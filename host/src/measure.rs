//! Measuring the stable range on a board: raise the stiffness until the loop oscillates, back off, bisect, repeat.
//!
//! Everything goes through the protocol, so the board may be simulated, emulated or real, and the theory is not asked:
//! what counts is whether the telemetry of the wall's motion grows or decays ([`swing`]).
//!
//! One bilateral wall is tested at the place where the tip is held. Holding is done by walls too, because gains change
//! at once and a new scene fades in over half a second: one wall along the tested normal and one across it for every
//! other direction. A trial pulls the tip aside by a small distance, lets it swing back, and hands it over to the
//! tested gains in full motion. The holding walls are soft springs chosen from the inertia at the pose and the filter's
//! cutoff, nothing else.

pub mod campaign;
pub mod progress;
pub mod search;
pub mod swing;

use std::time::Duration;

use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::servo::{HostAction, Rules};
use nalgebra::DVector;
use thiserror::Error;

use crate::analysis::plant::Linearised;
use crate::analysis::pose::{PoseError, unit_normal};
use crate::device_file::DeviceFile;
use crate::link::{Board, BoardError, LinkError, fields};
use swing::{Swing, Verdict};

/// Why a measurement ended early. Motors are off whenever one of these is returned.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The board could not be reached or refused.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The link broke.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The user stopped it.
    #[error("interrupted: motors are off; run the same command again to go on where it stopped")]
    Interrupted,
    /// The board tripped a fault.
    #[error("the board tripped a fault: {0}; see `haptic faults`, put the device back and run the same command again")]
    Fault(Fault),
    /// The tip could not be held still.
    #[error(
        "the tip does not come to rest when held softly; put the device at a pose away from stops and singularities, and check the device file's inertia"
    )]
    Restless,
    /// The pose is no good.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The scene is impossible.
    #[error("{0}")]
    Scene(String),
    /// The progress cannot be kept.
    #[error(transparent)]
    Progress(#[from] progress::ProgressError),
    /// No bound was found.
    #[error(
        "no oscillation up to {0:.0} N/m: the motors saturate first, or friction and hands damp it; use a lower rate or cutoff, or another pose"
    )]
    Unbounded(f64),
}

impl From<MeasureError> for crate::error::Failure {
    fn from(error: MeasureError) -> Self {
        match error {
            MeasureError::Board(error) => error.into(),
            MeasureError::Link(error) => error.into(),
            MeasureError::Pose(error) => error.into(),
            error => Self::impossible(error),
        }
    }
}

/// What is measured, and how gently.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Unit normal in the task frame, d entries.
    pub normal: Vec<f64>,
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the velocity filter, Hz.
    pub cutoff_hz: f64,
    /// Corner of the washout where that is measured, Hz.
    pub washout_hz: f64,
    /// Largest joint torque the measurement may ask for, N m.
    pub torque_limit: f64,
    /// Farthest the tip is pulled aside, m.
    pub largest_pull: f64,
}

/// A board made ready to measure. While it measures, a tool that is killed or unplugged takes the motors with it; when
/// dropped it disarms the board and puts its rules back.
pub struct Bench<'a> {
    board: &'a mut Board,
    setup: Setup,
    interrupted: &'a dyn Fn() -> bool,
    q: Vec<f64>,
    tip: DVector<f64>,
    normal: DVector<f64>,
    /// Holding gains (N/m, N s/m), along the normal first, then across.
    holding: Vec<(f64, f64)>,
    /// Largest wall force that stays within the torque limit, N.
    force_limit: f64,
    /// Natural frequency of the hold, rad/s.
    hold_frequency: f64,
    /// Smallest step of the tip along the normal, m.
    quantum: f64,
    divider: u32,
    /// The board's rules as they were.
    before: Rules,
}

/// How long the board goes on without this tool, s: a measurement must not outlive the one who watches it.
const HOST_SECONDS: f32 = 1.0;

/// Distance between the tested wall and the one that pulls aside, m: more than any pull.
const APART: f64 = 0.01;

/// Walls of the scene: the tested one, the two that pull aside (at +[`APART`] and -[`APART`]), then those across.
const TESTED: u8 = 0;
const ASIDE: [u8; 2] = [1, 2];
const ACROSS: u8 = 3;

impl<'a> Bench<'a> {
    /// Loads the scene at the present tip, limits the torque, arms and waits until the tip rests.
    pub fn new(
        board: &'a mut Board,
        file: &DeviceFile,
        setup: Setup,
        interrupted: &'a dyn Fn() -> bool,
    ) -> Result<Self, MeasureError> {
        let spec = file.spec();
        let status = board.status()?;
        let q: Vec<f64> = status.q[..spec.joints].iter().map(|&v| f64::from(v)).collect();
        let tip = DVector::from_fn(spec.task, |i, _| f64::from(status.tip[i]));
        let unit = unit_normal(&setup.normal, spec.task, spec.joints)?;
        let normal = unit.rows(0, spec.task).into_owned();
        let across = complement(&normal);

        // The hold: natural frequency well below filter and rate, damping 0.7.
        let hold_frequency = (0.05 * setup.rate_hz).min(0.3 * std::f64::consts::TAU * setup.cutoff_hz);
        let mut holding = Vec::new();
        for direction in std::iter::once(&normal).chain(&across) {
            let seen = Linearised::at(&file.description, &q, direction.as_slice())?;
            let inertia = seen.w_eff().unwrap_or_else(|| seen.w_rr());
            holding.push((inertia * hold_frequency.powi(2), 1.4 * inertia * hold_frequency));
        }
        let device = Linearised::at(&file.description, &q, normal.as_slice())?;
        let lever = device.row.amax().max(device.shaped_torque().amax());
        let quantum = (0..spec.joints)
            .filter_map(|j| file.description.joints[j].encoder.map(|e| (j, e)))
            .map(|(j, e)| device.row[j].abs() * std::f64::consts::TAU / e.counts_per_turn.abs())
            .sum();

        let before = board.rules()?;
        let mut rules = before;
        if before.host_action != HostAction::Disarm || before.host_seconds > HOST_SECONDS {
            (rules.host_action, rules.host_seconds) = (HostAction::Disarm, HOST_SECONDS);
        }
        for limit in &mut rules.limits.torque {
            *limit = limit.min(setup.torque_limit as f32);
        }
        let strongest = rules.limits.torque[..spec.joints].iter().copied().fold(f32::INFINITY, f32::min);
        board.set_rules(&rules)?;
        board.set_scene(&scene(&setup, &tip, &normal, &across, spec.task)?)?;

        let mut bench = Self {
            board,
            interrupted,
            q,
            tip,
            normal,
            force_limit: f64::from(strongest) / lever,
            holding,
            hold_frequency,
            quantum,
            divider: (setup.rate_hz / 10_000.0).ceil().max(1.0) as u32,
            setup,
            before,
        };
        bench.board.keep_alive();
        bench.hold(0.0)?;
        bench.board.arm()?;
        let request = fields("tip,state").map_err(MeasureError::Scene)?;
        bench.board.start_stream(request, bench.divider)?;
        // Torque ramps up over half a second after arming.
        bench.wait(0.6)?;
        bench.rest(0.0, 0.0)?;
        Ok(bench)
    }

    /// Joint angles where the measurement takes place, rad.
    pub fn pose(&self) -> &[f64] {
        &self.q
    }

    /// The stiffness at which a search begins: the soft hold's own, N/m.
    pub fn gentle_stiffness(&self) -> f64 {
        self.holding[0].0
    }

    /// The damping at which a search begins, N s/m.
    pub fn gentle_damping(&self) -> f64 {
        self.holding[0].1
    }

    /// Whether a wall of this stiffness and damping oscillates. `strength` scales and signs the excitation (1 or a
    /// little less).
    pub fn oscillates(
        &mut self,
        feed_forward: FeedForward,
        kp: f64,
        kd: f64,
        strength: f64,
    ) -> Result<bool, MeasureError> {
        let hardest = kp.max(kd * self.hold_frequency).max(self.gentle_stiffness());
        // Less than a few encoder steps would be no excitation; the motors then saturate, within the torque limit.
        let pull = self.setup.largest_pull.min(0.15 * self.force_limit / hardest).max(6.0 * self.quantum);
        let pull = strength * pull.min(0.5 * APART);
        let mut trips = 0;
        loop {
            match self.swing_from_rest(feed_forward, pull) {
                // What an oscillation before left behind tripped the guard: it is over now.
                Err(MeasureError::Fault(fault)) if violent(fault) && trips < 3 => {
                    trips += 1;
                    self.arm_again()?;
                }
                other => break other?,
            }
        }
        let verdict = self.watch(feed_forward, kp, kd, pull);
        // Back off at once, whatever came out.
        self.hold(0.0)?;
        match verdict {
            // The guard was quicker than the telemetry: an oscillation that violent is one.
            Err(MeasureError::Fault(fault)) if violent(fault) => {
                self.arm_again()?;
                Ok(true)
            }
            verdict => Ok(verdict? == Verdict::Grows),
        }
    }

    fn swing_from_rest(&mut self, feed_forward: FeedForward, pull: f64) -> Result<(), MeasureError> {
        let rested = self.rest(pull, 3.0 * self.quantum)?;
        self.swing_back(feed_forward, pull, rested)
    }

    /// Clears the fault that a violent oscillation tripped, and arms with the soft hold.
    fn arm_again(&mut self) -> Result<(), MeasureError> {
        self.board.clear()?;
        self.board.arm()?;
        // Rows from before the fault was cleared still tell of it.
        let until = self.board.now() + Duration::from_secs_f64(0.3);
        while self.board.now() < until {
            self.board.rows(Duration::from_millis(20))?;
        }
        self.wait(0.4)
    }

    /// Motors off.
    pub fn finish(self) -> Result<(), MeasureError> {
        self.board.stop_stream()?;
        self.board.disarm()?;
        Ok(())
    }

    fn gains(&mut self, wall: u8, kp: f64, kd: f64, feed_forward: FeedForward) -> Result<(), MeasureError> {
        let gains = Gains {
            wall,
            stiffness: kp as f32,
            damping: kd as f32,
            feed_forward,
            washout_hz: self.setup.washout_hz as f32,
        };
        Ok(self.board.set_wall_gains(gains)?)
    }

    /// Holds the tip `pull` metres along the normal from where it was: the tested wall and the one beside it share the
    /// stiffness.
    fn hold(&mut self, pull: f64) -> Result<(), MeasureError> {
        let (kp, kd) = self.holding[0];
        let share = (pull / APART).clamp(-0.9, 0.9);
        self.gains(TESTED, kp * (1.0 - share.abs()), kd, FeedForward::Off)?;
        // The wall beside lies at +APART or -APART; only one is used, by the sign of the pull.
        let [used, unused] = if pull >= 0.0 { ASIDE } else { [ASIDE[1], ASIDE[0]] };
        self.gains(unused, 0.0, 0.0, FeedForward::Off)?;
        self.gains(used, kp * share.abs(), 0.0, FeedForward::Off)?;
        for (index, (kp, kd)) in self.holding.clone().into_iter().skip(1).enumerate() {
            self.gains(ACROSS + index as u8, kp, kd, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Lets go of everything but the tested wall.
    fn release(&mut self) -> Result<(), MeasureError> {
        for wall in ASIDE {
            self.gains(wall, 0.0, 0.0, FeedForward::Off)?;
        }
        for index in 0..self.holding.len() - 1 {
            self.gains(ACROSS + index as u8, 0.0, 0.0, FeedForward::Off)?;
        }
        Ok(())
    }

    /// Waits until the tip rests near `pull`, along the normal and across it; returns where it rests.
    fn rest(&mut self, pull: f64, tolerance: f64) -> Result<f64, MeasureError> {
        self.hold(pull)?;
        let period = std::f64::consts::TAU / self.hold_frequency;
        let tolerance = tolerance.max(0.1 * pull.abs()).max(self.setup.largest_pull * 1e-3);
        let mut quiet = Vec::new();
        let started = self.board.now();
        // Friction may hold the tip off its place: then it rests, but elsewhere.
        while (self.board.now() - started).as_secs_f64() < (60.0 * period).max(0.5) {
            for at in self.places(period / 4.0)? {
                quiet.push(at);
            }
            let window = self.samples_in(0.5 * period);
            if quiet.len() > 4 * window {
                let recent = &quiet[quiet.len() - window..];
                let (low, high) = span(recent.iter().map(|at| at.place));
                let (near, far) = span(recent.iter().map(|at| at.aside));
                // What slides across when the trial lets go of it would go on sliding.
                if high - low <= tolerance && far - near <= tolerance {
                    return Ok((high + low) / 2.0);
                }
            }
        }
        Err(MeasureError::Restless)
    }

    /// Pulls back towards the tested wall and returns when the tip is on its way.
    ///
    /// With the feed-forward that is tested: without it the pull would set the admissible directions moving, and with
    /// it nothing would stop them again.
    fn swing_back(&mut self, feed_forward: FeedForward, pull: f64, rested: f64) -> Result<(), MeasureError> {
        let (kp, _) = self.holding[0];
        self.release()?;
        self.gains(TESTED, kp, 0.0, feed_forward)?;
        let started = self.board.now();
        let quarter = 0.5 * std::f64::consts::PI / self.hold_frequency;
        let aim = 0.5 * rested;
        while (self.board.now() - started).as_secs_f64() < quarter {
            let latest = self.places(quarter / 8.0)?;
            if latest.iter().any(|at| (at.place - aim) * pull.signum() < 0.0) {
                break;
            }
        }
        Ok(())
    }

    /// Hands the moving tip to the tested gains and follows it until the verdict.
    fn watch(&mut self, feed_forward: FeedForward, kp: f64, kd: f64, pull: f64) -> Result<Verdict, MeasureError> {
        self.gains(TESTED, kp, kd, feed_forward)?;
        let row_seconds = f64::from(self.divider) / self.setup.rate_hz;
        let mut swing = Swing::new(row_seconds, self.quantum, pull.abs());
        let first = self.board.status()?.step;
        loop {
            for at in self.places(0.02)? {
                // Rows from before the hand-over were still on their way.
                if at.step.wrapping_sub(first) > u32::MAX / 2 {
                    continue;
                }
                if let Some(verdict) = swing.take(at.place) {
                    return Ok(verdict);
                }
            }
        }
    }

    fn samples_in(&self, seconds: f64) -> usize {
        (seconds * self.setup.rate_hz / f64::from(self.divider)).ceil().max(4.0) as usize
    }

    fn wait(&mut self, seconds: f64) -> Result<(), MeasureError> {
        let until = self.board.now() + Duration::from_secs_f64(seconds);
        while self.board.now() < until {
            self.places(0.05)?;
        }
        Ok(())
    }

    /// Where the tip was, as far as rows have come, waiting at most `seconds` for the first.
    fn places(&mut self, seconds: f64) -> Result<Vec<Place>, MeasureError> {
        if (self.interrupted)() {
            return Err(MeasureError::Interrupted);
        }
        let rows = self.board.rows(Duration::from_secs_f64(seconds.clamp(1e-4, 0.1)))?;
        let task = self.tip.len();
        let mut places = Vec::with_capacity(rows.len());
        for row in rows {
            // The tip has one column per joint, then come state and contacts.
            let state = row.values[row.values.len() - 2];
            if state == f64::from(State::Fault as u8) {
                // The record names it; without one the numbers themselves were no good.
                let fault = self.board.status()?.fault.map_or(Fault::NotFinite, |record| record.fault);
                return Err(MeasureError::Fault(fault));
            }
            let off = DVector::from_fn(task, |i, _| row.values[i] - self.tip[i]);
            let place = off.dot(&self.normal);
            places.push(Place { step: row.step, place, aside: (off - &self.normal * place).norm() });
        }
        Ok(places)
    }
}

impl Drop for Bench<'_> {
    fn drop(&mut self) {
        // The board may be gone; the rules set for the measurement then take the motors off.
        let _ = self.board.disarm();
        let _ = self.board.set_rules(&self.before);
    }
}

/// Where the tip was at a step: along the normal and how far beside it, m.
struct Place {
    step: u32,
    place: f64,
    aside: f64,
}

/// Smallest and largest.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Faults that an oscillation trips and that pass with it.
fn violent(fault: Fault) -> bool {
    matches!(fault, Fault::SpeedLimit | Fault::OverCurrent | Fault::PowerLimit)
}

/// Unit vectors across a normal.
fn complement(normal: &DVector<f64>) -> Vec<DVector<f64>> {
    match normal.len() {
        2 => vec![DVector::from_vec(vec![-normal[1], normal[0]])],
        3 => {
            let k = normal.iamin();
            let mut first = DVector::zeros(3);
            first[k] = 1.0;
            first -= normal * normal[k];
            first.normalize_mut();
            let second = normal.cross(&first);
            vec![first, second]
        }
        _ => Vec::new(),
    }
}

/// The scene of a measurement, its walls without gains yet.
fn scene(
    setup: &Setup,
    tip: &DVector<f64>,
    normal: &DVector<f64>,
    across: &[DVector<f64>],
    task: usize,
) -> Result<Scene<f32>, MeasureError> {
    let mut scene = Scene {
        task: task as u8,
        rate_hz: setup.rate_hz as f32,
        cutoff_hz: setup.cutoff_hz as f32,
        velocity_terms: VelocityTerms::Off,
        ..Scene::default()
    };
    let padded = |v: &DVector<f64>| -> [f32; 3] { core::array::from_fn(|i| v.get(i).map_or(0.0, |v| *v as f32)) };
    let aside = [tip + normal * APART, tip - normal * APART];
    let places = std::iter::once((tip, normal))
        .chain(aside.iter().map(|point| (point, normal)))
        .chain(across.iter().map(|direction| (tip, direction)));
    for (point, direction) in places {
        let wall = Wall {
            surface: Surface::Plane(Plane { point: padded(point), normal: padded(direction) }),
            stiffness: 0.0,
            damping: 0.0,
            feed_forward: FeedForward::Off,
            washout_hz: setup.washout_hz as f32,
            damping_compensation: false,
            bilateral: true,
        };
        scene.walls.push(wall).map_err(|_| MeasureError::Scene("too many walls".into()))?;
    }
    Ok(scene)
}
