//! Recordings: telemetry rows in a CSV file that is whole at every moment.
//!
//! Rows reach the file in blocks of whole lines; a block that could not be written (a full disk) is taken back. A file
//! whose writer was killed in the middle of a block is still read up to its last whole line.

use crate::error::Failure;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes gathered before they are written; `flush` writes them earlier.
const BLOCK: usize = 64 * 1024;

/// A CSV file being written.
#[derive(Debug)]
pub struct Recorder {
    file: File,
    path: PathBuf,
    block: String,
    /// Length of the file in whole lines, bytes; `None` when it cannot be cut (a pipe).
    whole: Option<u64>,
    columns: usize,
    /// Rows in the file, and in the block.
    rows: u64,
    gathered: u64,
}

impl Recorder {
    /// Creates the file and writes `about` as comment lines (`# …`) and the names of the columns.
    pub fn create(path: &Path, about: &str, columns: &[String]) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| cannot_write(path, &error))?;
        let whole = file.metadata().ok().filter(|about| about.is_file()).map(|_| 0);
        let mut recorder =
            Self { file, path: path.into(), block: String::new(), whole, columns: columns.len(), rows: 0, gathered: 0 };
        for line in about.lines() {
            recorder.block.push_str("# ");
            recorder.block.push_str(line);
            recorder.block.push('\n');
        }
        recorder.block.push_str(&columns.join(","));
        recorder.block.push('\n');
        recorder.flush()?;
        Ok(recorder)
    }

    /// Adds a row of as many numbers as there are columns; missing ones are left empty, further ones left out.
    pub fn row(&mut self, values: &[f64]) -> Result<(), Failure> {
        for column in 0..self.columns {
            if column > 0 {
                self.block.push(',');
            }
            if let Some(value) = values.get(column) {
                // Writing to a string cannot fail.
                let _ = write!(self.block, "{value}");
            }
        }
        self.block.push('\n');
        self.gathered += 1;
        if self.block.len() >= BLOCK { self.flush() } else { Ok(()) }
    }

    /// Writes what was gathered. On an error the file is cut back to its last whole line.
    pub fn flush(&mut self) -> Result<(), Failure> {
        let written = self.file.write_all(self.block.as_bytes());
        let gathered = std::mem::take(&mut self.gathered);
        match written {
            Ok(()) => {
                self.rows += gathered;
                if let Some(whole) = &mut self.whole {
                    *whole += self.block.len() as u64;
                }
                self.block.clear();
                Ok(())
            }
            Err(error) => {
                self.block.clear();
                if let Some(whole) = self.whole {
                    let _ = self.file.set_len(whole).and_then(|()| self.file.seek(SeekFrom::End(0)));
                }
                Err(cannot_write(&self.path, &error))
            }
        }
    }

    /// Rows that are in the file.
    pub fn rows(&self) -> u64 {
        self.rows
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.flush();
    }
}

fn cannot_write(path: &Path, error: &io::Error) -> Failure {
    Failure::impossible(format!("{} cannot be written: {error}", path.display()))
        .remedy("what was recorded before is kept; free space or choose another file")
}

/// A recording that was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// The comment lines, without their `# `.
    pub about: Vec<String>,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// The rows.
    pub rows: Vec<Vec<f64>>,
    /// The file ended within a line, which was left out.
    pub torn: bool,
}

impl Recording {
    /// Reads the text of a recording up to its last whole line. Errors name the line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut recording = Self::default();
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        recording.torn = whole < text.len();
        for (number, line) in text[..whole].lines().enumerate() {
            if let Some(comment) = line.strip_prefix('#') {
                recording.about.push(comment.trim().into());
            } else if recording.columns.is_empty() {
                recording.columns = line.split(',').map(Into::into).collect();
            } else {
                let row: Result<Vec<f64>, _> = line.split(',').map(str::parse).collect();
                match row {
                    Ok(row) if row.len() == recording.columns.len() => recording.rows.push(row),
                    _ => return Err(format!("line {}: not {} numbers", number + 1, recording.columns.len())),
                }
            }
        }
        Ok(recording)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> Vec<String> {
        vec!["step".into(), "force_n".into()]
    }

    #[test]
    fn what_is_recorded_is_read_back_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        let mut recorder = Recorder::create(&path, "a device\n20 kHz", &columns()).unwrap();
        for step in 0..10_000 {
            recorder.row(&[f64::from(step), 0.1 * f64::from(step) / 3.0]).unwrap();
        }
        drop(recorder);
        let recording = Recording::parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(recording.about, ["a device", "20 kHz"]);
        assert_eq!(recording.columns, columns());
        assert_eq!(recording.rows.len(), 10_000);
        assert_eq!(recording.rows[9_999], [9999.0, 0.1 * 9999.0 / 3.0]);
        assert!(!recording.torn);
    }

    #[test]
    fn a_torn_recording_is_read_up_to_its_last_whole_line() {
        let recording = Recording::parse("# x\nstep,force_n\n1,2\n3,4\n5,6.1").unwrap();
        assert_eq!(recording.rows, [[1.0, 2.0], [3.0, 4.0]]);
        assert!(recording.torn);
        assert!(Recording::parse("step,force_n\n1\n").is_err());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_an_error_with_a_remedy() {
        let refused = Recorder::create(Path::new("/dev/full"), "", &columns()).unwrap_err();
        assert!(refused.to_string().contains("/dev/full cannot be written"), "{refused}");
    }
}
