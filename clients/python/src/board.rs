//! Boards: real ones, and simulated ones in this process.

use crate::arrays::{array, list};
use crate::device::{PyDevice, Scene};
use crate::errors::{self, LinkError, RequestError};
use crate::recording::Recording;
use haptic_host::haptic_bridge::board::protocol::{BadForce, ForceAnswer, ForceDone, ForceRequest, HostContact};
use haptic_host::haptic_bridge::board::telemetry::Fields;
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

/// Longest wait for telemetry before Ctrl-C is looked for.
const LOOK: Duration = Duration::from_millis(100);

/// The device's state in the answer to a request (docs/host-force.md). Arrays have three entries, 0 where the device
/// has none.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct State {
    answer: ForceAnswer,
    fault: Option<FaultRecord>,
}

#[pymethods]
impl State {
    /// The outcome of the request, in words: it begins with "taken" or "not taken".
    #[getter]
    fn done(&self) -> String {
        self.answer.done.to_string()
    }
    /// True if the request acts.
    #[getter]
    fn taken(&self) -> bool {
        self.answer.done == ForceDone::Taken
    }
    /// Disarmed, Armed, CheckingPolarity or Fault.
    #[getter]
    fn state(&self) -> &'static str {
        STATES[self.answer.state as usize]
    }
    /// Control periods since the board started, wrapping at 2³².
    #[getter]
    fn step(&self) -> u32 {
        self.answer.step
    }
    /// From one control period to the next, s.
    #[getter]
    fn period_s(&self) -> f32 {
        self.answer.period
    }
    /// Since the state that the acting request was computed from, s; None when none acts.
    #[getter]
    fn age_s(&self) -> Option<f32> {
        self.answer.age
    }
    /// The part of what was asked for that acts, 0 to 1.
    #[getter]
    fn share(&self) -> f32 {
        self.answer.share
    }
    /// Tip, m, shape (3,).
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.tip)
    }
    /// Velocity of the tip, m/s, shape (3,), filtered as the scene says.
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.velocity)
    }
    /// Joint angles, rad, shape (3,).
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.q)
    }
    /// Joint velocities, rad/s, shape (3,), filtered as the scene says.
    #[getter]
    fn qd<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.qd)
    }
    /// Joint torques commanded, after all limits, N m, shape (3,).
    #[getter]
    fn torque<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.torque)
    }
    /// Force at the tip that the host's requests really added, N, shape (3,).
    #[getter]
    fn force<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        list(py, &self.answer.force)
    }
    /// The latched fault, with what to do about it; None without one.
    #[getter]
    fn fault(&self) -> Option<String> {
        self.fault.as_ref().map(words)
    }
    fn __repr__(&self) -> String {
        let done =
            if self.answer.done == ForceDone::Looked { String::new() } else { format!(", {}", self.answer.done) };
        format!("<State {}, tip {:?} m{done}>", self.state(), self.answer.tip)
    }
}

fn words(fault: &FaultRecord) -> String {
    errors::in_calls(&fault_and_remedy(fault))
}

/// The stream that is followed.
#[derive(Clone, Copy)]
struct Stream {
    fields: Fields,
    axes: usize,
}

/// Everything that is held while a board is open.
struct Held {
    session: Session,
    stream: Option<Stream>,
}

/// A board while this program holds it.
///
/// Board(port): a serial port or serial number, "tcp:HOST:PORT", "sim" or "sim:DEVICE.toml"; without one the only board
/// connected. Use it in a `with` block: the motors go off at its end, however it ends, and when the board is let go of.
/// Calls from several threads wait for each other; none holds the interpreter's lock while it waits for the board.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct Board(Mutex<Option<Held>>);

impl Board {
    pub fn of(session: Session) -> Self {
        Self(Mutex::new(Some(Held { session, stream: None })))
    }

    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Held) -> Result<T, BoardError> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let held = held.as_mut().ok_or_else(|| LinkError::new_err("the board was closed; open it again"))?;
            work(held).map_err(errors::board)
        })
    }

    /// Works with the whole board, whose stream is over afterwards.
    pub fn whole<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut link::Board) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        self.with(py, |held| {
            held.stream = None;
            Ok(work(&mut held.session))
        })?
    }

    fn exchanged(&self, py: Python<'_>, request: ForceRequest) -> PyResult<State> {
        let state = self.with(py, |held| {
            let answer = held.session.exchange(request)?;
            Ok(State { answer, fault: held.session.fault() })
        })?;
        match state.answer.done {
            // A step that the board has not been at: it has restarted, and the next request goes on.
            ForceDone::Bad(bad) if bad != BadForce::Seen => Err(RequestError::new_err(state.answer.done.to_string())),
            _ => Ok(state),
        }
    }
}

/// Three entries, of which the device's own must be there.
fn vector(what: &str, given: &[f64]) -> PyResult<[f32; 3]> {
    if given.is_empty() || given.len() > 3 {
        return Err(RequestError::new_err(format!("{what} has {} entries, and must have 1 to 3", given.len())));
    }
    Ok(std::array::from_fn(|i| given.get(i).map_or(0.0, |value| *value as f32)))
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
        let port = self.with(py, |held| Ok(held.session.port().to_owned()));
        port.map_or_else(|_| "<Board, closed>".into(), |port| format!("<Board at {port}>"))
    }

    /// Disarms the board and lets go of it. Twice is once.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.0.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }

    /// The board's description: a dict of board, serial, firmware, protocol and port.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (info, port) = self.with(py, |held| Ok((held.session.info().clone(), held.session.port().to_owned())))?;
        let dict = PyDict::new(py);
        dict.set_item("board", info.board.as_str())?;
        dict.set_item("serial", info.serial.as_str())?;
        dict.set_item("firmware", info.firmware.as_str())?;
        dict.set_item("protocol", info.protocol)?;
        dict.set_item("port", port)?;
        Ok(dict)
    }

    /// Disarmed, Armed, CheckingPolarity or Fault.
    #[getter]
    fn state(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.with(py, |held| Ok(STATES[held.session.status()?.state as usize]))
    }

    /// The latched fault, with what to do about it; None without one.
    #[getter]
    fn fault(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.with(py, |held| Ok(held.session.status()?.fault.as_ref().map(words)))
    }

    /// Loads a device and a scene; without a scene, free space. Motors must be off. Homing is forgotten; the polarity check
    /// still counts where the same device is loaded again and then homed near where it was homed before.
    #[pyo3(signature = (device, scene = None))]
    fn load(&self, py: Python<'_>, device: &PyDevice, scene: Option<&Scene>) -> PyResult<()> {
        let data = device.file.device().map_err(|error| RequestError::new_err(error.to_string()))?;
        self.with(py, |held| held.session.set_device(&data))?;
        self.set_scene(py, scene)
    }

    /// Loads a scene for the device that the board has, which stays homed; without one, free space. Motors must be off.
    #[pyo3(signature = (scene = None))]
    fn set_scene(&self, py: Python<'_>, scene: Option<&Scene>) -> PyResult<()> {
        let scene = scene.map(|scene| scene.file.scene()).transpose();
        let scene = scene.map_err(|error| RequestError::new_err(error.to_string()))?;
        self.with(py, |held| {
            let device = held.session.device()?.ok_or(Refusal::NoDevice)?;
            let task = device.mechanism.kind().spec().task as u8;
            held.session.set_scene(&scene.unwrap_or(BoardScene { task, ..BoardScene::default() }))
        })
    }

    /// The device stands in its home pose.
    fn home(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |held| held.session.home())
    }

    /// Checks that every motor turns its joint the way its encoder counts, which moves each joint a little; returns
    /// when that is known. Raises RefusedError where one does not, or where the check was ended before.
    fn check_polarity(&self, py: Python<'_>) -> PyResult<()> {
        let outcome = self.with(py, |held| {
            held.session.check_polarity()?;
            held.session.wait_for_polarity()
        })?;
        outcome.passed().map_err(|failure| errors::refused(&failure.to_string()))
    }

    /// Motors on; torque ramps up over half a second. The board must then hear from this program as often as its rules
    /// ask, every half second unless they say otherwise: look, force and torque tell it.
    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |held| held.session.arm())
    }

    /// Motors off.
    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |held| held.session.disarm())
    }

    /// Clears a latched fault.
    fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |held| held.session.clear())
    }

    /// Changes one wall's stiffness (N/m) and damping (N s/m), also while it is touched.
    fn set_gains(&self, py: Python<'_>, wall: u8, stiffness: f32, damping: f32) -> PyResult<()> {
        let there = self.with(py, |held| {
            let scene = held.session.scene()?;
            let Some(now) = scene.as_ref().and_then(|scene| scene.walls.get(usize::from(wall))) else {
                return Ok(Err(scene.map_or(0, |scene| scene.walls.len())));
            };
            let (feed_forward, washout_hz) = (now.feed_forward, now.washout_hz);
            let gains = Gains { wall, stiffness, damping, feed_forward, washout_hz };
            held.session.set_wall_gains(gains).map(Ok)
        })?;
        there.map_err(|walls| RequestError::new_err(format!("the scene has {walls} walls, so there is no wall {wall}")))
    }

    /// For how long look, force and torque wait for their answer, s. Unless this says otherwise they wait for 0.1 and ask
    /// again, for a second in all. Where none comes they raise UnansweredError, and the next one goes on.
    fn wait_for_forces(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let patience = Duration::try_from_secs_f64(seconds)
            .map_err(|_| RequestError::new_err(format!("a time is no less than 0 s, not {seconds}")))?;
        self.with(py, |held| {
            held.session.wait_for_forces(patience);
            Ok::<_, BoardError>(())
        })
    }

    /// The device's state; asks nothing of the motors, and tells the board that this program is there.
    fn look(&self, py: Python<'_>) -> PyResult<State> {
        self.exchanged(py, ForceRequest::default())
    }

    /// Pushes with a force (N) at the tip, up to 3 entries in the task frame, in the place of what was asked for
    /// before.
    ///
    /// hold_s: how long it acts in full, fade_s: in how long it then fades to nothing, 0 to 0.2 s each. contact: (point
    /// (m), unit normal, stiffness (N/m), damping (N s/m)) of a plane that the board renders at its own rate. A number
    /// that no board takes raises RequestError; what was not taken for another reason raises nothing: State.done says why.
    #[pyo3(signature = (force, *, contact = None, hold_s = link::HOLD, fade_s = link::FADE))]
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
        self.exchanged(py, ForceRequest { hold: hold_s, fade: fade_s, force, contact, ..ForceRequest::default() })
    }

    /// Pushes with torques (N m) at the joints, in the place of what was asked for before; hold_s and fade_s as of
    /// force.
    #[pyo3(signature = (torque, *, hold_s = link::HOLD, fade_s = link::FADE))]
    fn torque(&self, py: Python<'_>, torque: Vec<f64>, hold_s: f32, fade_s: f32) -> PyResult<State> {
        let torque = vector("the torques", &torque)?;
        self.exchanged(py, ForceRequest { hold: hold_s, fade: fade_s, torque, ..ForceRequest::default() })
    }

    /// Starts a stream of every `divider`-th control period's fields (names of docs/telemetry.md with commas between,
    /// or "usual", "all"). Returns the names of the columns that `rows` will have.
    #[pyo3(signature = (fields = "usual", divider = 1))]
    fn start_stream(&self, py: Python<'_>, fields: &str, divider: u32) -> PyResult<Vec<String>> {
        let fields = link::fields(fields).map_err(RequestError::new_err)?;
        self.with(py, |held| {
            let axes = held.session.device()?.map_or(0, |device| device.axes());
            held.session.start_stream(fields, divider)?;
            held.stream = Some(Stream { fields, axes });
            Ok(names(fields, axes))
        })
    }

    /// The rows that have come, waiting at most timeout_s for the first: shape (rows, columns), `step` first.
    #[pyo3(signature = (timeout_s = 0.1))]
    fn rows<'py>(&self, py: Python<'py>, timeout_s: f64) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let timeout =
            Duration::try_from_secs_f64(timeout_s).map_err(|error| RequestError::new_err(error.to_string()))?;
        let (mut rows, mut left) = (Vec::new(), timeout);
        let width =
            self.with(py, |held| Ok(held.stream.map_or(0, |stream| names(stream.fields, stream.axes).len())))?;
        loop {
            let wait = left.min(LOOK);
            rows.append(&mut self.with(py, |held| Ok(held.session.rows(wait)?))?);
            left -= wait;
            if !rows.is_empty() || left.is_zero() {
                break;
            }
            py.check_signals()?;
        }
        let rows: Vec<Vec<f64>> = rows.iter().map(with_step).collect();
        array(py, rows.concat(), &[rows.len(), width])
    }

    /// Stops the stream.
    fn stop_stream(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |held| held.session.stop_stream())
    }

    /// The losses of the stream so far: a dict of received, missing, dropped_by_board, batches_lost, garbled.
    #[getter]
    fn losses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let losses = self.with(py, |held| Ok(held.session.losses()))?;
        let dict = PyDict::new(py);
        dict.set_item("received", losses.received)?;
        dict.set_item("missing", losses.missing)?;
        dict.set_item("dropped_by_board", losses.dropped_by_board)?;
        dict.set_item("batches_lost", losses.batches_lost)?;
        dict.set_item("garbled", losses.garbled)?;
        Ok(dict)
    }

    /// Follows the board for so many seconds of its own time and returns a Recording, with `step` as first column.
    #[pyo3(signature = (seconds, fields = "usual", divider = 1))]
    fn record(&self, py: Python<'_>, seconds: f64, fields: &str, divider: u32) -> PyResult<Recording> {
        let columns = self.start_stream(py, fields, divider)?;
        let mut rows = Vec::new();
        let now = |held: &mut Held| Ok(held.session.now().as_secs_f64());
        let end = self.with(py, now)? + seconds;
        loop {
            let left = end - self.with(py, now)?;
            if left <= 0.0 {
                break;
            }
            let wait = Duration::from_secs_f64(left.min(LOOK.as_secs_f64()));
            let came = self.with(py, |held| Ok(held.session.rows(wait)?))?;
            rows.extend(came.iter().map(with_step));
            py.check_signals()?;
        }
        self.stop_stream(py)?;
        let about = vec![format!("{}", self.with(py, |held| Ok(held.session.losses()))?)];
        Ok(Recording { columns, rows, about, torn: false })
    }
}

fn names(fields: Fields, axes: usize) -> Vec<String> {
    let own = columns(fields, axes).into_iter().map(|column| column.label);
    std::iter::once("step".to_owned()).chain(own).collect()
}

fn with_step(row: &Row) -> Vec<f64> {
    std::iter::once(f64::from(row.step)).chain(row.values.iter().copied()).collect()
}

/// The boards that are connected: a list of dicts with port, serial and board.
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
