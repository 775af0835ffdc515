//! Real boards, and boards that are simulated in this process.

use crate::arrays::{array, list};
use crate::device::{PyDevice, Scene};
use crate::errors::{self, LinkError, RequestError};
use crate::recording::Recording;
use haptic_host::frame::rotation;
use haptic_host::haptic_bridge::board::protocol::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_host::haptic_bridge::board::telemetry::{Fields, RowShape};
use haptic_host::haptic_bridge::model::units::JointUnits;
use haptic_host::haptic_bridge::render::controller::Gains;
use haptic_host::haptic_bridge::render::scene::Scene as BoardScene;
use haptic_host::haptic_bridge::safety::fault::FaultRecord;
use haptic_host::haptic_bridge::safety::refusal::Refusal;
use haptic_host::link::{self, BoardError, PortSpec, Row, Session, columns};
use haptic_host::words::fault_and_remedy;
use haptic_show::recorder::STATES;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Longest wait for telemetry between two checks for Ctrl-C.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(100);

/// The device's state in the reply to a request (docs/host-force.md). Arrays have three entries, which are 0 for axes
/// that the device lacks.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct State {
    reply: ForceAnswer,
    fault: Option<FaultRecord>,
}

#[pymethods]
impl State {
    /// Outcome of the request, a text that begins with "taken" or "not taken".
    #[getter]
    fn done(&self) -> String {
        self.reply.done.to_string()
    }
    /// True if the board has accepted the request, which then acts.
    #[getter]
    fn taken(&self) -> bool {
        self.reply.done == ForceDone::Taken
    }
    /// State of the board: Disarmed, Armed, CheckingPolarity, Fault or Homing.
    #[getter]
    fn state(&self) -> &'static str {
        STATES[self.reply.state as usize]
    }
    /// Number of control periods since the board started; wraps at 2³².
    #[getter]
    fn step(&self) -> u32 {
        self.reply.step
    }
    /// Control period, s.
    #[getter]
    fn period_s(&self) -> f32 {
        self.reply.period
    }
    /// Age of the state from which the acting request was computed, s; None if no request acts.
    #[getter]
    fn age_s(&self) -> Option<f32> {
        self.reply.age
    }
    /// Share of the request that acts, 0 to 1.
    #[getter]
    fn share(&self) -> f32 {
        self.reply.share
    }
    /// Position of the tip, m, shape (3,).
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.tip)
    }
    /// Velocity of the tip, m/s, shape (3,), filtered by the scene's estimator.
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.velocity)
    }
    /// Joint angles, rad, shape (3,). A slide has m, m/s and N here, in `qd` and in `torque`.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.q)
    }
    /// Joint velocities, rad/s, shape (3,), filtered by the scene's estimator.
    #[getter]
    fn qd<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.qd)
    }
    /// Angles of the encoders without motors, rad, shape (3,).
    #[getter]
    fn sensed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.sensed)
    }
    /// Orientation of the handle by these angles, a rotation matrix, shape (3, 3) (docs/files.md).
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, rotation(&self.reply.sensed).transpose().as_slice().to_vec(), &[3, 3])
    }
    /// Commanded joint torques, after all limits, N m, shape (3,).
    #[getter]
    fn torque<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.torque)
    }
    /// Force that the host's requests have added at the tip, N, shape (3,).
    #[getter]
    fn force<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.reply.force)
    }
    /// Latched fault with its remedy; None without a fault.
    #[getter]
    fn fault(&self) -> Option<String> {
        self.fault.as_ref().map(fault_text)
    }
    fn __repr__(&self) -> String {
        let done = if self.reply.done == ForceDone::Looked { String::new() } else { format!(", {}", self.reply.done) };
        format!("<State {}, tip {:?} m{done}>", self.state(), self.reply.tip)
    }
}

fn fault_text(fault: &FaultRecord) -> String {
    errors::with_python_calls(&fault_and_remedy(fault))
}

/// The present stream.
#[derive(Clone, Copy)]
struct Stream {
    fields: Fields,
    shape: RowShape,
}

/// The state of an open board.
struct OpenBoard {
    session: Session,
    stream: Option<Stream>,
}

/// A board that this program holds.
///
/// Board(port): port is a serial port or serial number, "tcp:HOST:PORT", "sim" or "sim:DEVICE.toml"; by default the
/// only connected board. Use a Board in a `with` block, so that the motors go off when the block ends for any reason.
/// They also go off when the Board is deleted. Calls from several threads wait for each other, and release the
/// interpreter's lock while they wait for the board.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct Board(Mutex<Option<OpenBoard>>);

impl Board {
    pub fn of(session: Session) -> Self {
        Self(Mutex::new(Some(OpenBoard { session, stream: None })))
    }
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut OpenBoard) -> Result<T, BoardError> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let open = open.as_mut().ok_or_else(|| LinkError::new_err("the board was closed; open it again"))?;
            work(open).map_err(errors::board)
        })
    }

    /// Ends the stream, then runs `work` with the board.
    pub fn with_board<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut link::Board) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        self.with(py, |open| {
            open.stream = None;
            Ok(work(&mut open.session))
        })?
    }

    fn exchange(&self, py: Python<'_>, request: ForceRequest) -> PyResult<State> {
        let state = self.with(py, |open| {
            let reply = open.session.exchange(request)?;
            Ok(State { reply, fault: open.session.fault() })
        })?;
        match state.reply.done {
            // `Seen` is not an error, because a restarted board does not know the step and may accept the next request.
            ForceDone::Bad(bad) if bad != BadForce::Seen => Err(RequestError::new_err(state.reply.done.to_string())),
            _ => Ok(state),
        }
    }
}

/// Pads a vector of 1 to 3 entries to three entries.
fn vector(what: &str, entries: &[f64]) -> PyResult<[f32; 3]> {
    if entries.is_empty() || entries.len() > 3 {
        return Err(RequestError::new_err(format!("{what} has {} entries, but must have 1 to 3", entries.len())));
    }
    Ok(std::array::from_fn(|i| entries.get(i).map_or(0.0, |value| *value as f32)))
}

#[pymethods]
impl Board {
    #[new]
    #[pyo3(signature = (port = None))]
    fn new(py: Python<'_>, port: Option<&str>) -> PyResult<Self> {
        let spec = match port {
            Some(port) => port.parse::<PortSpec>().map_err(RequestError::new_err)?,
            None => PortSpec::Find,
        };
        py.detach(|| haptic_sim::open(&spec).map(Session::of)).map(Self::of).map_err(errors::link)
    }

    fn __enter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }
    #[pyo3(signature = (*_error))]
    fn __exit__(&self, py: Python<'_>, _error: &Bound<'_, pyo3::types::PyTuple>) {
        self.close(py);
    }
    fn __repr__(&self, py: Python<'_>) -> String {
        let port = self.with(py, |open| Ok(open.session.port().to_owned()));
        port.map_or_else(|_| "<Board, closed>".into(), |port| format!("<Board at {port}>"))
    }
    /// Disarms the board and closes it. Closing it again has no effect.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.0.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }
    /// Description of the board: a dict with board, serial, firmware, protocol and port.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (info, port) = self.with(py, |open| Ok((open.session.info().clone(), open.session.port().to_owned())))?;
        let dict = PyDict::new(py);
        dict.set_item("board", info.board.as_str())?;
        dict.set_item("serial", info.serial.as_str())?;
        dict.set_item("firmware", info.firmware.as_str())?;
        dict.set_item("protocol", info.protocol)?;
        dict.set_item("port", port)?;
        Ok(dict)
    }

    /// State of the board: Disarmed, Armed, CheckingPolarity, Fault or Homing.
    #[getter]
    fn state(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.with(py, |open| Ok(STATES[open.session.status()?.state as usize]))
    }
    /// Latched fault with its remedy; None without a fault.
    #[getter]
    fn fault(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.with(py, |open| Ok(open.session.status()?.fault.as_ref().map(fault_text)))
    }
    /// Loads a device and a scene (without a scene, free space). The motors must be off. The device must be homed
    /// again. The polarity check stays valid if the same device is loaded again and homed close to its earlier home.
    #[pyo3(signature = (device, scene = None))]
    fn load(&self, py: Python<'_>, device: &PyDevice, scene: Option<&Scene>) -> PyResult<()> {
        let data = device.file.device().map_err(|error| RequestError::new_err(error.to_string()))?;
        self.with(py, |open| open.session.set_device(&data))?;
        self.set_scene(py, scene)
    }

    /// Loads a scene (without a scene, free space) for the present device, which stays homed. The motors must be off.
    #[pyo3(signature = (scene = None))]
    fn set_scene(&self, py: Python<'_>, scene: Option<&Scene>) -> PyResult<()> {
        let scene = scene.map(|scene| scene.file.scene()).transpose();
        let scene = scene.map_err(|error| RequestError::new_err(error.to_string()))?;
        self.with(py, |open| {
            let device = open.session.device()?.ok_or(Refusal::NoDevice)?;
            let task = device.mechanism.kind().spec().task as u8;
            open.session.set_scene(&scene.unwrap_or(BoardScene { task, ..BoardScene::default() }))
        })
    }

    /// Declares that the device is in its home pose.
    fn home(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |open| open.session.home())
    }
    /// Checks that every motor turns its joint in the direction in which the encoder counts. Moves each joint a little
    /// and waits for the end of the check. Raises RefusedError if a joint fails or another program ends the check.
    fn check_polarity(&self, py: Python<'_>) -> PyResult<()> {
        let outcome = self.with(py, |open| {
            open.session.check_polarity()?;
            open.session.wait_for_polarity()
        })?;
        outcome.require_pass().map_err(|failure| errors::refused_error(&failure.to_string()))
    }

    /// Turns the motors on; the torque ramps up over 0.5 s. Then call look, force or torque as often as the board's
    /// rules require a heartbeat, by default every 0.5 s.
    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |open| open.session.arm())
    }
    /// Turns the motors off.
    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |open| open.session.disarm())
    }
    /// Clears a latched fault.
    fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |open| open.session.clear())
    }
    /// Changes one wall's stiffness (N/m) and damping (N s/m), also while it is in contact.
    fn set_gains(&self, py: Python<'_>, wall: u8, stiffness: f32, damping: f32) -> PyResult<()> {
        let result = self.with(py, |open| {
            let scene = open.session.scene()?;
            let Some(now) = scene.as_ref().and_then(|scene| scene.walls.get(usize::from(wall))) else {
                return Ok(Err(scene.map_or(0, |scene| scene.walls.len())));
            };
            let (feed_forward, washout_hz) = (now.feed_forward, now.washout_hz);
            let gains = Gains { wall, stiffness, damping, feed_forward, washout_hz };
            open.session.set_wall_gains(gains).map(Ok)
        })?;
        result
            .map_err(|walls| RequestError::new_err(format!("the scene has {walls} walls, so there is no wall {wall}")))
    }

    /// Sets the time for which look, force and torque wait for their reply, s. By default they wait for 0.1 s and retry
    /// for 1 s in total. Without a reply they raise UnansweredError; the next request may succeed.
    fn wait_for_forces(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let patience = Duration::try_from_secs_f64(seconds)
            .map_err(|_| RequestError::new_err(format!("a time must be at least 0 s, not {seconds}")))?;
        self.with(py, |open| {
            open.session.wait_for_forces(patience);
            Ok::<_, BoardError>(())
        })
    }

    /// Reads the device's state without a request to the motors. The call is also a heartbeat.
    fn look(&self, py: Python<'_>) -> PyResult<State> {
        self.exchange(py, ForceRequest::default())
    }
    /// Pushes with a force (N) at the tip, up to 3 entries in the task frame, which replaces the previous request.
    ///
    /// hold_s: time for which the request acts in full, 0 to 0.2 s; fade_s: time in which it then fades to zero, 0 to
    /// 0.2 s. contact: (point (m), unit normal, stiffness (N/m), damping (N s/m)) of a plane that the board renders at
    /// its own rate. An invalid number raises RequestError. For a request that is refused for another reason,
    /// State.done gives the reason and nothing is raised.
    #[pyo3(signature = (force, *, contact = None, hold_s = link::HOLD_S, fade_s = link::FADE_S))]
    fn force(
        &self,
        py: Python<'_>,
        force: Vec<f64>,
        contact: Option<(Vec<f64>, Vec<f64>, f32, f32)>,
        hold_s: f32,
        fade_s: f32,
    ) -> PyResult<State> {
        let contact = contact
            .map(|(point, normal, stiffness, damping)| {
                Ok::<_, PyErr>(HostContact {
                    point: vector("the contact's point", &point)?,
                    normal: vector("the contact's normal", &normal)?,
                    stiffness,
                    damping,
                })
            })
            .transpose()?;
        let force = vector("the force", &force)?;
        self.exchange(py, ForceRequest { hold: hold_s, fade: fade_s, force, contact, ..ForceRequest::default() })
    }

    /// Pushes with torques (N m) at the joints, which replaces the previous request. See force for hold_s and fade_s.
    #[pyo3(signature = (torque, *, hold_s = link::HOLD_S, fade_s = link::FADE_S))]
    fn torque(&self, py: Python<'_>, torque: Vec<f64>, hold_s: f32, fade_s: f32) -> PyResult<State> {
        let torque = vector("the torques", &torque)?;
        self.exchange(py, ForceRequest { hold: hold_s, fade: fade_s, torque, ..ForceRequest::default() })
    }
    /// Starts a stream of fields (names of docs/telemetry.md separated by commas, or "usual", "all") at every
    /// `divider`-th control period. Returns the column names of `rows`.
    #[pyo3(signature = (fields = "usual", divider = 1))]
    fn start_stream(&self, py: Python<'_>, fields: &str, divider: u32) -> PyResult<Vec<String>> {
        let fields = link::fields(fields).map_err(RequestError::new_err)?;
        self.with(py, |open| {
            let device = open.session.device()?;
            let shape = RowShape::of(device.as_ref());
            let units = device.map(|device| device.mechanism.units()).unwrap_or_default();
            open.session.start_stream(fields, divider)?;
            open.stream = Some(Stream { fields, shape });
            Ok(names(fields, &units, shape.sensed))
        })
    }

    /// Returns the received rows, shape (rows, columns), with `step` as first column. Waits at most timeout_s (s) for
    /// the first row.
    #[pyo3(signature = (timeout_s = 0.1))]
    fn rows<'py>(&self, py: Python<'py>, timeout_s: f64) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let timeout =
            Duration::try_from_secs_f64(timeout_s).map_err(|error| RequestError::new_err(error.to_string()))?;
        let (mut rows, mut left) = (Vec::new(), timeout);
        let width = self.with(py, |open| {
            Ok(open.stream.map_or(0, |Stream { fields, shape }| {
                names(fields, &[&JointUnits::REVOLUTE; 3][..shape.joints], shape.sensed).len()
            }))
        })?;
        loop {
            let wait = left.min(SIGNAL_INTERVAL);
            rows.append(&mut self.with(py, |open| Ok(open.session.rows(wait)?))?);
            left -= wait;
            if !rows.is_empty() || left.is_zero() {
                break;
            }
            py.check_signals()?;
        }
        let rows: Vec<Vec<f64>> = rows.iter().map(row_with_step).collect();
        array(py, rows.concat(), &[rows.len(), width])
    }

    /// Stops the stream.
    fn stop_stream(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |open| open.session.stop_stream())
    }
    /// Losses of the stream so far: a dict with received, missing, dropped_by_board, batches_lost and garbled.
    #[getter]
    fn losses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let losses = self.with(py, |open| Ok(open.session.losses()))?;
        let dict = PyDict::new(py);
        dict.set_item("received", losses.received)?;
        dict.set_item("missing", losses.missing)?;
        dict.set_item("dropped_by_board", losses.dropped_by_board)?;
        dict.set_item("batches_lost", losses.batches_lost)?;
        dict.set_item("garbled", losses.garbled)?;
        Ok(dict)
    }

    /// Records the board for `seconds` of the board's time and returns a Recording with `step` as first column.
    #[pyo3(signature = (seconds, fields = "usual", divider = 1))]
    fn record(&self, py: Python<'_>, seconds: f64, fields: &str, divider: u32) -> PyResult<Recording> {
        let columns = self.start_stream(py, fields, divider)?;
        let mut rows = Vec::new();
        let now = |open: &mut OpenBoard| Ok(open.session.now().as_secs_f64());
        let end = self.with(py, now)? + seconds;
        loop {
            let left = end - self.with(py, now)?;
            if left <= 0.0 {
                break;
            }
            let wait = Duration::from_secs_f64(left.min(SIGNAL_INTERVAL.as_secs_f64()));
            let came = self.with(py, |open| Ok(open.session.rows(wait)?))?;
            rows.extend(came.iter().map(row_with_step));
            py.check_signals()?;
        }
        self.stop_stream(py)?;
        let about = vec![format!("{}", self.with(py, |open| Ok(open.session.losses()))?)];
        Ok(Recording { columns, rows, about, torn: false })
    }
}

fn names(fields: Fields, units: &[&JointUnits], sensed: usize) -> Vec<String> {
    let own = columns(fields, units, sensed).into_iter().map(|column| column.label);
    std::iter::once("step".to_owned()).chain(own).collect()
}

fn row_with_step(row: &Row) -> Vec<f64> {
    std::iter::once(f64::from(row.step)).chain(row.values.iter().copied()).collect()
}

/// Returns the connected boards as dicts with port, serial and board.
#[pyfunction]
pub fn boards(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let (found, _) = py.detach(link::boards);
    let dict = |board: link::BoardPort| {
        let dict = PyDict::new(py);
        dict.set_item("port", board.path)?;
        dict.set_item("serial", board.serial)?;
        dict.set_item("board", board.kind)?;
        Ok(dict)
    };
    found.into_iter().map(dict).collect()
}
