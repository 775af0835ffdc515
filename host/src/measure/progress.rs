//! What has been measured so far, kept in a file after every repeat so that an interrupted measurement goes on where it
//! stopped.

use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// One feed-forward mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Without.
    Off,
    /// Equation (4).
    Full,
    /// Equation (4) behind a washout.
    Washout,
}

/// All repeats at one damping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// With which feed-forward.
    pub mode: Mode,
    /// Damping, N s/m.
    pub kd: f64,
    /// Largest stable stiffness of each repeat, N/m.
    pub repeats: Vec<f64>,
}

impl Point {
    /// Median of the repeats; zero without any.
    pub fn median(&self) -> f64 {
        let mut sorted = self.repeats.clone();
        sorted.sort_by(f64::total_cmp);
        match (sorted.len(), sorted.len() / 2) {
            (0, _) => 0.0,
            (n, half) if n % 2 == 1 => sorted[half],
            (_, half) => (sorted[half - 1] + sorted[half]) / 2.0,
        }
    }

    /// Lowest and highest repeat.
    pub fn bounds(&self) -> (f64, f64) {
        let low = self.repeats.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.repeats.iter().copied().fold(0.0, f64::max);
        (low.min(high), high)
    }
}

/// A measurement, finished or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// What is measured: device, pose, loop. A file of something else is not continued.
    pub what: String,
    /// Dampings at which the range ends, N s/m, where they were measured.
    #[serde(default)]
    pub ends: Vec<(Mode, f64)>,
    /// The points with their repeats so far.
    pub points: Vec<Point>,
}

/// Why a file cannot be used.
#[derive(Debug, Error)]
pub enum ProgressError {
    /// Not readable or writable.
    #[error("{path}: {reason}")]
    File {
        /// Which.
        path: String,
        /// What the system or the parser says.
        reason: String,
    },
    /// It belongs to something else.
    #[error("{path} holds another measurement ({found}); remove it or choose another file with --progress")]
    Another {
        /// Which.
        path: String,
        /// What it measures.
        found: String,
    },
}

impl From<ProgressError> for crate::error::Failure {
    fn from(error: ProgressError) -> Self {
        Self::wrong(error)
    }
}

impl Progress {
    /// Nothing measured yet.
    pub fn new(what: &str) -> Self {
        Self { what: what.into(), ends: Vec::new(), points: Vec::new() }
    }

    /// Reads the file at `path` when it exists, else begins anew.
    pub fn open(path: &Path, what: &str) -> Result<Self, ProgressError> {
        let file = |reason: String| ProgressError::File { path: path.display().to_string(), reason };
        match std::fs::read_to_string(path) {
            Ok(text) => {
                let found: Self = serde_json::from_str(&text).map_err(|e| file(e.to_string()))?;
                if found.what != what {
                    return Err(ProgressError::Another { path: path.display().to_string(), found: found.what });
                }
                Ok(found)
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Self::new(what)),
            Err(error) => Err(file(error.to_string())),
        }
    }

    /// Writes the file, whole or not at all.
    pub fn save(&self, path: &Path) -> Result<(), ProgressError> {
        let file = |reason: String| ProgressError::File { path: path.display().to_string(), reason };
        let text = serde_json::to_string_pretty(self).map_err(|e| file(e.to_string()))?;
        let beside = path.with_extension("part");
        std::fs::write(&beside, text).and_then(|()| std::fs::rename(&beside, path)).map_err(|e| file(e.to_string()))
    }

    /// Where the range of a mode ends, if that was measured.
    pub fn end(&self, mode: Mode) -> Option<f64> {
        self.ends.iter().find(|(measured, _)| *measured == mode).map(|(_, end)| *end)
    }

    /// The points of a mode, by damping.
    pub fn of(&self, mode: Mode) -> Vec<&Point> {
        let mut found: Vec<&Point> = self.points.iter().filter(|p| p.mode == mode && !p.repeats.is_empty()).collect();
        found.sort_by(|a, b| a.kd.total_cmp(&b.kd));
        found
    }

    /// The point of a mode at a damping, added when it is new.
    pub fn point(&mut self, mode: Mode, kd: f64) -> &mut Point {
        let found = self.points.iter().position(|p| p.mode == mode && (p.kd - kd).abs() <= 1e-9 * kd.abs());
        let index = found.unwrap_or_else(|| {
            self.points.push(Point { mode, kd, repeats: Vec::new() });
            self.points.len() - 1
        });
        &mut self.points[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_goes_on_where_it_stopped_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("progress.json");
        let mut progress = Progress::open(&path, "one").unwrap();
        progress.point(Mode::Off, 0.1 + 0.2).repeats.extend([3.0, 1.0, 2.0]);
        progress.save(&path).unwrap();
        let mut again = Progress::open(&path, "one").unwrap();
        assert_eq!(again, progress);
        assert_eq!(again.point(Mode::Off, 0.3).median(), 2.0);
        assert_eq!(again.point(Mode::Off, 0.3).bounds(), (1.0, 3.0));
        assert!(matches!(Progress::open(&path, "other"), Err(ProgressError::Another { .. })));
    }
}
