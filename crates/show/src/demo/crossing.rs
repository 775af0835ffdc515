//! A hand that presses onto the wall and slides along it.

use super::{Demo, DemoError};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::{FeedForward, Scene, Wall};
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Row, columns, fields};
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, Waypoint, ready_board};
use std::time::Duration;

/// Height above the wall at which the hand starts, m.
const START_HEIGHT: f64 = 0.006;
/// Target depth of the hand below the wall's surface, m, at which its arm of 250 N/m presses with about 5 N.
const TARGET_DEPTH: f64 = 0.02;
/// Length of the slide, m: it ends before the device's distal links become collinear.
pub const SLIDE_DISTANCE: f64 = 0.02;
/// Time at which the hand starts to move, s after arming, when the torque ramp is over.
const START_TIME: f64 = 0.6;
/// Time at which the hand reaches its target depth, s.
pub(crate) const DEPTH_TIME: f64 = 0.85;
/// Time at which the hand starts to slide, s.
const SLIDE_START: f64 = 1.4;
/// Time at which the slide ends, s.
const SLIDE_END: f64 = 2.4;
/// Time at which the crossing ends with the hand lifted, s.
const END_TIME: f64 = 2.9;

/// Durations without, with and without the feed-forward in `view::world::press_while_switching`, s.
pub const PHASES: [f64; 3] = [0.25, 0.35, 0.6];

/// One sample of a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time since the hand started to move, s.
    pub time: f64,
    /// Distance to the wall, m; negative inside.
    pub distance: f64,
    /// The wall's force, N.
    pub force: f64,
    /// True if a wall is touched.
    pub touching: bool,
}

/// Result of a crossing.
#[derive(Clone, Debug, PartialEq)]
pub struct Crossing {
    /// One entry for each control step.
    pub moments: Vec<Moment>,
    /// Deepest penetration, m.
    pub penetration: f64,
    /// Largest force of the wall, N.
    pub peak_force: f64,
    /// Deviation of the wall's force from its mean while the hand rests on the wall, N rms.
    pub ripple: f64,
    /// Number of contact losses: falls of the wall's force to zero between touch and lift.
    pub bounces: usize,
    /// Number of lost telemetry rows.
    pub lost: u64,
    /// The fault that the board latched; `None` without one.
    pub fault: Option<String>,
}

/// Tremor of the simulated hand, m, which excites the oscillation of an unstable wall.
const TREMOR: f64 = 2e-4;

/// Returns the settings of the hand that presses the wall, also on the page.
pub fn hand_settings() -> HandSettings {
    HandSettings { tremor: TREMOR, ..HandSettings::default() }
}

/// Lets the hand cross the wall. Calls `progress` with the completed share of the crossing.
pub fn run(demo: &Demo, feed_forward: FeedForward, progress: &mut dyn FnMut(f64)) -> Result<Crossing, DemoError> {
    let device = Options { start: Some(demo.pose), ..Options::default() };
    let shared = SharedBoard::new(ready_board(&demo.file, BoardOptions { device, ..BoardOptions::default() })?);
    let mut board = Board::over(shared.wire(), "sim")?;
    let tip = shared.lock().device().tip();
    let surface = [tip[0] - START_HEIGHT * demo.normal[0], tip[1] - START_HEIGHT * demo.normal[1]];
    let scene = demo.scene(surface, feed_forward);
    board.set_scene(&scene)?;
    let (moments, lost, fault) = press(&mut board, &shared, &scene, hand_path(demo, tip), &[], END_TIME, progress)?;
    Ok(assess(moments, lost, fault))
}

/// Lets the hand follow a path until `end` (s after arming) and sets each of the `modes` of the feed-forward at its
/// time. Returns the moments, the number of lost rows and the fault.
pub(crate) fn press(
    board: &mut Board,
    shared: &SharedBoard,
    scene: &Scene<f32>,
    path: Vec<Waypoint>,
    modes: &[(f64, FeedForward)],
    end: f64,
    progress: &mut dyn FnMut(f64),
) -> Result<(Vec<Moment>, u64, Option<String>), DemoError> {
    // The board watches its host, and turns the motors off if it receives nothing.
    board.keep_alive();
    {
        let mut board = shared.lock();
        let (now, tip) = (board.time(), board.device().tip());
        board.device_mut().set_hand(Hand::new(hand_settings(), Intent::Follow(path), tip, now));
    }
    board.arm()?;
    let selected = fields("distance,force,state").unwrap_or(haptic_bridge::board::telemetry::Fields::ALL);
    board.start_stream(selected, 1)?;
    let mut rows = Vec::new();
    let rate_hz = f64::from(scene.rate_hz);
    let steps = (end * rate_hz) as usize;
    let mut modes = modes.iter().peekable();
    while rows.len() < steps {
        rows.extend(board.rows(Duration::from_millis(50))?);
        if let Some((_, feed_forward)) = modes.next_if(|(time, _)| rows.len() as f64 >= time * rate_hz) {
            let Wall { stiffness, damping, washout_hz, .. } = scene.walls[0];
            board.set_wall_gains(Gains { wall: 0, stiffness, damping, feed_forward: *feed_forward, washout_hz })?;
        }
        progress((rows.len() as f64 / steps as f64).min(1.0));
    }
    board.stop_stream()?;
    let status = board.status()?;
    let fault = status.fault.map(|record| record.fault.to_string());
    if status.state == State::Armed {
        board.disarm()?;
    }
    let lost = board.losses().missing;
    let units = board.device()?.map(|device| device.mechanism.units()).unwrap_or_default();
    Ok((moments_of_rows(&rows, &columns(selected, &units, 0), rate_hz), lost, fault))
}

/// Returns the hand's path: down, rest, along, rest, up.
fn hand_path(demo: &Demo, tip: [f64; 3]) -> Vec<Waypoint> {
    let [nx, ny] = demo.normal;
    let at = |time: f64, up: f64, along: f64| Waypoint {
        time,
        value: [tip[0] + up * nx - along * ny, tip[1] + up * ny + along * nx, 0.0],
    };
    let down = -START_HEIGHT - TARGET_DEPTH;
    vec![
        at(START_TIME, 0.0, 0.0),
        at(DEPTH_TIME, down, 0.0),
        at(SLIDE_START, down, 0.0),
        at(SLIDE_END, down, SLIDE_DISTANCE),
        at(SLIDE_END + 0.2, down, SLIDE_DISTANCE),
        at(END_TIME, 0.0, SLIDE_DISTANCE),
    ]
}

fn moments_of_rows(rows: &[Row], columns: &[haptic_host::link::Column], rate_hz: f64) -> Vec<Moment> {
    let first = rows.first().map_or(0, |row| row.step);
    let value = |row: &Row, field: Field, axis: usize| {
        let index = columns.iter().position(|column| column.field == field && column.axis == axis);
        index.and_then(|index| row.values.get(index)).copied().unwrap_or(0.0)
    };
    rows.iter()
        .map(|row| Moment {
            time: f64::from(row.step.wrapping_sub(first)) / rate_hz - START_TIME,
            distance: value(row, Field::Distance, 0),
            force: value(row, Field::WallForce, 0),
            touching: value(row, Field::State, 1) > 0.0,
        })
        .filter(|moment| moment.time >= 0.0)
        .collect()
}

fn assess(moments: Vec<Moment>, lost: u64, fault: Option<String>) -> Crossing {
    let largest = |pick: fn(&Moment) -> f64| moments.iter().map(pick).fold(0.0, f64::max);
    let resting: Vec<f64> = moments
        .iter()
        .filter(|moment| (DEPTH_TIME + 0.15 - START_TIME..SLIDE_END - START_TIME).contains(&moment.time))
        .map(|moment| moment.force)
        .collect();
    let first_contact = moments.iter().position(|moment| moment.touching);
    let pressed = moments
        .iter()
        .take_while(|moment| moment.time < SLIDE_END + 0.2 - START_TIME)
        .skip(first_contact.unwrap_or(usize::MAX));
    let contact: Vec<bool> = pressed.map(|moment| moment.force > 0.0).collect();
    Crossing {
        penetration: largest(|moment| -moment.distance),
        peak_force: largest(|moment| moment.force),
        ripple: ripple_about_moving_mean(&resting),
        bounces: contact.windows(2).filter(|pair| pair[0] && !pair[1]).count(),
        moments,
        lost,
        fault,
    }
}

/// Computes the root mean square deviation from a moving mean over 21 steps (20 steps wide), because slow changes of
/// the force are not ripple.
pub(super) fn ripple_about_moving_mean(force: &[f64]) -> f64 {
    const HALF_WINDOW: usize = 10;
    if force.len() <= 2 * HALF_WINDOW {
        return 0.0;
    }
    let deviations = force.windows(2 * HALF_WINDOW + 1).map(|window| {
        let mean = window.iter().sum::<f64>() / window.len() as f64;
        (window[HALF_WINDOW] - mean).powi(2)
    });
    let count = force.len() - 2 * HALF_WINDOW;
    (deviations.sum::<f64>() / count as f64).sqrt()
}
