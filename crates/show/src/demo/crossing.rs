//! A hand that presses onto the wall and slides along it.

use super::{Demo, DemoError};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::render::scene::FeedForward;
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
const DEPTH_TIME: f64 = 0.85;
/// Time at which the hand starts to slide, s.
const SLIDE_START: f64 = 1.4;
/// Time at which the slide ends, s.
const SLIDE_END: f64 = 2.4;
/// Time at which the crossing ends with the hand lifted, s.
const END_TIME: f64 = 2.9;

/// One sample of a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time since the hand started to move, s.
    pub time: f64,
    /// Distance to the wall, m; negative inside.
    pub distance: f64,
    /// The wall's force, N.
    pub force: f64,
    /// Largest |duty| of any axis.
    pub duty: f64,
    /// True if the tip touches a wall.
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

/// Lets the hand cross the wall. Calls `progress` with the completed share of the crossing.
pub fn run(demo: &Demo, feed_forward: FeedForward, progress: &mut dyn FnMut(f64)) -> Result<Crossing, DemoError> {
    let device = Options { start: Some(demo.pose), ..Options::default() };
    let shared = SharedBoard::new(ready_board(&demo.file, BoardOptions { device, ..BoardOptions::default() })?);
    let mut board = Board::over(shared.wire(), "sim")?;
    // The board watches its host, and turns the motors off if it receives nothing.
    board.keep_alive();
    let tip = shared.lock().device().tip();
    let surface = [tip[0] - START_HEIGHT * demo.normal[0], tip[1] - START_HEIGHT * demo.normal[1]];
    board.set_scene(&demo.scene(surface, feed_forward))?;
    {
        let mut board = shared.lock();
        let now = board.time();
        let settings = HandSettings { tremor: 2e-4, seed: demo.seed, ..HandSettings::default() };
        board.device_mut().set_hand(Hand::new(settings, Intent::Follow(hand_path(demo, tip)), tip, now));
    }
    board.arm()?;
    let selected = fields("duty,distance,force,state").unwrap_or(haptic_bridge::board::telemetry::Fields::ALL);
    board.start_stream(selected, 1)?;
    let mut rows = Vec::new();
    let steps = (END_TIME * demo.rate_hz) as usize;
    while rows.len() < steps {
        rows.extend(board.rows(Duration::from_millis(50))?);
        progress((rows.len() as f64 / steps as f64).min(1.0));
    }
    board.stop_stream()?;
    let status = board.status()?;
    let fault = status.fault.map(|record| record.fault.to_string());
    if status.state == State::Armed {
        board.disarm()?;
    }
    let lost = board.losses().missing;
    let axes = demo.file.spec().joints;
    Ok(assess(moments_of_rows(&rows, &columns(selected, axes), demo.rate_hz), lost, fault))
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
            duty: (0..3).map(|axis| value(row, Field::Duty, axis).abs()).fold(0.0, f64::max),
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
        ripple: detrended_rms(&resting),
        bounces: contact.windows(2).filter(|pair| pair[0] && !pair[1]).count(),
        moments,
        lost,
        fault,
    }
}

/// Computes the rms deviation from a moving mean over 21 samples, because slow force changes are not ripple.
fn detrended_rms(force: &[f64]) -> f64 {
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
