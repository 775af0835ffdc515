//! Measures the stable range of walls on a board.

use crate::arrays::{array, list, rows};
use crate::board::Board;
use crate::device::{PyDevice, parse_word};
use crate::errors::{self, ImpossibleError, RequestError, failure};
use haptic_host::device_file::DeviceFile;
use haptic_host::haptic_bridge::model::admissible::Admissible;
use haptic_host::haptic_bridge::model::device::Device as DeviceData;
use haptic_host::haptic_bridge::render::scene::FeedForward;
use haptic_host::link::Board as HostBoard;
use haptic_predict::measure::board_measurement::{self, BoardMeasurement};
use haptic_predict::measure::campaign::Plan;
use haptic_predict::measure::progress::{Point, Progress};
use haptic_predict::measure::simulated::{Friction, World};
use haptic_predict::measure::{Law, MeasureError, MeasurementSetup, max_tested_walls};
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::sampled::Loop;
use haptic_stability::analysis::several::{Member, WallSet};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::cell::{Cell, OnceCell};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Interval between checks for Ctrl-C.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// The arguments of a measurement.
struct MeasurementRequest {
    file: DeviceFile,
    setup: MeasurementSetup,
    plan: Plan,
    world: World,
    progress: Option<PathBuf>,
    yes: bool,
}

/// The result of a measurement.
struct MeasurementResult {
    progress: Progress,
    around: Loop,
    /// Smallest motion of the tip that the encoders detect, m.
    encoder_step: f64,
}

/// Measures which walls are stable on a board, like `haptic measure-range`. The motors move the device: take the hand
/// off.
///
/// For every damping the stiffness is raised until the telemetry shows a motion that grows or continues as a vibration.
/// The stiffness is then reduced at once, and the boundary is bisected. No theory is used. The board's earlier scene
/// and rules are restored. Ctrl-C and any exception turn the motors off.
///
/// Without a board the device is simulated in this process, with: q, its pose, shape (N,) rad (default: home); friction
/// "all", "viscous", "coulomb" or "none"; ideal_drive, whose torques act without delay; counts per turn of every
/// encoder (default: as in the device file); grip, a relaxed hand at the tip. A board must have this device, and is
/// measured in its present pose and state. A real board needs yes=True, with which you agree that the device moves.
///
/// normal: (d,), the normal of a wall at the tip; or (W, d), the normals of walls that act together. share (W,) are the
/// walls' shares of the total stiffness and damping (default: equal); no_feed_forward lists the walls, counted from 0,
/// without feed-forward. feed_forward: "both" (off and full), "all" (also washout), "off", "full" or "washout". kd: the
/// dampings, N s/m (default: `points` even steps up to the end of the range). torque_limit_nm: largest joint torque, N
/// m. pull_m: largest distance by which the tip is pulled aside, m; every repeat pulls in the same direction.
///
/// progress: a file that is written after every repeat. The same call with this file continues an interrupted
/// measurement. told: a function that is called with (repeats done, total repeats) and must not use the board.
///
/// Returns a dict: q (N,) rad; encoder_step_m; loop, the keywords with which Device.range predicts the same loop, as in
/// device.range(found["q"], normal, kd=found["off"]["kd"], **found["loop"]). "off", "full" and "washout", if measured,
/// are dicts over k ascending dampings: kd (k,) N s/m; repeats (k, R) N/m, with R the largest number of repeats; kp
/// (k,) N/m, the median of the repeats; low and high (k,) N/m, the bounds of the repeats; vibration_m (k,), the
/// peak-to-peak vibration just above kp, NaN if the motion grew; stable_up_to (k,) N/m and why (k,), a text, if no
/// boundary was found (kp may then be NaN), otherwise NaN and None; kd_max N s/m, the end of the range, NaN if it was
/// not measured; kd_max_open, the reason why the end was not found, or None.
///
/// Raises ImpossibleError if no boundary was found, LinkError, RefusedError.
#[pyfunction]
#[pyo3(signature = (
    device, normal, *, board = None, rate_hz = 1000.0, cutoff_hz = 20.0, kd = None, points = 12, repeats = 5, feed_forward = "both",
    washout_hz = 2.0, share = None, no_feed_forward = None, torque_limit_nm = 1.0, pull_m = 5e-4, progress = None, told = None,
    yes = false, q = None, friction = "all", ideal_drive = false, counts = None, grip = false
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn measure_range<'py>(
    py: Python<'py>,
    device: &PyDevice,
    normal: &Bound<'py, PyAny>,
    board: Option<&Board>,
    rate_hz: f64,
    cutoff_hz: f64,
    kd: Option<Vec<f64>>,
    points: usize,
    repeats: usize,
    feed_forward: &str,
    washout_hz: f64,
    share: Option<Vec<f64>>,
    no_feed_forward: Option<Vec<usize>>,
    torque_limit_nm: f64,
    pull_m: f64,
    progress: Option<PathBuf>,
    told: Option<Py<PyAny>>,
    yes: bool,
    q: Option<Vec<f64>>,
    friction: &str,
    ideal_drive: bool,
    counts: Option<f64>,
    grip: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let modes = [
        ("both", &[FeedForward::Off, FeedForward::Full][..]),
        ("all", &[FeedForward::Off, FeedForward::Full, FeedForward::Washout]),
        ("off", &[FeedForward::Off]),
        ("full", &[FeedForward::Full]),
        ("washout", &[FeedForward::Washout]),
    ];
    let modes = parse_word("feed_forward", feed_forward, &modes)?.to_vec();
    let frictions = [
        ("all", Friction::All),
        ("viscous", Friction::Viscous),
        ("coulomb", Friction::Coulomb),
        ("none", Friction::None),
    ];
    let friction = parse_word("friction", friction, &frictions)?;
    let wrong = |reason: &str| Err(RequestError::new_err(reason.to_owned()));
    let positive = |number: f64| number > 0.0 && number.is_finite();
    if ![rate_hz, cutoff_hz, washout_hz, torque_limit_nm, pull_m].into_iter().all(positive) || pull_m > 5e-3 {
        return wrong(
            "rate_hz, cutoff_hz, washout_hz, torque_limit_nm and pull_m must be positive, and pull_m at most 0.005",
        );
    }
    if kd.as_ref().is_some_and(|kd| kd.is_empty() || kd.iter().any(|kd| !(*kd >= 0.0 && kd.is_finite()))) {
        return wrong("kd must have at least one damping, and each must be zero or more, not negative");
    }
    if !(1..=200).contains(&points) || !(1..=100).contains(&repeats) {
        return wrong("points must be 1 to 200, and repeats 1 to 100");
    }
    if counts.is_some_and(|counts| !(counts >= 1.0 && counts.is_finite())) {
        return wrong("counts must be at least 1");
    }
    let walls = walls(device, normal, share, no_feed_forward)?;
    let mut file = device.file.clone();
    let pose = q.map(|q| pose(&file, &q, &walls)).transpose()?;
    let world = World { q: pose, friction, ideal_drive, counts, grip };
    if board.is_none() {
        world.apply(&mut file);
    } else if world != World::default() {
        return wrong(
            "q, friction, ideal_drive, counts and grip change a simulation; a board is measured in its present state",
        );
    }
    let law = Law::default();
    let setup = MeasurementSetup {
        walls,
        rate_hz,
        cutoff_hz,
        washout_hz,
        law,
        torque_limit: torque_limit_nm,
        largest_pull: pull_m,
    };
    let request = MeasurementRequest {
        file,
        setup,
        plan: Plan { modes, kd, points, repeats, pulls: vec![1.0] },
        world,
        progress,
        yes,
    };

    let measured = match board {
        Some(board) => board.with_board(py, |board| request.measure(board, told.as_ref(), true))?,
        None => py.detach(|| {
            let shared = request.world.board(&request.file, rate_hz);
            let shared = shared.map_err(|error| RequestError::new_err(error.to_string()))?;
            let mut board = HostBoard::over(shared.wire(), "sim").map_err(errors::link)?;
            request.measure(&mut board, told.as_ref(), false)
        })?,
    };
    as_arrays(py, &request, &measured)
}

/// Checks and returns the walls that are measured together.
fn walls(
    device: &PyDevice,
    normal: &Bound<'_, PyAny>,
    share: Option<Vec<f64>>,
    no_feed_forward: Option<Vec<usize>>,
) -> PyResult<Vec<Member>> {
    let task = device.file.spec().task;
    let normals = rows("normal", normal, task)?;
    let (count, most) = (normals.rows.len(), max_tested_walls(task));
    let wrong = |reason: String| Err(RequestError::new_err(reason));
    if normals.shape.len() > 1 || count == 0 || count > most {
        return wrong(format!(
            "normal must have 1 to {most} walls, because the board needs further walls to hold the tip"
        ));
    }
    let share = share.unwrap_or_else(|| vec![1.0; count]);
    if share.len() != count || share.iter().any(|part| !(*part > 0.0 && part.is_finite())) {
        return wrong(format!("share must be {count} positive numbers, one for each wall"));
    }
    let without = no_feed_forward.unwrap_or_default();
    if without.iter().any(|wall| *wall >= count) || (0..count).all(|wall| without.contains(&wall)) {
        return wrong("no_feed_forward counts walls from 0 and must leave a wall with the feed-forward".into());
    }
    let normals = device.to_unit_vectors(normals.rows)?;
    let member = |(wall, (normal, share))| Member { normal, share, feed_forward: !without.contains(&wall) };
    Ok(normals.into_iter().zip(share).enumerate().map(member).collect())
}

/// Checks and returns the pose of a simulated device.
fn pose(file: &DeviceFile, q: &[f64], walls: &[Member]) -> PyResult<[f64; 3]> {
    let joints = file.spec().joints;
    if q.len() != joints || q.iter().any(|angle| !angle.is_finite()) {
        return Err(RequestError::new_err(format!("q must be {joints} finite angles")));
    }
    WallSet::at(&file.description, q, walls, Admissible::default()).map_err(failure)?;
    Ok(std::array::from_fn(|i| q.get(i).copied().unwrap_or(0.0)))
}

impl MeasurementRequest {
    fn measure(
        &self,
        board: &mut HostBoard,
        told: Option<&Py<PyAny>>,
        is_external: bool,
    ) -> PyResult<MeasurementResult> {
        let what = board_measurement::description(&self.file, &self.setup, &self.plan.pulls, &self.world);
        let path = self.progress.as_deref();
        let wrong = |error| measurement(MeasureError::Progress(error));
        let mut progress = path.map_or(Ok(Progress::new(&what)), |path| Progress::open(path, &what)).map_err(wrong)?;
        if is_external {
            self.check_agreement(board)?;
        }
        let before = board_measurement::settings_to_restore(board, &progress).map_err(errors::board)?;
        let keeps_settings = is_external && path.is_some();
        // An exception in Python, from Ctrl-C or from the function `told`.
        let raised = OnceCell::new();
        let last_check = Cell::new(Instant::now());
        let call = |work: &dyn Fn(Python<'_>) -> PyResult<()>| {
            if let Err(error) = Python::attach(work) {
                let _ = raised.set(error);
            }
        };
        let stop = || {
            if last_check.get().elapsed() >= SIGNAL_INTERVAL {
                last_check.set(Instant::now());
                call(&|py| py.check_signals());
            }
            raised.get().is_some()
        };
        let total = self.plan.total();
        let done = |done: usize| {
            if let Some(told) = told {
                call(&|py| told.call1(py, (done, total)).map(drop));
            }
        };
        let mut loop_and_step = None;
        let setup = &self.setup;
        let mut session =
            BoardMeasurement { board, file: &self.file, before, progress: &mut progress, path, keeps_settings };
        let on_begin = |prepared: &mut haptic_predict::measure::PreparedBoard<'_>, _: &[f64]| {
            let (info, details) = (prepared.board().info().clone(), prepared.board().details()?);
            loop_and_step =
                Some((board_measurement::control_loop(setup, &info, &details), prepared.excitation().quantum));
            Ok(())
        };
        let outcome = session.measure(setup.clone(), &self.plan, &stop, on_begin, done);
        let restored = session.restore();
        if let Some(error) = raised.into_inner() {
            return Err(error);
        }
        outcome.map_err(measurement)?;
        restored.map_err(wrong)?;
        match loop_and_step {
            Some((around, encoder_step)) if progress.points.iter().any(|point| !point.repeats.is_empty()) => {
                Ok(MeasurementResult { progress, around, encoder_step })
            }
            _ => {
                let open = progress.points.iter().find_map(|point| point.open.as_ref());
                let reason = open.map_or("", |open| &open.reason);
                Err(ImpossibleError::new_err(format!("no boundary was found: {reason}")))
            }
        }
    }

    /// Checks that the board has this device, and that the user has agreed to the motion of a real device.
    fn check_agreement(&self, board: &mut HostBoard) -> PyResult<()> {
        let device = DeviceData::new(&self.file.name, &self.file.description)
            .map_err(|error| RequestError::new_err(error.to_string()))?;
        if let Some(found) = board_measurement::other_loaded_device(board, &device).map_err(errors::link)? {
            let text =
                format!("the board holds {found}, the file is {}; load the device of the file first", self.file.name);
            return Err(ImpossibleError::new_err(text));
        }
        if board.details().map_err(errors::link)?.real && !self.yes {
            return Err(RequestError::new_err(
                "the motors will move the device: keep hands away from it, and agree with yes=True",
            ));
        }
        Ok(())
    }
}

/// Converts the error of a measurement to an exception.
fn measurement(error: MeasureError) -> PyErr {
    match error {
        MeasureError::Board(error) => errors::board(error),
        MeasureError::Link(error) => errors::link(error),
        MeasureError::Pose(error) => failure(error),
        MeasureError::Progress(error) => RequestError::new_err(error.to_string()),
        MeasureError::Scene(_) => RequestError::new_err(error.to_string()),
        other => ImpossibleError::new_err(other.to_string()),
    }
}

/// Converts the results of a measurement to arrays.
fn as_arrays<'py>(
    py: Python<'py>,
    request: &MeasurementRequest,
    measured: &MeasurementResult,
) -> PyResult<Bound<'py, PyDict>> {
    let MeasurementResult { progress, around, encoder_step } = measured;
    let found = PyDict::new(py);
    found.set_item("q", list(py, &progress.q)?)?;
    found.set_item("encoder_step_m", encoder_step)?;
    let keywords = PyDict::new(py);
    keywords.set_item("rate_hz", around.rate_hz)?;
    keywords.set_item("cutoff_hz", request.setup.cutoff_hz)?;
    keywords.set_item("delay", around.delay_samples)?;
    match around.drive {
        Drive::Current { bandwidth_hz } => {
            keywords.set_item("drive", "current")?;
            keywords.set_item("current_bandwidth_hz", bandwidth_hz)?;
        }
        _ => keywords.set_item("drive", "ideal")?,
    }
    keywords.set_item("undamped", request.file.description.joints.iter().all(|joint| joint.viscous == 0.0))?;
    if request.plan.modes.contains(&FeedForward::Washout) {
        keywords.set_item("washout_hz", request.setup.washout_hz)?;
    }
    found.set_item("loop", keywords)?;
    for (name, mode) in FeedForward::ALL {
        if !request.plan.modes.contains(&mode) {
            continue;
        }
        let points = progress.points_of_mode(mode);
        let most = points.iter().map(|point| point.repeats.len()).max().unwrap_or(0);
        let into = PyDict::new(py);
        let column = |name: &str, pick: &dyn Fn(&Point) -> Option<f64>| {
            let values: Vec<f64> = points.iter().map(|point| pick(point).unwrap_or(f64::NAN)).collect();
            into.set_item(name, list(py, &values)?)
        };
        let some = |point: &Point| !point.repeats.is_empty();
        column("kd", &|point| Some(point.kd))?;
        column("kp", &|point| some(point).then(|| point.median()))?;
        column("low", &|point| some(point).then(|| point.bounds().0))?;
        column("high", &|point| some(point).then(|| point.bounds().1))?;
        column("vibration_m", &|point| point.vibration_m)?;
        column("stable_up_to", &|point| point.open.as_ref().map(|open| open.stable_up_to))?;
        let repeat = |point: &Point, nth: usize| point.repeats.get(nth).copied().unwrap_or(f64::NAN);
        let repeats = points.iter().flat_map(|point| (0..most).map(move |nth| repeat(point, nth))).collect();
        into.set_item("repeats", array(py, repeats, &[points.len(), most])?)?;
        let why: Vec<Option<&str>> =
            points.iter().map(|point| point.open.as_ref().map(|open| open.reason.as_str())).collect();
        into.set_item("why", why)?;
        into.set_item("kd_max", progress.end(mode).unwrap_or(f64::NAN))?;
        let open_end = progress.open_ends.iter().find(|(other, _)| *other == mode).map(|(_, why)| why.as_str());
        into.set_item("kd_max_open", open_end)?;
        found.set_item(name, into)?;
    }
    Ok(found)
}
