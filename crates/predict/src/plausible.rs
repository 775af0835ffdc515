//! Warns of values that parse but are hardly intended, such as lengths in millimetres, masses in grams, angles in
//! degrees and walls outside the stable range. Each warning states the number that shows the mistake.
//!
//! A warning rejects nothing: a device may be stranger than these rules. The bounds come from solid steel, from two
//! statements of one file that disagree, and from the prediction of `haptic range`.
//!
//! - [`device`]: a device file by itself
//! - [`scene`]: walls on a device

pub mod device;
pub mod scene;

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_host::toml_file::Document;
use serde::Serialize;

/// Place of a warning in a file: a table (with its index in a list of tables, from 0), optionally a table inside it,
/// and a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// `geometry`, `link`, `joint`, `wall`, ...; empty at the top level of the file.
    pub table: &'static str,
    /// Index in a list of tables.
    pub index: Option<usize>,
    /// `encoder` or `motor` in a joint; otherwise empty.
    pub part: &'static str,
    /// The key.
    pub name: &'static str,
}

/// A warning about a value that parses but is hardly intended; its line is not yet known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileWarning {
    /// The place in a file.
    pub key: Option<Key>,
    /// The problem and the probable meaning: one sentence without its full stop.
    pub text: String,
}

/// A warning with its line and column, as it is written to JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Warning {
    /// The file; empty for a value from the command line.
    pub path: String,
    /// Line, from 1.
    pub line: Option<usize>,
    /// Column, from 1.
    pub column: Option<usize>,
    /// The sentence.
    pub text: String,
}

impl FileWarning {
    fn new(key: Key, text: String) -> Self {
        Self { key: Some(key), text }
    }

    /// Adds the place in `document`, the file that the warning concerns.
    pub fn about(self, document: &Document) -> Warning {
        let at = self.key.and_then(|key| document.find(key.table, key.index, key.part, key.name));
        Warning {
            path: document.path().display().to_string(),
            line: at.map(|at| at.0),
            column: at.map(|at| at.1),
            text: self.text,
        }
    }

    /// Makes a warning about a value from the command line.
    pub fn typed(self) -> Warning {
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

/// A result together with its warnings: one JSON document. The key `warnings` is left out if there are none.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Warned<'a, T> {
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
pub fn angles(q: &[f64], what: &str, kind: Kind) -> Vec<FileWarning> {
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
            "the pose puts joint {joint} at {angle} rad, outside its limits [{low}, {high}], so the device cannot reach it"
        );
        (!(low..=high).contains(angle)).then_some(FileWarning { key: None, text })
    };
    q.iter().enumerate().filter_map(outside).collect()
}

/// Returns true if an angle is probably in degrees. The joints of a linkage turn less than one turn. A wheel or a knob
/// may turn many times: its angle is taken for degrees if it is a round number of degrees.
fn in_degrees(kind: Kind, angle: f64) -> bool {
    let round = angle.abs() >= 15.0 && angle % 5.0 == 0.0;
    angle.abs() > core::f64::consts::TAU && (kind != Kind::Paddle || round)
}

/// Describes an angle of more than one turn.
fn full_turns(what: &str, angle: f64) -> String {
    format!(
        "{what} is {angle} rad, {:.1} turns: angles are in radians ({angle} degrees are {:.4} rad)",
        (angle / core::f64::consts::TAU).abs(),
        angle.to_radians()
    )
}
