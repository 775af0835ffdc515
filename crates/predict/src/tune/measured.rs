//! Tests settings on the simulated board, with the firmware's step, protocol, bridges, friction and encoder steps.

use super::{Question, Settings};
use crate::contact::RippleFilter;
use crate::measure::simulated::World;
use crate::measure::{Law, MeasureError, MeasurementSetup, PreparedBoard, complement};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::{Plane, Scene, Surface, Wall};
use haptic_host::error::Failure;
use haptic_host::link::{Board, fields};
use haptic_host::vectors::padded;
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, Waypoint, ready_board};
use haptic_stability::analysis::several::Member;
use haptic_stability::sweep::Sweep;
use serde::Serialize;
use std::time::Duration;

/// Depth of the hand's target, m. At this depth its stiffness of 250 N/m pushes with 3 N.
const TARGET_DEPTH: f64 = 0.012;
/// Distance that the hand slides, m.
const SLIDE_DISTANCE: f64 = 0.02;
const SETTLE_S: f64 = 1.5;
const RECORD_S: f64 = 1.0;
/// Smallest mean force of a wall that holds the hand, N.
const LEAST_HELD_FORCE: f64 = 1.0;
/// Torque limit of the measurement, N m, as in `haptic measure-range`.
const TORQUE_LIMIT: f64 = 1.0;
/// Longest pull of the measurement, m, as in `haptic measure-range`.
const MAX_PULL: f64 = 0.5e-3;
/// Frequency of the hold between trials, Hz, at which the hold is soft with any encoder.
const HOLD_HZ: f64 = 40.0;

/// Results of measurements on the simulated board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredWall {
    /// Largest stiffness at which the tip came to rest after a pull, N/m, at the settings' damping.
    pub stiffness: f64,
    /// Reason why the boundary may be higher; `None` if the boundary was found.
    pub open: Option<String>,
    /// Root mean square of the force above 20 Hz under a sliding hand, N; `None` if the hand is not held.
    pub ripple_n: Option<f64>,
}

/// Measures the largest stable stiffness on a simulated board, and simulates the ripple at the settings' stiffness.
pub fn measure(question: &Question<'_>, settings: &Settings, sweep: &Sweep) -> Result<MeasuredWall, Failure> {
    let result = boundary(question, settings, &|| sweep.check_interrupted().is_err());
    sweep.check_interrupted()?;
    let (stiffness, open) = match result {
        Ok(stiffness) => (stiffness, None),
        Err(MeasureError::Open { stable, why }) => (stable, Some(why.to_string())),
        Err(error) if error.is_local() => (0.0, Some(error.to_string())),
        Err(error) => return Err(Failure::impossible(error)),
    };
    Ok(MeasuredWall { stiffness, open, ripple_n: ripple(question, settings, sweep)? })
}

fn boundary(question: &Question<'_>, settings: &Settings, stop: &dyn Fn() -> bool) -> Result<f64, MeasureError> {
    let world = World { q: Some(padded(&question.q)), ..World::default() };
    let shared =
        world.board(question.file, settings.rate_hz).map_err(|error| MeasureError::Scene(error.to_string()))?;
    let mut board = Board::over(shared.wire(), "sim")?;
    let setup = MeasurementSetup {
        walls: vec![Member::new(question.normal.clone(), 1.0)],
        rate_hz: settings.rate_hz,
        cutoff_hz: settings.cutoff_hz,
        washout_hz: settings.washout_hz,
        law: Law {
            estimator: settings.kind,
            damping_compensation: settings.damping_compensation,
            admissible: question.admissible,
            hold_hz: HOLD_HZ,
            ..Law::default()
        },
        torque_limit: TORQUE_LIMIT,
        largest_pull: MAX_PULL,
    };
    let mut prepared = PreparedBoard::new(&mut board, question.file, setup, stop)?;
    let result = prepared.boundary(settings.feed_forward, settings.damping, 1.0, None)?.gain;
    prepared.finish()?;
    Ok(result)
}

/// Returns a scene of one wall with these settings; `point` (m) is on its surface.
#[must_use]
pub fn scene(question: &Question<'_>, settings: &Settings, point: &[f64]) -> Scene<f64> {
    let wall = Wall {
        surface: Surface::Plane(Plane { point: padded(point), normal: padded(&question.normal) }),
        stiffness: settings.stiffness,
        damping: settings.damping,
        feed_forward: settings.feed_forward,
        washout_hz: settings.washout_hz,
        damping_compensation: settings.damping_compensation,
        bilateral: false,
    };
    Scene {
        task: question.normal.len() as u8,
        rate_hz: settings.rate_hz,
        cutoff_hz: settings.cutoff_hz,
        estimator: settings.kind,
        admissible: question.admissible,
        walls: [wall].into_iter().collect(),
        ..Scene::default()
    }
}

/// Simulates the ripple of the wall's force on the board, N; returns `None` if the wall does not hold the hand.
pub fn ripple(question: &Question<'_>, settings: &Settings, sweep: &Sweep) -> Result<Option<f64>, Failure> {
    let device = Options { start: Some(padded(&question.q)), ..Options::default() };
    let mut simulated = ready_board(question.file, BoardOptions { device, ..BoardOptions::default() })
        .map_err(|error| Failure::wrong(format!("{}: {error}", question.file.path.display())))?;
    let tip = simulated.device().tip();
    let task = question.normal.len();
    // A board does not arm inside a wall, so the surface is slightly beyond the tip and the hand moves there.
    let point: Vec<f64> = (0..task).map(|i| tip[i] - 2e-4 * question.normal[i]).collect();
    let normal = nalgebra::DVector::from_column_slice(&question.normal);
    let across = complement(&normal).first().map_or([0.0; MAX_JOINTS], |across| padded(across.as_slice()));
    let n: [f64; MAX_JOINTS] = padded(&question.normal);
    let aim = |depth: f64, along: f64| core::array::from_fn(|i| tip[i] - depth * n[i] + along * across[i]);
    let intent = Intent::Follow(vec![
        Waypoint { time: 0.0, value: tip },
        Waypoint { time: 0.7, value: tip },
        Waypoint { time: 1.0, value: aim(TARGET_DEPTH, 0.0) },
        Waypoint { time: SETTLE_S, value: aim(TARGET_DEPTH, 0.0) },
        Waypoint { time: SETTLE_S + RECORD_S, value: aim(TARGET_DEPTH, SLIDE_DISTANCE) },
    ]);
    simulated.device_mut().set_hand(Hand::new(HandSettings::default(), intent, tip, 0.0));
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim")?;
    board.set_scene(&scene(question, settings, &point).cast())?;
    board.keep_alive();
    board.arm()?;
    let wanted = fields("force").map_err(Failure::impossible)?;
    let divider = (settings.rate_hz / 10_000.0).ceil().max(1.0) as u32;
    let begun = board.now();
    let settled = begun + Duration::from_secs_f64(SETTLE_S);
    while board.now() < settled {
        sweep.check_interrupted()?;
        board.rows(Duration::from_millis(20))?;
    }
    board.start_stream(wanted, divider)?;
    let mut forces = Vec::new();
    let end = board.now() + Duration::from_secs_f64(RECORD_S);
    while board.now() < end {
        sweep.check_interrupted()?;
        for row in board.rows(Duration::from_millis(20))? {
            forces.extend(row.get(Field::WallForce));
        }
    }
    board.stop_stream()?;
    let faulted = board.status()?.fault.is_some();
    board.disarm()?;
    if forces.is_empty() || faulted {
        return Ok(None);
    }
    let row_hz = settings.rate_hz / f64::from(divider);
    // The filter's trend needs a tenth of a second to settle.
    let from = (0.1 * row_hz) as usize;
    let mean = forces.iter().sum::<f64>() / forces.len() as f64;
    let mut fast = RippleFilter::new(row_hz);
    let square = forces.iter().map(|force| fast.filter(*force).powi(2)).skip(from).sum::<f64>();
    Ok((mean > LEAST_HELD_FORCE && forces.len() > from).then(|| (square / (forces.len() - from) as f64).sqrt()))
}
