//! A hand that presses onto the wall and slides along it.

use super::{Demo, DemoError};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Row, columns, fields};
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, Waypoint, ready_board};
use std::time::Duration;

/// Height above the wall at which the hand begins, m.
const ABOVE: f64 = 0.006;
/// Depth below the wall's surface at which the hand aims, m: its arm's 250 N/m then press with about 5 N.
const AIM: f64 = 0.02;
/// Distance that it slides, m: short of where the device's distal links come in line.
pub const SLIDE: f64 = 0.02;
/// When the hand begins to move (the torque's ramp after arming is over), s after arming.
const BEGIN: f64 = 0.6;
/// When it has come to its aim.
const PRESSED: f64 = 0.85;
/// When it begins to slide.
const SLIDING: f64 = 1.4;
/// When it has slid.
const SLID: f64 = 2.4;
/// When it has been lifted again, which ends the crossing.
const LIFTED: f64 = 2.9;

/// One moment of a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Since the hand began to move, s.
    pub time: f64,
    /// Distance to the wall, m; negative inside.
    pub distance: f64,
    /// The wall's force, N.
    pub force: f64,
    /// Largest |duty| of any axis.
    pub duty: f64,
    /// Walls touched.
    pub touching: bool,
}

/// Result of a crossing.
#[derive(Clone, Debug, PartialEq)]
pub struct Crossing {
    /// Every control step.
    pub moments: Vec<Moment>,
    /// Deepest penetration, m.
    pub penetration: f64,
    /// Largest force of the wall, N.
    pub peak_force: f64,
    /// Deviation of the wall's force from its mean while the hand rests on the wall, N rms.
    pub ripple: f64,
    /// Times the wall's force fell to zero between touching and lifting: the hand feels it let go.
    pub bounces: usize,
    /// Rows of telemetry lost.
    pub lost: u64,
    /// The fault that the board tripped, if any.
    pub fault: Option<String>,
}

/// Lets the hand cross the wall. `progress` is called with the share done.
pub fn run(demo: &Demo, feed_forward: FeedForward, progress: &mut dyn FnMut(f64)) -> Result<Crossing, DemoError> {
    let device = Options { start: Some(demo.pose), ..Options::default() };
    let shared = SharedBoard::new(ready_board(&demo.file, BoardOptions { device, ..BoardOptions::default() })?);
    let mut board = Board::over(shared.wire(), "sim")?;
    // The board watches its host, and lets go of the device under the hand if it is not heard.
    board.keep_alive();
    let tip = shared.lock().device().tip();
    let surface = [tip[0] - ABOVE * demo.normal[0], tip[1] - ABOVE * demo.normal[1]];
    board.set_scene(&demo.scene(surface, feed_forward))?;
    {
        let mut board = shared.lock();
        let now = board.time();
        let settings = HandSettings { tremor: 2e-4, seed: demo.seed, ..HandSettings::default() };
        board.device_mut().set_hand(Hand::new(settings, Intent::Follow(path(demo, tip)), tip, now));
    }
    board.arm()?;
    let chosen = fields("duty,distance,force,state").unwrap_or(haptic_bridge::board::telemetry::Fields::ALL);
    board.start_stream(chosen, 1)?;
    let mut rows = Vec::new();
    let steps = (LIFTED * demo.rate_hz) as usize;
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
    Ok(assess(moments(&rows, &columns(chosen, axes), demo.rate_hz), lost, fault))
}

/// Down, rest, along, rest, up.
fn path(demo: &Demo, tip: [f64; 3]) -> Vec<Waypoint> {
    let [nx, ny] = demo.normal;
    let at = |time: f64, up: f64, along: f64| Waypoint {
        time,
        value: [tip[0] + up * nx - along * ny, tip[1] + up * ny + along * nx, 0.0],
    };
    let down = -ABOVE - AIM;
    vec![
        at(BEGIN, 0.0, 0.0),
        at(PRESSED, down, 0.0),
        at(SLIDING, down, 0.0),
        at(SLID, down, SLIDE),
        at(SLID + 0.2, down, SLIDE),
        at(LIFTED, 0.0, SLIDE),
    ]
}

fn moments(rows: &[Row], columns: &[haptic_host::link::Column], rate_hz: f64) -> Vec<Moment> {
    let first = rows.first().map_or(0, |row| row.step);
    let one = |row: &Row, wanted: Field, axis: usize| {
        let place = columns.iter().position(|column| column.field == wanted && column.axis == axis);
        place.and_then(|place| row.values.get(place)).copied().unwrap_or(0.0)
    };
    rows.iter()
        .map(|row| Moment {
            time: f64::from(row.step.wrapping_sub(first)) / rate_hz - BEGIN,
            distance: one(row, Field::Distance, 0),
            force: one(row, Field::WallForce, 0),
            duty: (0..3).map(|axis| one(row, Field::Duty, axis).abs()).fold(0.0, f64::max),
            touching: one(row, Field::State, 1) > 0.0,
        })
        .filter(|moment| moment.time >= 0.0)
        .collect()
}

fn assess(moments: Vec<Moment>, lost: u64, fault: Option<String>) -> Crossing {
    let largest = |value: fn(&Moment) -> f64| moments.iter().map(value).fold(0.0, f64::max);
    let resting: Vec<f64> = moments
        .iter()
        .filter(|moment| (PRESSED + 0.15 - BEGIN..SLID - BEGIN).contains(&moment.time))
        .map(|moment| moment.force)
        .collect();
    let touched = moments.iter().position(|moment| moment.touching);
    let held = moments.iter().take_while(|moment| moment.time < SLID + 0.2 - BEGIN).skip(touched.unwrap_or(usize::MAX));
    let contact: Vec<bool> = held.map(|moment| moment.force > 0.0).collect();
    Crossing {
        penetration: largest(|moment| -moment.distance),
        peak_force: largest(|moment| moment.force),
        ripple: ripple(&resting),
        bounces: contact.windows(2).filter(|pair| pair[0] && !pair[1]).count(),
        moments,
        lost,
        fault,
    }
}

/// Root mean square of what lies within 20 steps of change: slow changes of the push are not ripple.
fn ripple(force: &[f64]) -> f64 {
    const HALF: usize = 10;
    if force.len() <= 2 * HALF {
        return 0.0;
    }
    let deviations = force.windows(2 * HALF + 1).map(|window| {
        let mean = window.iter().sum::<f64>() / window.len() as f64;
        (window[HALF] - mean).powi(2)
    });
    let count = force.len() - 2 * HALF;
    (deviations.sum::<f64>() / count as f64).sqrt()
}
