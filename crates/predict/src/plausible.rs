//! Finds values that a file may contain but can hardly mean. Lengths in millimetres, masses in grams, angles in degrees
//! and walls beyond what is stable all parse, and all are doubted here, with the number that gives them away.
//!
//! Nothing here refuses: a device may be stranger than these rules. Bounds come from solid steel, from what one file
//! says in two places, and from the prediction of `haptic range`.
//!
//! - [`device`]: a device file by itself
//! - [`scene`]: walls on a device

pub mod device;
pub mod scene;

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_host::toml_file::Document;
use serde::Serialize;

/// The place of a doubt in a file: a table (with its place in a list of tables, from 0), perhaps a table in it, and a
/// key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// `geometry`, `link`, `joint`, `wall`, …; empty at the top of the file.
    pub table: &'static str,
    /// Which of several.
    pub index: Option<usize>,
    /// `encoder` or `motor` in a joint; else empty.
    pub part: &'static str,
    /// The key.
    pub name: &'static str,
}

/// Something that parses but can hardly be meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Doubt {
    /// The place in a file.
    pub key: Option<Key>,
    /// The doubt, and what was probably meant: one sentence without its final stop.
    pub text: String,
}

/// A doubt about a file, as programs read it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Warning {
    /// The file; empty for what was typed.
    pub path: String,
    /// Line, from 1.
    pub line: Option<usize>,
    /// Column, from 1.
    pub column: Option<usize>,
    /// The sentence.
    pub text: String,
}

impl Doubt {
    fn new(key: Key, text: String) -> Self {
        Self { key: Some(key), text }
    }

    /// With its place in the file that it is about.
    pub fn about(self, document: &Document) -> Warning {
        let at = self.key.and_then(|key| document.find(key.table, key.index, key.part, key.name));
        Warning {
            path: document.path().display().to_string(),
            line: at.map(|at| at.0),
            column: at.map(|at| at.1),
            text: self.text,
        }
    }

    /// Of something that was typed.
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

/// A result and what is doubted about it: one JSON document, with the doubts, where there are any, under `warnings`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Warned<'a, T> {
    /// The result.
    #[serde(flatten)]
    pub result: &'a T,
    /// The doubts.
    #[serde(skip_serializing_if = "none")]
    pub warnings: &'a [Warning],
}

fn none(warnings: &&[Warning]) -> bool {
    warnings.is_empty()
}

/// Says doubts on standard error, one line each.
pub fn warn(warnings: &[Warning]) {
    for warning in warnings {
        haptic_host::tell!("haptic: warning: {warning}");
    }
}

/// Doubts about joint angles that were typed: degrees, mostly.
pub fn angles(q: &[f64], what: &str, kind: Kind) -> Vec<Doubt> {
    let doubted = q.iter().enumerate().filter(|(_, angle)| in_degrees(kind, **angle));
    doubted
        .map(|(joint, angle)| Doubt { key: None, text: turns(&format!("{what} of joint {joint}"), *angle) })
        .collect()
}

/// Doubts about joint angles that the device's limits leave out.
pub fn beyond_limits(q: &[f64], description: &Description) -> Vec<Doubt> {
    let beyond = |(joint, angle): (usize, &f64)| {
        let (low, high) = description.joints[joint].limits?;
        let text = format!(
            "the pose puts joint {joint} at {angle} rad, outside its limits [{low}, {high}]: the device never stands so"
        );
        (!(low..=high).contains(angle)).then_some(Doubt { key: None, text })
    };
    q.iter().enumerate().filter_map(beyond).collect()
}

/// Returns true if an angle is probably in degrees. The joints of a linkage turn less than once. A wheel or a knob turns
/// often: its angles are in degrees if they are round as such.
fn in_degrees(kind: Kind, angle: f64) -> bool {
    let round = angle.abs() >= 15.0 && angle % 5.0 == 0.0;
    angle.abs() > core::f64::consts::TAU && (kind != Kind::Paddle || round)
}

/// An angle that is more than a turn.
fn turns(what: &str, angle: f64) -> String {
    format!(
        "{what} is {angle} rad, {:.1} turns: angles are in radians ({angle} degrees are {:.4} rad)",
        (angle / core::f64::consts::TAU).abs(),
        angle.to_radians()
    )
}
