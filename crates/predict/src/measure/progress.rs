//! The results so far, kept in a file after every repeat so that an interrupted measurement goes on where it stopped.

use super::before::RestorePoint;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_host::output::{self, Overwrite};
use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// All repeats at one damping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// With which feed-forward.
    pub mode: FeedForward,
    /// Damping, N s/m.
    pub kd: f64,
    /// Largest stable stiffness of each repeat, N/m; the pulls of the measurement in turn.
    pub repeats: Vec<f64>,
    /// The largest vibration seen just beyond, m from peak to peak; none where the motion built up instead.
    #[serde(default)]
    pub vibration_m: Option<f64>,
    /// Why there are not more repeats, where nothing more could be told.
    #[serde(default)]
    pub open: Option<Open>,
}

/// A search that found no boundary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Open {
    /// The stiffest wall that was seen to be stable, N/m.
    pub stable_up_to: f64,
    /// The error that kept the search from going on.
    pub reason: String,
}

impl Point {
    /// Median of the repeats, whatever the pull; zero without any.
    pub fn median(&self) -> f64 {
        median(&self.repeats)
    }

    /// Lowest and highest repeat, whatever the pull.
    pub fn bounds(&self) -> (f64, f64) {
        bounds(&self.repeats)
    }
}

/// Median; zero without any.
#[must_use]
pub fn median(repeats: &[f64]) -> f64 {
    let mut sorted = repeats.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => 0.0,
        (n, half) if n % 2 == 1 => sorted[half],
        (_, half) => (sorted[half - 1] + sorted[half]) / 2.0,
    }
}

/// Lowest and highest.
#[must_use]
pub fn bounds(repeats: &[f64]) -> (f64, f64) {
    let low = repeats.iter().copied().fold(f64::INFINITY, f64::min);
    let high = repeats.iter().copied().fold(0.0, f64::max);
    (low.min(high), high)
}

/// A measurement, finished or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// The measurement's subject: device, pose, loop. A file of something else is not continued.
    pub what: String,
    /// Dampings at which the range ends, N s/m, where they were measured.
    #[serde(default)]
    pub ends: Vec<(FeedForward, f64)>,
    /// Modes whose range ends somewhere beyond, and why that was not found.
    #[serde(default)]
    pub open_ends: Vec<(FeedForward, String)>,
    /// Joint angles where it is measured, rad.
    #[serde(default)]
    pub q: Vec<f64>,
    /// The points with their repeats so far.
    pub points: Vec<Point>,
    /// When the last of it was measured (RFC 3339, UTC).
    #[serde(default)]
    pub date: Option<String>,
    /// The settings that the board held before; `None` once they are back on the board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<RestorePoint>,
}

/// Why a file cannot be used.
#[derive(Debug, Error)]
pub enum ProgressError {
    /// Not readable.
    #[error("{path} is no file of progress: {reason}")]
    File {
        /// Which.
        path: String,
        /// The system's or the parser's message.
        reason: String,
    },
    /// Not writable.
    #[error(transparent)]
    Unwritten(Failure),
    /// It belongs to something else.
    #[error("{path} holds another measurement{} ({found})", date.as_ref().map_or(String::new(), |date| format!(", of {date}")))]
    Another {
        /// Which.
        path: String,
        /// When its last part was measured.
        date: Option<String>,
        /// The subject of the measurement in the file.
        found: String,
    },
}

impl Progress {
    /// Nothing measured yet.
    pub fn new(what: &str) -> Self {
        Self {
            what: what.into(),
            ends: Vec::new(),
            open_ends: Vec::new(),
            q: Vec::new(),
            points: Vec::new(),
            date: None,
            before: None,
        }
    }

    /// Returns true if nothing has been measured.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty() && self.points.iter().all(|point| point.repeats.is_empty() && point.open.is_none())
    }

    /// Starts over, but remembers what is still to be put back on the board.
    pub fn anew(self, what: &str) -> Self {
        Self { before: self.before, ..Self::new(what) }
    }

    /// Reads the file at `path` when it exists, whatever it measures.
    pub fn read(path: &Path) -> Result<Option<Self>, ProgressError> {
        let file = |reason: String| ProgressError::File { path: path.display().to_string(), reason };
        match haptic_host::input::read_to_string(path) {
            Ok(text) => serde_json::from_str(&text).map(Some).map_err(|e| file(e.to_string())),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(file(error.to_string())),
        }
    }

    /// Reads the file at `path` if it exists, else begins with no results.
    pub fn open(path: &Path, what: &str) -> Result<Self, ProgressError> {
        match Self::read(path)? {
            None => Ok(Self::new(what)),
            Some(found) if found.what == what => Ok(found),
            Some(found) if found.is_empty() => Ok(found.anew(what)),
            Some(Self { what: found, date, .. }) => {
                Err(ProgressError::Another { path: path.display().to_string(), date, found })
            }
        }
    }

    /// Notes that something was measured now.
    pub fn now(&mut self) {
        self.date = Some(output::date());
    }

    /// Writes the file, whole or not at all.
    pub fn save(&self, path: &Path) -> Result<(), ProgressError> {
        let text = serde_json::to_string_pretty(self).map_err(|e| ProgressError::Unwritten(Failure::impossible(e)))?;
        output::write(path, text.as_bytes(), Overwrite::Replace).map_err(ProgressError::Unwritten)
    }

    /// The damping at which the range of a mode ends, if that was measured.
    pub fn end(&self, mode: FeedForward) -> Option<f64> {
        self.ends.iter().find(|(measured, _)| *measured == mode).map(|(_, end)| *end)
    }

    /// The measured points of a mode, by damping.
    pub fn of(&self, mode: FeedForward) -> Vec<&Point> {
        self.all(mode).into_iter().filter(|point| !point.repeats.is_empty()).collect()
    }

    /// The points of a mode, also those where no boundary was found, by damping.
    pub fn all(&self, mode: FeedForward) -> Vec<&Point> {
        let mut found: Vec<&Point> =
            self.points.iter().filter(|p| p.mode == mode && !(p.repeats.is_empty() && p.open.is_none())).collect();
        found.sort_by(|a, b| a.kd.total_cmp(&b.kd));
        found
    }

    /// The point of a mode at a damping, added when it is new.
    pub fn point(&mut self, mode: FeedForward, kd: f64) -> &mut Point {
        let found = self.points.iter().position(|p| p.mode == mode && same_damping(p.kd, kd));
        let index = found.unwrap_or_else(|| {
            self.points.push(Point { mode, kd, repeats: Vec::new(), vibration_m: None, open: None });
            self.points.len() - 1
        });
        &mut self.points[index]
    }
}

/// Returns true if two dampings (N s/m) are equal but for rounding in a file.
pub(super) fn same_damping(one: f64, other: f64) -> bool {
    (one - other).abs() <= 1e-9 * other.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_goes_on_where_it_stopped_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("progress.json");
        let mut progress = Progress::open(&path, "one").unwrap();
        progress.point(FeedForward::Off, 0.1 + 0.2).repeats.extend([3.0, 1.0, 2.0]);
        progress.save(&path).unwrap();
        let mut again = Progress::open(&path, "one").unwrap();
        assert_eq!(again, progress);
        assert_eq!(again.point(FeedForward::Off, 0.3).median(), 2.0);
        assert_eq!(again.point(FeedForward::Off, 0.3).bounds(), (1.0, 3.0));
        assert!(matches!(Progress::open(&path, "other"), Err(ProgressError::Another { .. })));
        // A file without results does not block another measurement.
        Progress::new("one").save(&path).unwrap();
        assert_eq!(Progress::open(&path, "other").unwrap(), Progress::new("other"));
    }
}
