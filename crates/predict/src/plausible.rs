//! Warns of values that parse but are probably wrong, such as lengths in millimetres, masses in grams, angles in
//! degrees and walls outside the stable range. Each warning states the number that shows the mistake.
//!
//! Warnings reject nothing, because a device may break these rules. The bounds come from solid steel, from
//! contradictory values in a file, and from the prediction of `haptic range`.
//!
//! - [`device`]: warnings about a device file
//! - [`scene`]: warnings about a scene on a device

pub mod device;
pub mod scene;

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_host::toml_file::Document;
use serde::Serialize;

/// Place of a value in a file: a table (with its index in a list of tables), optionally a table inside it, and a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// `geometry`, `link`, `joint`, `wall`, ...; empty at the top level of the file.
    pub table: &'static str,
    /// Index in a list of tables, from 0.
    pub index: Option<usize>,
    /// `encoder` or `motor` in a joint; otherwise empty.
    pub part: &'static str,
    /// Name of the key.
    pub name: &'static str,
}

/// A warning whose line in the file is not yet known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileWarning {
    /// Place in the file; `None` for a value from the command line.
    pub key: Option<Key>,
    /// The problem and its probable cause: one sentence without full stop.
    pub text: String,
}

/// A warning with its line and column, as in the JSON output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Warning {
    /// Path of the file; empty for a value from the command line.
    pub path: String,
    /// Line in the file, from 1.
    pub line: Option<usize>,
    /// Column in the line, from 1.
    pub column: Option<usize>,
    /// Text of the warning.
    pub text: String,
}

impl FileWarning {
    fn new(key: Key, text: String) -> Self {
        Self { key: Some(key), text }
    }

    /// Adds the path, line and column in `document`, the file with the value.
    pub fn locate_in(self, document: &Document) -> Warning {
        let at = self.key.and_then(|key| document.find(key.table, key.index, key.part, key.name));
        Warning {
            path: document.path().display().to_string(),
            line: at.map(|at| at.0),
            column: at.map(|at| at.1),
            text: self.text,
        }
    }

    /// Returns the warning for a value from the command line.
    pub fn for_command_line(self) -> Warning {
        Warning { path: String::new(), line: None, column: None, text: self.text }
    }
}

impl core::fmt::Display for Warning {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if !self.path.is_empty() {
            f.write_str(&self.path)?;
            if let (Some(line), Some(column)) = (self.line, self.column) {
                write!(f, ":{line}:{column}")?;
            }
            f.write_str(": ")?;
        }
        f.write_str(&self.text)
    }
}

/// A result with its warnings as one JSON document. Without warnings the key `warnings` is left out.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct WithWarnings<'a, T> {
    /// The result.
    #[serde(flatten)]
    pub result: &'a T,
    /// The warnings.
    #[serde(skip_serializing_if = "is_empty")]
    pub warnings: &'a [Warning],
}

fn is_empty(warnings: &&[Warning]) -> bool {
    warnings.is_empty()
}

/// Prints warnings on standard error, one line each.
pub fn warn(warnings: &[Warning]) {
    for warning in warnings {
        haptic_host::tell!("haptic: warning: {warning}");
    }
}

/// Returns warnings about joint angles from the command line that are probably in degrees.
pub fn angle_warnings(q: &[f64], what: &str, kind: Kind) -> Vec<FileWarning> {
    let implausible = q.iter().enumerate().filter(|(_, angle)| in_degrees(kind, **angle));
    implausible
        .map(|(joint, angle)| FileWarning { key: None, text: full_turns(&format!("{what} of joint {joint}"), *angle) })
        .collect()
}

/// Returns warnings about joint angles outside the device's limits.
pub fn pose_limit_warnings(q: &[f64], description: &Description) -> Vec<FileWarning> {
    let outside = |(joint, angle): (usize, &f64)| {
        let (low, high) = description.joints[joint].limits?;
        let text = format!(
            "the pose puts joint {joint} at {angle} {}, outside its limits [{low}, {high}], so the device cannot reach it",
            description.joints[joint].units().travel
        );
        (!(low..=high).contains(angle)).then_some(FileWarning { key: None, text })
    };
    q.iter().enumerate().filter_map(outside).collect()
}

/// Returns true if an angle is probably in degrees. The joints of a linkage turn by less than one turn. A wheel or a
/// knob may turn more often, so its angle must also be a multiple of 5.
fn in_degrees(kind: Kind, angle: f64) -> bool {
    let round = angle.abs() >= 15.0 && angle % 5.0 == 0.0;
    angle.abs() > core::f64::consts::TAU && (!kind.spec().are_links_optional || round)
}

fn full_turns(what: &str, angle: f64) -> String {
    format!(
        "{what} is {angle} rad, {:.1} turns: angles are in radians ({angle} degrees are {:.4} rad)",
        (angle / core::f64::consts::TAU).abs(),
        angle.to_radians()
    )
}
