//! Helpers of all tests of the tool: shipped files, command lines, simple scenes and control loops.
#![allow(dead_code, unused_imports, reason = "each test program uses only a part")]

pub mod bodies;
pub mod cogged;
#[cfg(unix)]
pub mod documents;
pub mod domains;
pub mod drawn;
pub mod forces;
pub mod injected;
pub mod page;
pub mod sim;
pub mod socket;
pub mod strict;
pub mod tuned;

use assert_cmd::Command;
use haptic_bridge::math::Real;
use haptic_host::output::csv_line;
use haptic_predict::measure::{Law, MeasurementSetup};
use haptic_sim::ready_board;
use haptic_stability::analysis::flexible::Flexible;
use prelude::*;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

pub mod prelude {
    pub use haptic_bridge::control::{HostAction, Rules};
    pub use haptic_bridge::math::Libm;
    pub use haptic_bridge::model::admissible::Admissible;
    pub use haptic_bridge::model::description::{Description, EncoderAt, Transmission};
    pub use haptic_bridge::model::device::Device;
    pub use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
    pub use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
    pub use haptic_bridge::safety::fault::{Fault, State};
    pub use haptic_host::device_file::DeviceFile;
    pub use haptic_host::link::{Board, fields};
    pub use haptic_host::scene_file::SceneFile;
    pub use haptic_sim::{
        BoardOptions, DriveModel, HandSettings, Intent, Options, Random, SharedBoard, Support, Waypoint,
    };
    pub use haptic_stability::analysis::plant::{Drive, Linearised};
    pub use haptic_stability::analysis::range::domain;
    pub use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
    pub use haptic_stability::analysis::several::Member;
    pub use haptic_stability::sweep::Sweep;
    pub use nalgebra::{DMatrix, DVector};
    pub use serde_json::Value;
}

/// Folder with the scenes of the demo's device, relative to the repository.
pub const SCENES: &str = "devices/scenes/coupled-five-bar";

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// Reads a text file, whose path is relative to the repository.
pub fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Returns the text of a document. If `UPDATE_DOCS` is set, first writes the `computed` text to the document.
pub fn document(path: &str, computed: &str) -> String {
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(root().join(path), computed).unwrap_or_else(|error| panic!("{path}: {error}"));
    }
    read(path)
}

/// Formats a CSV document from rows whose cells are separated by ` | `; the first row is the header.
pub fn csv(rows: impl IntoIterator<Item = String>) -> String {
    let rows: Vec<Vec<String>> = rows.into_iter().map(|row| row.split(" | ").map(String::from).collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{rows:?}");
    rows.iter().map(csv_line).collect()
}

/// Returns the full path of a shipped file from its path in devices/.
pub fn shipped_path(name: &str) -> String {
    root().join("devices").join(name).display().to_string()
}

/// Returns the device or scene files in a folder of devices/.
pub fn toml_files(folder: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(shipped_path(folder)).unwrap();
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    files
}

pub fn shipped_device(name: &str) -> DeviceFile {
    DeviceFile::load(shipped_path(&format!("{name}.toml"))).unwrap()
}

pub fn all_shipped_devices() -> Vec<DeviceFile> {
    toml_files("").into_iter().map(|path| DeviceFile::load(path).unwrap()).collect()
}

/// A temporary folder that returns paths as strings for command lines.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    /// Writes a file and returns its path.
    pub fn write(&self, name: &str, contents: impl AsRef<[u8]>) -> String {
        std::fs::write(self.0.path().join(name), contents).unwrap();
        self.path(name)
    }

    /// Writes a copy of a shipped device file with these replacements and returns its path.
    pub fn write_changed(&self, device: &str, changes: &[(&str, &str)]) -> String {
        let text = changes.iter().fold(read(&format!("devices/{device}.toml")), |text, (from, to)| {
            assert!(text.contains(from), "{device}: {from}");
            text.replace(from, to)
        });
        self.write(&format!("{device}.toml"), text)
    }
}

/// Returns the command that runs the tool with these arguments in the repository.
pub fn haptic(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("haptic").unwrap();
    command.current_dir(root()).args(arguments).env_remove("HAPTIC_PORT");
    command
}

/// Runs the tool. Returns its exit code, standard output and standard error.
pub fn run(arguments: &[&str]) -> (i32, String, String) {
    let done = haptic(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (done.status.code().unwrap(), text(done.stdout), text(done.stderr))
}

/// Runs a command that must succeed and returns its standard output.
pub fn output(arguments: &[&str]) -> String {
    let (code, out, err) = run(arguments);
    assert_eq!(code, 0, "{arguments:?}: {err}");
    out
}

/// Runs a command that must end with this exit code and returns its standard error.
pub fn refusal(code: i32, arguments: &[&str]) -> String {
    let (ended, out, err) = run(arguments);
    assert_eq!((ended, out.as_str()), (code, ""), "{arguments:?}: {err}");
    err
}

/// Runs a command with `--json` and returns the document that it prints.
pub fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&output(&[arguments, &["--json"]].concat())).unwrap()
}

/// Runs every line of a table as `haptic COMMAND`. A line has the form `CODE: COMMAND => TEXT | !TEXT`: exit code (0 if
/// left out), command, and texts that the output must contain or, after `!`, must not contain. With exit code 1 or 2
/// the texts must be on standard error. `␣` stands for a space within an argument.
pub fn type_lines(table: &str, more: &[&str]) {
    for line in table.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let (command, texts) = line.split_once(" => ").unwrap_or((line, ""));
        let coded = command.split_once(": ").filter(|_| command.starts_with(|c: char| c.is_ascii_digit()));
        let (code, command) = coded.unwrap_or(("0", command));
        let words: Vec<String> = command.split_whitespace().map(|word| word.replace('␣', " ")).collect();
        let words: Vec<&str> = words.iter().map(String::as_str).chain(more.iter().copied()).collect();
        let (ended, out, err) = run(&words);
        assert_eq!(ended.to_string(), code, "{line}\n{out}{err}");
        let out = if matches!(ended, 1 | 2) { err } else { out + &err };
        for text in texts.split(" | ").filter(|text| !text.is_empty()) {
            let is_right = text.strip_prefix('!').map_or_else(|| out.contains(text), |text| !out.contains(text));
            assert!(is_right, "{line}\n{text}\n{out}");
        }
    }
}

/// Process of the tool, which is killed when dropped.
pub struct Process {
    pub child: Child,
    /// First line of the process's standard output.
    pub first_line: String,
}

impl Process {
    /// Starts the tool and waits for its first line.
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("haptic"));
        let mut child = command.args(arguments).env_remove("HAPTIC_PORT").stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { child, first_line: line.trim_end().into() }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal, such as `INT`, to a process, with the shell's `kill`, because some systems have no such program.
pub fn send_signal(child: &Child, name: &str) {
    let line = format!("kill -{name} {}", child.id());
    assert!(std::process::Command::new("sh").args(["-c", &line]).status().unwrap().success());
}

/// Returns a simulated board in this process with this device, and a connection to it.
pub fn board(file: &DeviceFile, options: BoardOptions) -> (SharedBoard, Board) {
    let shared = SharedBoard::new(ready_board(file, options).unwrap());
    let board = Board::over(shared.wire(), "sim").unwrap();
    (shared, board)
}

/// Returns the numbers of a JSON list.
pub fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Returns the option `--q` with the joint angles of a JSON list.
pub fn pose_option(q: &Value) -> String {
    let angles: Vec<String> = numbers(q).iter().map(|angle| format!("{angle:e}")).collect();
    format!("--q={}", angles.join(","))
}

/// Returns the value of a numeric attribute in a line of an SVG file.
pub fn svg_number(line: &str, attribute: &str) -> Option<f64> {
    line.split_once(&format!(" {attribute}=\""))?.1.split_once('"')?.0.parse().ok()
}

/// Returns the settings for a measurement of one wall, with a torque limit of 1 N m and a pull of 2 mm.
pub fn measurement(normal: &[f64], rate_hz: f64, cutoff_hz: f64) -> MeasurementSetup {
    MeasurementSetup {
        walls: vec![Member::new(normal.to_vec(), 1.0)],
        rate_hz,
        cutoff_hz,
        washout_hz: 2.0,
        law: Law::default(),
        torque_limit: 1.0,
        largest_pull: 2e-3,
    }
}

/// Returns a plane wall without feed-forward.
pub fn plane_wall<T: Real>(point: [T; 3], normal: [T; 3], stiffness: T, damping: T) -> Wall<T> {
    Wall {
        surface: Surface::Plane(Plane { point, normal }),
        stiffness,
        damping,
        feed_forward: FeedForward::Off,
        washout_hz: T::from_f64(2.0),
        damping_compensation: false,
        bilateral: false,
    }
}

/// Returns a control loop with ideal motors.
pub fn ideal_loop(rate_hz: f64, delay_samples: f64, estimator: LinearEstimator) -> Loop {
    Loop { rate_hz, delay_samples, estimator, drive: Drive::Ideal, damping_compensation: false }
}

/// Returns a rigid device at one pose, from mass matrix, joint damping, Jr and E.
pub fn rigid_device(mass: &[f64], viscous: &[f64], row: &[f64], unit_motion: &[f64]) -> Linearised {
    Linearised {
        gain: 1.0,
        flexible: Flexible::default(),
        mass: DMatrix::from_row_slice(row.len(), row.len(), mass),
        viscous: DVector::from_column_slice(viscous),
        row: DVector::from_column_slice(row),
        unit_motion: DVector::from_column_slice(unit_motion),
    }
}

/// Returns a free mass (kg) that moves along the wall's normal.
pub fn point_mass(mass: f64) -> Linearised {
    rigid_device(&[mass], &[0.0], &[1.0], &[1.0])
}
