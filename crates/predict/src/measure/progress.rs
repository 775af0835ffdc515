//! Results of a measurement so far, saved after every repeat, so that an interrupted measurement can continue.

use super::earlier_settings::RestorePoint;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_host::output::{self, Overwrite};
use serde::{Deserialize, Serialize};
use std::path::Path;
use thiserror::Error;

/// All repeats for one feed-forward and damping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Feed-forward of the walls.
    pub mode: FeedForward,
    /// Damping, N s/m.
    pub kd: f64,
    /// Largest stable stiffness of each repeat, N/m. The repeats use the pulls in turn.
    pub repeats: Vec<f64>,
    /// Largest vibration just beyond the boundary, m from peak to peak; `None` if all motions grew.
    #[serde(default)]
    pub vibration_m: Option<f64>,
    /// Reason why the search ended early; `None` if the search found the boundary.
    #[serde(default)]
    pub open: Option<UnfinishedSearch>,
}

/// A search that ended without a boundary.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnfinishedSearch {
    /// Largest stable stiffness, N/m.
    pub stable_up_to: f64,
    /// Text of the error that ended the search.
    pub reason: String,
}

impl Point {
    /// Returns the median of all repeats; 0 without repeats.
    pub fn median(&self) -> f64 {
        median(&self.repeats)
    }

    /// Returns the lowest and the highest of all repeats.
    pub fn bounds(&self) -> (f64, f64) {
        bounds(&self.repeats)
    }
}

/// Returns the median of repeats; 0 without repeats.
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

/// Returns the lowest and the highest of some repeats.
#[must_use]
pub fn bounds(repeats: &[f64]) -> (f64, f64) {
    let low = repeats.iter().copied().fold(f64::INFINITY, f64::min);
    let high = repeats.iter().copied().fold(0.0, f64::max);
    (low.min(high), high)
}

/// State of a measurement, finished or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Description of the measurement. Only a measurement with the same description continues the file.
    pub what: String,
    /// Largest stable damping of each mode for which it was measured, N s/m.
    #[serde(default)]
    pub ends: Vec<(FeedForward, f64)>,
    /// Modes whose largest stable damping was not found, and the reason.
    #[serde(default)]
    pub open_ends: Vec<(FeedForward, String)>,
    /// Joint angles of the measurement, rad.
    #[serde(default)]
    pub q: Vec<f64>,
    /// Points with their repeats so far.
    pub points: Vec<Point>,
    /// Time of the last result (RFC 3339, UTC).
    #[serde(default)]
    pub date: Option<String>,
    /// Settings of the board to restore; `None` after they are restored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<RestorePoint>,
}

/// Reason why a progress file cannot be used.
#[derive(Debug, Error)]
pub enum ProgressError {
    /// The file cannot be read.
    #[error("{path} is not a progress file: {reason}")]
    File {
        /// Path of the file.
        path: String,
        /// Message of the operating system or of the parser.
        reason: String,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Unwritten(Failure),
    /// The file belongs to another measurement.
    #[error("{path} holds another measurement{} ({found})", date.as_ref().map_or(String::new(), |date| format!(", of {date}")))]
    Another {
        /// Path of the file.
        path: String,
        /// Time of the file's last result.
        date: Option<String>,
        /// Description of the measurement in the file.
        found: String,
    },
}

impl Progress {
    /// Returns an empty progress for this measurement.
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

    /// Returns true if the progress has no results.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty() && self.points.iter().all(|point| point.repeats.is_empty() && point.open.is_none())
    }

    /// Removes the results, and keeps the settings to restore on the board.
    pub fn without_results(self, what: &str) -> Self {
        Self { before: self.before, ..Self::new(what) }
    }

    /// Reads the file of any measurement at `path`; returns `None` if the file does not exist.
    pub fn read(path: &Path) -> Result<Option<Self>, ProgressError> {
        let file = |reason: String| ProgressError::File { path: path.display().to_string(), reason };
        match haptic_host::input::read_to_string(path) {
            Ok(text) => serde_json::from_str(&text).map(Some).map_err(|e| file(e.to_string())),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(file(error.to_string())),
        }
    }

    /// Reads the file of this measurement at `path`, or returns an empty progress if the file does not exist.
    pub fn open(path: &Path, what: &str) -> Result<Self, ProgressError> {
        match Self::read(path)? {
            None => Ok(Self::new(what)),
            Some(found) if found.what == what => Ok(found),
            Some(found) if found.is_empty() => Ok(found.without_results(what)),
            Some(Self { what: found, date, .. }) => {
                Err(ProgressError::Another { path: path.display().to_string(), date, found })
            }
        }
    }

    /// Sets the time of the last result to the present time.
    pub fn set_date(&mut self) {
        self.date = Some(output::date());
    }

    /// Writes the complete file or nothing.
    pub fn save(&self, path: &Path) -> Result<(), ProgressError> {
        let text = serde_json::to_string_pretty(self).map_err(|e| ProgressError::Unwritten(Failure::impossible(e)))?;
        output::write(path, text.as_bytes(), Overwrite::Replace).map_err(ProgressError::Unwritten)
    }

    /// Returns the largest stable damping of a mode, if it was measured.
    pub fn end(&self, mode: FeedForward) -> Option<f64> {
        self.ends.iter().find(|(measured, _)| *measured == mode).map(|(_, end)| *end)
    }

    /// Returns the points of a mode with a boundary, in order of damping.
    pub fn of(&self, mode: FeedForward) -> Vec<&Point> {
        self.points_of_mode(mode).into_iter().filter(|point| !point.repeats.is_empty()).collect()
    }

    /// Returns the points of a mode with or without a boundary, in order of damping.
    pub fn points_of_mode(&self, mode: FeedForward) -> Vec<&Point> {
        let mut found: Vec<&Point> =
            self.points.iter().filter(|p| p.mode == mode && !(p.repeats.is_empty() && p.open.is_none())).collect();
        found.sort_by(|a, b| a.kd.total_cmp(&b.kd));
        found
    }

    /// Returns the point of a mode at a damping, after adding the point if it does not exist.
    pub fn point(&mut self, mode: FeedForward, kd: f64) -> &mut Point {
        let found = self.points.iter().position(|p| p.mode == mode && same_damping(p.kd, kd));
        let index = found.unwrap_or_else(|| {
            self.points.push(Point { mode, kd, repeats: Vec::new(), vibration_m: None, open: None });
            self.points.len() - 1
        });
        &mut self.points[index]
    }
}

/// Returns true if two dampings (N s/m) differ only by the rounding in a file.
pub(super) fn same_damping(one: f64, other: f64) -> bool {
    (one - other).abs() <= 1e-9 * other.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_measurement_continues_a_file() {
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
