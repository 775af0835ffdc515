//! A simulated board whose device can be read and moved.

use crate::arrays::list;
use crate::board::Board;
use crate::device::{PyDevice, Scene};
use crate::errors::{self, RequestError};
use haptic_host::haptic_bridge::render::scene::Scene as BoardScene;
use haptic_host::link::{Board as HostBoard, Session};
use haptic_host::vectors::padded;
use haptic_sim::{BoardOptions, DriveModel, Hand, HandSettings, Intent, Options, SharedBoard, Waypoint, ready_board};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

/// Simulated time between two checks for Ctrl-C, s, which takes a few milliseconds to compute.
const SIGNAL_INTERVAL_S: f64 = 0.02;

/// A simulated board with a device: the firmware's code with a simulated linkage, motors and encoders.
///
/// Simulation(device, scene=None, *, ideal=False, friction=True, strict=False): without a scene, the device is in free
/// space. Ideal motors make the commanded torque without delay. A strict board requires homing, the polarity check and
/// verified motors, as a real board does. Time advances only in `run`, in `drive` and while a Board waits for a reply.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct Simulation {
    shared: SharedBoard,
    joints: usize,
    task: usize,
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (device, scene = None, *, ideal = false, friction = true, strict = false))]
    fn new(device: &PyDevice, scene: Option<&Scene>, ideal: bool, friction: bool, strict: bool) -> PyResult<Self> {
        let options = BoardOptions {
            drive: if ideal { DriveModel::Ideal } else { DriveModel::Electric },
            device: Options { friction, ..Options::default() },
            strict,
            ..BoardOptions::default()
        };
        let wrong = |error: &dyn std::fmt::Display| RequestError::new_err(error.to_string());
        let board = ready_board(&device.file, options).map_err(|error| wrong(&error))?;
        let shared = SharedBoard::new(board);
        let spec = device.file.spec();
        let scene = match scene {
            Some(scene) => scene.file.scene().map_err(|error| wrong(&error))?,
            None => BoardScene { task: spec.task as u8, ..BoardScene::default() },
        };
        let mut session = Session::of(HostBoard::over(shared.wire(), "sim").map_err(errors::link)?);
        session.set_scene(&scene).map_err(errors::board)?;
        Ok(Self { shared, joints: spec.joints, task: spec.task })
    }

    /// Opens the board. Only one Board of a simulation may be open at a time.
    fn board(&self) -> PyResult<Board> {
        Ok(Board::of(Session::of(HostBoard::over(self.shared.wire(), "sim").map_err(errors::link)?)))
    }
    /// Advances simulated time by `seconds`. Ctrl-C ends the call early.
    fn run(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let end = self.shared.lock().time() + seconds;
        let slice = || {
            let mut board = self.shared.lock();
            let until = end.min(board.time() + SIGNAL_INTERVAL_S);
            board.run_until(until);
            board.time() < end
        };
        while py.detach(slice) {
            py.check_signals()?;
        }
        Ok(())
    }

    fn __repr__(&self) -> String {
        let board = self.shared.lock();
        format!("<Simulation: {} s, tip {:?} m>", board.time(), &board.device().tip()[..self.task])
    }
    /// Runs one control period with the device at rest at q (N,) rad, and returns the motors' torques, N m, shape (N,).
    /// With this function another program can simulate the device. The encoders round q to counts, and the board
    /// estimates the velocities.
    fn drive<'py>(&self, py: Python<'py>, q: Vec<f64>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let q = self.angles(&q)?;
        let torque = py.detach(|| {
            let mut board = self.shared.lock();
            board.device_mut().place(q);
            board.control_period();
            board.device().torque()
        });
        list(py, &torque[..self.joints])
    }

    /// Moves the device and its encoders to q (N,) rad, at rest.
    fn place(&self, q: Vec<f64>) -> PyResult<()> {
        let q = self.angles(&q)?;
        self.shared.lock().device_mut().place(q);
        Ok(())
    }

    /// Sets the counts of the encoders without motors, which otherwise stand still.
    fn set_sensed_counts(&self, counts: [i32; 3]) {
        self.shared.lock().device_mut().set_sensed_counts(counts);
    }

    /// Puts a hand on the tip that follows the waypoints [(seconds from now, x, y, ..), ...], in m, smoothly. With
    /// push=True the waypoints are forces in N. An empty list removes the hand.
    #[pyo3(signature = (waypoints, *, push = false))]
    fn hand(&self, waypoints: Vec<Vec<f64>>, push: bool) -> PyResult<()> {
        let point = |numbers: Vec<f64>| match numbers.split_first() {
            Some((time, value)) if value.len() == self.task => Ok(Waypoint { time: *time, value: padded(value) }),
            _ => Err(RequestError::new_err(format!("a waypoint must be a time and {} numbers", self.task))),
        };
        let waypoints: Vec<Waypoint> = waypoints.into_iter().map(point).collect::<PyResult<_>>()?;
        let intent = match (waypoints.is_empty(), push) {
            (true, _) => Intent::LetGo,
            (_, false) => Intent::Follow(waypoints),
            (_, true) => Intent::Push(waypoints),
        };
        let mut board = self.shared.lock();
        let hand = Hand::new(HandSettings::default(), intent, board.device().tip(), board.device().time());
        board.device_mut().set_hand(hand);
        Ok(())
    }

    /// Simulated time, s.
    #[getter]
    fn time(&self) -> f64 {
        self.shared.lock().time()
    }
    /// Joint angles without measurement error, rad, shape (N,).
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.shared.lock().device().q()[..self.joints])
    }
    /// Position of the tip without measurement error, m, shape (d,).
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.shared.lock().device().tip()[..self.task])
    }
    /// Force of the hand on the tip, N, shape (d,).
    #[getter]
    fn hand_force<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.shared.lock().device().hand_force()[..self.task])
    }
}

impl Simulation {
    fn angles(&self, q: &[f64]) -> PyResult<[f64; 3]> {
        if q.len() != self.joints || q.iter().any(|angle| !angle.is_finite()) {
            return Err(RequestError::new_err(format!("q must be {} finite angles", self.joints)));
        }
        Ok(padded(q))
    }
}
