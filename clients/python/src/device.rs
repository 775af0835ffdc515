//! The model, range and map of a device as arrays.

use crate::arrays::{Rows, array, list, rows};
use crate::errors::{ImpossibleError, RequestError, failure};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::haptic_bridge::model::admissible::Admissible;
use haptic_host::scene_file::SceneFile;
use haptic_host::toml_file::Document;
use haptic_stability::analysis::flexible::{Hand, Posture};
use haptic_stability::analysis::host::Host;
use haptic_stability::analysis::map::{MapPoint, map_until};
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::{motors, unit_normal};
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::{BOUNDARY_POINTS, Domain, Range, predict};
use haptic_stability::analysis::sampled::{LinearEstimator, Loop};
use haptic_stability::cores;
use haptic_stability::model::{Precision, Report, WallForce, evaluate_holding};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// Interval between checks for Ctrl-C.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Returns the value of a word, or an error with the known words.
pub fn parse_word<T: Copy>(what: &str, given: &str, all: &[(&str, T)]) -> PyResult<T> {
    all.iter().find(|(name, _)| *name == given).map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
        RequestError::new_err(format!("{what} cannot be {given:?}; choose among {}", known.join(", ")))
    })
}

/// Unwraps the result of each pose. An impossible pose becomes `None` if `keep`. Any other error is returned.
fn unwrap_poses<T>(found: Vec<Result<T, Failure>>, keep: bool) -> PyResult<Vec<Option<T>>> {
    let many = found.len() > 1;
    found
        .into_iter()
        .enumerate()
        .map(|(index, result)| match result {
            Ok(value) => Ok(Some(value)),
            Err(error) if keep && error.blame() == haptic_host::error::Blame::System => Ok(None),
            Err(error) if many => {
                let text = format!("pose {index}: {error}");
                Err(match error.blame() {
                    haptic_host::error::Blame::System | haptic_host::error::Blame::Difference => {
                        ImpossibleError::new_err(text)
                    }
                    haptic_host::error::Blame::Request => RequestError::new_err(text),
                })
            }
            Err(error) => Err(failure(error)),
        })
        .collect()
}

/// Maximum number of poses whose model is computed in the caller's thread, because the model of a pose takes
/// microseconds, less than the start of a thread.
const MAX_POSES_IN_CALLER: usize = 64;

/// Computes the results of `count` poses with the interpreter's lock released. Up to `max_in_caller` poses are computed
/// in this thread, more poses on all cores, where Ctrl-C ends the computation.
fn compute_poses<T: Send>(
    py: Python<'_>,
    count: usize,
    max_in_caller: usize,
    compute: impl Fn(usize) -> Result<T, Failure> + Sync,
) -> PyResult<Vec<Result<T, Failure>>> {
    if count <= max_in_caller {
        return Ok(py.detach(|| (0..count).map(&compute).collect()));
    }
    let all: Vec<usize> = (0..count).collect();
    run_until_ctrl_c(py, |stop| {
        cores::map(&all, &|_, _| {}, |pose| match stop.load(Ordering::Relaxed) {
            true => Err(Failure::impossible("interrupted")),
            false => compute(*pose),
        })
    })
}

/// Runs `work` with the interpreter's lock released. Ctrl-C sets the stop flag of `work` and ends the call.
fn run_until_ctrl_c<T: Send>(py: Python<'_>, work: impl FnOnce(&AtomicBool) -> T + Send) -> PyResult<T> {
    let (stop, done) = (AtomicBool::new(false), AtomicBool::new(false));
    py.detach(|| {
        let caller = thread::current();
        thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let found = work(&stop);
                done.store(true, Ordering::Release);
                caller.unpark();
                found
            });
            while !done.load(Ordering::Acquire) && !worker.is_finished() {
                thread::park_timeout(SIGNAL_INTERVAL);
                if let Err(interrupted) = Python::attach(|py| py.check_signals()) {
                    stop.store(true, Ordering::Relaxed);
                    return Err(interrupted);
                }
            }
            worker.join().map_err(|_| ImpossibleError::new_err("a defect of haptic_bridge: please report it"))
        })
    })
}

/// Writes columns over the poses into a dict: `tail` numbers for each pose, NaN for a pose without a result.
struct Columns<'py, 'a, T> {
    into: Bound<'py, PyDict>,
    shape: &'a [usize],
    found: &'a [Option<T>],
}

impl<T> Columns<'_, '_, T> {
    fn add(&self, name: &str, tail: &[usize], pick: impl Fn(&T) -> Vec<f64>) -> PyResult<()> {
        let width: usize = tail.iter().product();
        let values = self.found.iter().flat_map(|found| found.as_ref().map_or_else(|| vec![f64::NAN; width], &pick));
        let shape: Vec<usize> = self.shape.iter().chain(tail).copied().collect();
        self.into.set_item(name, array(self.into.py(), values.collect(), &shape)?)
    }
}

/// A device from a checked device file (docs/files.md).
///
/// The device has N joints and d task dimensions. All numbers are in SI units, angles in rad, travels of slides
/// in m. Poses are arrays of shape (..., N), also a single pose (N,). Results have the same leading shape. Many poses are
/// computed on all cores, without the interpreter's lock.
#[pyclass(name = "Device", frozen, module = "haptic_bridge")]
pub struct PyDevice {
    pub file: DeviceFile,
    /// Text of the file, which is pickled.
    document: Document,
}

fn read(document: Document) -> PyResult<PyDevice> {
    let file = DeviceFile::read(&document).map_err(failure)?;
    Ok(PyDevice { file, document })
}

#[pymethods]
impl PyDevice {
    /// Device(path): reads a device file.
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        read(Document::load(&path).map_err(failure)?)
    }
    /// Reads a device from a text. Error messages name `origin` as the file.
    #[staticmethod]
    #[pyo3(signature = (text, origin = "device.toml"))]
    fn parse(text: &str, origin: &str) -> PyResult<Self> {
        read(Document::new(text, origin))
    }
    /// Pickles the text of the device file, which can be unpickled on another computer.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String, String))> {
        let parse = py.get_type::<Self>().getattr("parse")?;
        Ok((parse, (self.document.text().to_owned(), self.document.path().display().to_string())))
    }
    /// Name of the device.
    #[getter]
    fn name(&self) -> &str {
        &self.file.name
    }
    /// Kind of mechanism: paddle, five-bar, five-bar-turret, parallelogram or serial-3r.
    #[getter]
    fn mechanism(&self) -> &'static str {
        self.file.spec().name
    }
    /// Number of joints N.
    #[getter]
    fn joints(&self) -> usize {
        self.file.spec().joints
    }
    /// Task dimension d.
    #[getter]
    fn task(&self) -> usize {
        self.file.spec().task
    }
    /// Home pose, rad, shape (N,); None if the file has no home.
    #[getter]
    fn home<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        self.file.description.home.map(|home| list(py, &home[..self.joints()])).transpose()
    }
    /// Entries that the file must have before a real board arms; empty if the file is complete.
    #[getter]
    fn lacks(&self) -> Vec<String> {
        self.file.missing_for_board()
    }
    fn __repr__(&self) -> String {
        format!("<Device {}: {}, {} joints>", self.file.name, self.mechanism(), self.joints())
    }
    /// Computes the model at poses, like `haptic model`.
    ///
    /// q: (..., N) rad. qd: (..., N) rad/s, by default zero. With the normal (d,) or (..., d) of a wall, of any length,
    /// and its force (N), the result includes the terms of equation (4). With precision "f32" the mechanism and the
    /// sines are computed as on a board.
    ///
    /// Returns a dict of arrays: position (..., d) m, jacobian (..., d, N) m/rad, mass (..., N, N) kg m², bias c + g
    /// (..., N) N m; condition_jacobian, condition_mass (...). With a normal: w_rr, w_eff, coupling (...) kg, w_ra
    /// (..., N-1), w_aa (..., N-1, N-1), z_r (...) N, z_a, f_a (..., N-1), torque, torque_without_feed_forward (..., N)
    /// N m.
    ///
    /// A singular pose raises ImpossibleError, or becomes NaN with singular="nan".
    #[pyo3(signature = (q, *, qd = None, normal = None, force = 0.0, precision = "f64", admissible = "orientation", singular = "raise"))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn model<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        qd: Option<&Bound<'py, PyAny>>,
        normal: Option<&Bound<'py, PyAny>>,
        force: f64,
        precision: &str,
        admissible: &str,
        singular: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (n, d) = (self.joints(), self.task());
        let poses = rows("q", q, n)?;
        let speeds = match qd {
            Some(qd) => rows("qd", qd, n)?.broadcast_to("qd", &poses)?,
            None => vec![vec![0.0; n]; poses.rows.len()],
        };
        let normals = normal.map(|normal| self.unit_normals(normal, &poses)).transpose()?;
        let precision = parse_word("precision", precision, &Precision::ALL)?;
        let admissible = parse_word("admissible", admissible, &Admissible::ALL)?;
        let keep = keeps_singular(singular)?;
        let compute = |pose: usize| -> Result<Report, Failure> {
            let wall = normals.as_ref().map(|normals| WallForce {
                normal: normals[pose].clone(),
                force,
                stiffness: 1.0,
                feed_forward: true,
            });
            let walls: Vec<WallForce> = wall.into_iter().collect();
            if poses.rows[pose].iter().chain(&speeds[pose]).any(|number| !number.is_finite()) {
                return Err(Failure::wrong("joint angles and velocities must be finite numbers"));
            }
            Ok(evaluate_holding(&self.file, &poses.rows[pose], &speeds[pose], &walls, precision, admissible)?)
        };
        let found = unwrap_poses(compute_poses(py, poses.rows.len(), MAX_POSES_IN_CALLER, compute)?, keep)?;
        let columns = Columns { into: PyDict::new(py), shape: &poses.shape, found: &found };
        columns.add("position", &[d], |report| report.position.clone())?;
        columns.add("jacobian", &[d, n], |report| report.jacobian.concat())?;
        columns.add("mass", &[n, n], |report| report.mass.concat())?;
        columns.add("bias", &[n], |report| report.bias.clone())?;
        columns.add("condition_jacobian", &[], |report| vec![report.condition.jacobian])?;
        columns.add("condition_mass", &[], |report| vec![report.condition.mass])?;
        if normals.is_some() {
            columns.add("w_rr", &[], |report| report.w_rr.concat())?;
            columns.add("w_ra", &[n - 1], |report| report.w_ra.concat())?;
            columns.add("w_aa", &[n - 1, n - 1], |report| report.w_aa.concat())?;
            columns.add("w_eff", &[], |report| report.w_eff.concat())?;
            columns.add("coupling", &[], |report| report.coupling.concat())?;
            columns.add("z_r", &[], |report| report.z_r.clone())?;
            columns.add("z_a", &[n - 1], |report| report.z_a.clone())?;
            columns.add("f_a", &[n - 1], |report| report.f_a.clone())?;
            columns.add("torque", &[n], |report| report.torque.clone())?;
            let plain = |report: &Report| report.torque_without_feed_forward.clone();
            columns.add("torque_without_feed_forward", &[n], plain)?;
        }
        Ok(columns.into)
    }

    /// Predicts which walls are stable at poses, like `haptic range` (rates and cutoffs in Hz, delay in control
    /// samples).
    ///
    /// q: (..., N) rad; normal: (d,) or (..., d). kd: the k dampings (N s/m) of the boundary's points, by default 200
    /// in even steps up to kd_max. estimator: butterworth, first-order, backward-difference or predicted. drive: ideal,
    /// voltage or current. hand: mass, damping and stiffness (kg, N s/m, N/m). posture: stiffness and damping (N m/rad,
    /// N m s/rad) that hold the posture of a redundant device. host_rate_hz and host_delay_s (s, by default one
    /// request's time) add the analysis of a wall that a program on a computer renders.
    ///
    /// Returns a dict: w_eff, w_rr (...) kg, area_ratio (...), and for each of "off", "full", "washout" (if washout_hz
    /// is set) and "host" (if host_rate_hz is set) a dict of area (...) N² s/m², kd_max (...) N s/m, kd (..., k) N s/m
    /// and kp (..., k) N/m. Stable islands above the boundary are not included.
    ///
    /// A singular pose raises ImpossibleError, or becomes NaN with singular="nan".
    #[pyo3(signature = (
        q, normal, *, rate_hz = 1000.0, cutoff_hz = 20.0, delay = 0.0, estimator = "butterworth", difference_over = 1,
        kd = None, washout_hz = None, damping_compensation = false, feed_forward_gain = 1.0, admissible = "orientation",
        undamped = false, drive = "ideal", current_bandwidth_hz = 6400.0, hand = None, posture = None,
        host_rate_hz = None, host_delay_s = None, singular = "raise"
    ))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn range<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        normal: &Bound<'py, PyAny>,
        rate_hz: f64,
        cutoff_hz: f64,
        delay: f64,
        estimator: &str,
        difference_over: usize,
        kd: Option<Vec<f64>>,
        washout_hz: Option<f64>,
        damping_compensation: bool,
        feed_forward_gain: f64,
        admissible: &str,
        undamped: bool,
        drive: &str,
        current_bandwidth_hz: f64,
        hand: Option<(f64, f64, f64)>,
        posture: Option<(f64, f64)>,
        host_rate_hz: Option<f64>,
        host_delay_s: Option<f64>,
        singular: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let poses = rows("q", q, self.joints())?;
        let normals = self.unit_normals(normal, &poses)?;
        let windowless = LinearEstimator::windowless();
        let estimators: Vec<(&str, LinearEstimator)> =
            windowless.filter_map(|(name, kind)| Some((name, LinearEstimator::of(kind, cutoff_hz)?))).collect();
        let estimator = parse_word("estimator", estimator, &estimators)?;
        if difference_over != 1 && !estimator.takes_difference() {
            return Err(RequestError::new_err("difference_over needs an estimator that takes a difference"));
        }
        let drive = match parse_word("drive", drive, &[("ideal", 0), ("voltage", 1), ("current", 2)])? {
            0 => Drive::Ideal,
            1 => Drive::Voltage(motors(&self.file.description).ok_or_else(|| {
                RequestError::new_err(format!("{} has joints without [joint.motor]", self.file.name))
            })?),
            _ => Drive::Current { bandwidth_hz: current_bandwidth_hz },
        };
        let around = Loop {
            rate_hz,
            delay_samples: delay,
            estimator: if difference_over == 1 { estimator } else { estimator.with_window(difference_over) },
            drive,
            damping_compensation,
        };
        let admissible = parse_word("admissible", admissible, &Admissible::ALL)?;
        let hand = hand.map_or(Hand::default(), |(mass, damping, stiffness)| Hand { mass, damping, stiffness });
        if [hand.mass, hand.damping, hand.stiffness].iter().any(|number| !(number.is_finite() && *number >= 0.0)) {
            return Err(RequestError::new_err(
                "hand must be mass (kg), damping (N s/m) and stiffness (N/m), none negative",
            ));
        }
        let posture = posture.map(|(stiffness, damping)| Posture { stiffness, damping });
        if let Some(held) = posture {
            if ![held.stiffness, held.damping].iter().all(|number| number.is_finite() && *number >= 0.0) {
                return Err(RequestError::new_err(
                    "posture must be stiffness (N m/rad) and damping (N m s/rad), none negative",
                ));
            }
            if self.joints() == self.task() {
                let name = self.mechanism();
                return Err(RequestError::new_err(format!(
                    "a {name} is not redundant: it has one posture at each position of its tip"
                )));
            }
        }
        if host_delay_s.is_some() && host_rate_hz.is_none() {
            return Err(RequestError::new_err("host_delay_s needs host_rate_hz too"));
        }
        let host = host_rate_hz.map(|hz| Host { rate_hz: hz, delay_s: host_delay_s.unwrap_or(1.0 / hz) });
        let keep = keeps_singular(singular)?;
        let points = kd.as_ref().map_or(BOUNDARY_POINTS, Vec::len);
        let subject = Subject::new(&self.file.description).map_err(|error| failure(Failure::wrong(error)))?;
        let subject = if undamped { subject.undamped() } else { subject };
        let prediction =
            Prediction { admissible, gain: feed_forward_gain, posture, hand, ..Prediction::new(subject, around) };
        let compute = |pose: usize| -> Result<Range, Failure> {
            let device = prediction.linearise(&poses.rows[pose], &normals[pose])?;
            let most = device.largest_gain().unwrap_or(1.0);
            if !(0.0..=most).contains(&feed_forward_gain) {
                return Err(Failure::wrong(format!(
                    "a feed-forward gain of {feed_forward_gain} is not from 0 to {most:.3}"
                )));
            }
            let around = &prediction.around;
            let range = predict(&device, around, kd.as_deref(), washout_hz)?;
            let host = host.map(|host| host.domain(&device, around, kd.as_deref())).transpose()?;
            Ok(Range { host, ..range })
        };
        let found = unwrap_poses(compute_poses(py, poses.rows.len(), 0, compute)?, keep)?;
        let columns = Columns { into: PyDict::new(py), shape: &poses.shape, found: &found };
        columns.add("w_eff", &[], |range| vec![range.w_eff])?;
        columns.add("w_rr", &[], |range| vec![range.w_rr])?;
        columns.add("area_ratio", &[], |range| vec![range.area_ratio])?;
        let domain = |name: &str, pick: &dyn Fn(&Range) -> Option<&Domain>| -> PyResult<()> {
            let inner = Columns { into: PyDict::new(py), shape: &poses.shape, found: &found };
            let number = |of: fn(&Domain) -> f64| move |range: &Range| vec![pick(range).map_or(f64::NAN, of)];
            inner.add("area", &[], number(|domain| domain.area))?;
            inner.add("kd_max", &[], number(|domain| domain.kd_max))?;
            let curve = |of: fn(&haptic_stability::analysis::range::BoundaryPoint) -> f64| {
                move |range: &Range| {
                    pick(range).map_or_else(Vec::new, |domain| domain.boundary.iter().map(of).collect())
                }
            };
            inner.add("kd", &[points], curve(|point| point.kd))?;
            inner.add("kp", &[points], curve(|point| point.kp))?;
            columns.into.set_item(name, inner.into)
        };
        domain("off", &|range| Some(&range.off))?;
        domain("full", &|range| Some(&range.full))?;
        if washout_hz.is_some() {
            domain("washout", &|range| range.washout.as_ref())?;
        }
        if host.is_some() {
            domain("host", &|range| range.host.as_ref().map(|host| &host.domain))?;
        }
        Ok(columns.into)
    }

    /// Computes the inertia at the M reachable poses of a grid of about `points` poses, like `haptic map`.
    ///
    /// Returns a dict of arrays: q (M, N) rad, position (M, d) m, w_eff, w_rr, coupling (M,) kg along the normal (d,),
    /// condition_jacobian, condition_mass (M,), worst_ratio (M,), worst_ratio_normal (M, d), worst_coupling (M,) kg,
    /// worst_coupling_normal (M, d), eigenvalues (M, d) kg ascending, eigenvectors (M, d, d) of which the k-th is [:,
    /// k].
    #[pyo3(signature = (normal, *, points = 2000, admissible = "orientation"))]
    fn map<'py>(
        &self,
        py: Python<'py>,
        normal: Vec<f64>,
        points: usize,
        admissible: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (n, d) = (self.joints(), self.task());
        let admissible = parse_word("admissible", admissible, &Admissible::ALL)?;
        let found = run_until_ctrl_c(py, |stop| {
            map_until(&self.file.description, &normal, points, admissible, &|| stop.load(Ordering::Relaxed))
        })?;
        let found = found.map_err(failure)?;
        let found: Vec<Option<MapPoint>> = found.into_iter().map(Some).collect();
        let columns = Columns { into: PyDict::new(py), shape: &[found.len()], found: &found };
        columns.add("q", &[n], |point| point.q.clone())?;
        columns.add("position", &[d], |point| point.position.clone())?;
        columns.add("w_eff", &[], |point| vec![point.w_eff])?;
        columns.add("w_rr", &[], |point| vec![point.w_rr])?;
        columns.add("coupling", &[], |point| vec![point.coupling])?;
        columns.add("condition_jacobian", &[], |point| vec![point.condition.jacobian])?;
        columns.add("condition_mass", &[], |point| vec![point.condition.mass])?;
        columns.add("worst_ratio", &[], |point| vec![point.worst_ratio.value])?;
        columns.add("worst_ratio_normal", &[d], |point| point.worst_ratio.normal.clone())?;
        columns.add("worst_coupling", &[], |point| vec![point.worst_coupling.value])?;
        columns.add("worst_coupling_normal", &[d], |point| point.worst_coupling.normal.clone())?;
        columns.add("eigenvalues", &[d], |point| point.eigenvalues.clone())?;
        columns.add("eigenvectors", &[d, d], |point| point.eigenvectors.concat())?;
        Ok(columns.into)
    }
}

impl PyDevice {
    /// Reads normals and converts them to unit normals, one for each pose.
    fn unit_normals(&self, given: &Bound<'_, PyAny>, poses: &Rows) -> PyResult<Vec<Vec<f64>>> {
        self.to_unit_vectors(rows("normal", given, self.task())?.broadcast_to("normal", poses)?)
    }
    /// Converts normals to unit vectors.
    pub fn to_unit_vectors(&self, normals: Vec<Vec<f64>>) -> PyResult<Vec<Vec<f64>>> {
        let (n, d) = (self.joints(), self.task());
        let unit = |normal: Vec<f64>| {
            let unit = unit_normal(&normal, d, n).map_err(failure)?;
            Ok(unit.iter().copied().take(d).collect())
        };
        normals.into_iter().map(unit).collect()
    }
}

fn keeps_singular(singular: &str) -> PyResult<bool> {
    parse_word("singular", singular, &[("raise", false), ("nan", true)])
}

/// A scene: walls, springs and fields, read from a scene file (docs/files.md).
#[pyclass(frozen, module = "haptic_bridge")]
pub struct Scene {
    pub file: SceneFile,
}

#[pymethods]
impl Scene {
    /// Scene(path, task): reads a scene file for a device of `task` dimensions.
    #[new]
    fn new(path: PathBuf, task: usize) -> PyResult<Self> {
        Ok(Self { file: SceneFile::load(path, task).map_err(failure)? })
    }
    /// Reads a scene from a text. Error messages name `origin` as the file.
    #[staticmethod]
    #[pyo3(signature = (text, task, origin = "scene.toml"))]
    fn parse(text: &str, task: usize, origin: &str) -> PyResult<Self> {
        Ok(Self { file: SceneFile::parse(text, origin, task).map_err(failure)? })
    }
    /// Number of walls.
    #[getter]
    fn walls(&self) -> usize {
        self.file.scene.walls.len()
    }
    /// Rate of the control steps, Hz.
    #[getter]
    fn rate_hz(&self) -> f64 {
        self.file.scene.rate_hz
    }
    fn __repr__(&self) -> String {
        format!("<Scene: {} walls at {} Hz>", self.walls(), self.rate_hz())
    }
}
