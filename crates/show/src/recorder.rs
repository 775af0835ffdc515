//! Recordings: telemetry rows in a file that is consistent at every moment, CSV or MCAP ([`mcap`]) by its extension.
//!
//! Rows of a CSV file reach the file in blocks of complete lines. On a full disk the file is truncated to its last
//! complete line. A file whose writer was killed is readable up to its last complete line.

pub mod about;
pub mod mcap;
pub mod protobuf;

use about::About;
use haptic_bridge::board::telemetry::Field;
use haptic_host::error::Failure;
use haptic_host::link::{Column, Losses};
use haptic_host::output::{self, Overwrite};
use haptic_host::words::counted;
use mcap::McapRecorder;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Number of gathered bytes at which a block is written; `flush` writes it earlier.
const BLOCK_BYTES: usize = 64 * 1024;

/// Names of the states in a recording, by their numbers.
pub const STATES: [&str; 5] = ["Disarmed", "Armed", "CheckingPolarity", "Fault", "Homing"];

/// A number or a name in a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A number in double precision.
    Number(f64),
    /// A number in the board's single precision, with the fewest digits that identify it.
    Single(f32),
    /// One of a fixed set of words.
    Word(&'static str),
}

impl Value {
    /// Converts a number of a column: a state to its name, a measured value to the board's precision.
    pub fn of(column: &Column, value: f64) -> Self {
        let state = (column.field == Field::State && column.axis == 0).then(|| STATES.get(value as usize)).flatten();
        match (state, column.field) {
            (Some(state), _) => Self::Word(state),
            (None, Field::Counts | Field::State) => Self::Number(value),
            (None, _) => Self::Single(value as f32),
        }
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Single(small) if *small != 0.0 && small.abs() < 1e-4 => write!(f, "{small:e}"),
            Self::Single(number) => write!(f, "{number}"),
            Self::Word(word) => f.write_str(word),
        }
    }
}

#[derive(Debug)]
enum Sink {
    /// `complete`: bytes of complete lines in the file; `None` if it cannot be truncated (a pipe).
    File {
        file: File,
        complete: Option<u64>,
    },
    StandardOutput,
}

/// A CSV file being written.
#[derive(Debug)]
pub struct Recorder {
    sink: Sink,
    path: PathBuf,
    block: String,
    columns: usize,
    has_comments: bool,
    /// Number of rows in the file, and number of rows in the block.
    rows: u64,
    /// Number of rows in the block.
    gathered: u64,
    /// Written bytes.
    bytes: u64,
}

/// Reason why rows could not be written.
#[derive(Debug)]
pub enum RecordError {
    /// The reader has closed the pipe, which is no error.
    ReaderGone,
    /// Any other failure.
    Failed(Failure),
}

impl Recorder {
    /// Creates the file (`-`: standard output) and writes `about` as comment lines (`# …`) and the names of the
    /// columns. With an empty `about` the file has no comments at all.
    pub fn create(path: &Path, about: &str, columns: &[String], overwrite: Overwrite) -> Result<Self, Failure> {
        let sink = if path == Path::new("-") {
            Sink::StandardOutput
        } else {
            let (file, can_truncate) = output::open(path, overwrite)?;
            Sink::File { file, complete: can_truncate.then_some(0) }
        };
        let mut recorder = Self {
            sink,
            path: path.into(),
            block: String::new(),
            columns: columns.len(),
            has_comments: !about.is_empty(),
            rows: 0,
            gathered: 0,
            bytes: 0,
        };
        recorder.add_comment(about);
        recorder.block.push_str(&columns.join(","));
        recorder.block.push('\n');
        match recorder.flush() {
            Err(RecordError::Failed(failure)) => {
                // Removes the file, which is useless without its head.
                if let (Sink::File { complete: Some(_), .. }, Ok(file)) = (&recorder.sink, std::fs::canonicalize(path))
                {
                    let _ = std::fs::remove_file(file);
                }
                Err(failure)
            }
            // The first row returns this error again, and the caller handles it there.
            Ok(()) | Err(RecordError::ReaderGone) => Ok(recorder),
        }
    }

    /// Adds comment lines, if the file has any.
    pub fn add_comment(&mut self, text: &str) {
        for line in text.lines().filter(|_| self.has_comments) {
            self.block.push_str("# ");
            self.block.push_str(line);
            self.block.push('\n');
        }
    }

    /// Adds a row with one value per column; missing values are left empty, extra ones ignored.
    pub fn add_row(&mut self, values: &[Value]) -> Result<(), RecordError> {
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
        if self.block.len() >= BLOCK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Writes the gathered rows. If not all of them fit, keeps the complete lines that fit.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        let block = std::mem::take(&mut self.block);
        let gathered = std::mem::take(&mut self.gathered);
        let failed = |path: &Path, error: io::Error| match error.kind() {
            io::ErrorKind::BrokenPipe => RecordError::ReaderGone,
            _ => RecordError::Failed(output::write_failure(path, &error)),
        };
        match &mut self.sink {
            Sink::StandardOutput => {
                let mut out = io::stdout().lock();
                out.write_all(block.as_bytes())
                    .and_then(|()| out.flush())
                    .map_err(|error| failed(&self.path, error))?;
                self.rows += gathered;
                self.bytes += block.len() as u64;
                Ok(())
            }
            Sink::File { file, complete } => {
                let Err(error) = file.write_all(block.as_bytes()) else {
                    self.rows += gathered;
                    self.bytes += block.len() as u64;
                    complete.iter_mut().for_each(|complete| *complete += block.len() as u64);
                    return Ok(());
                };
                if let Some(complete) = complete {
                    let mut end = *complete;
                    let truncate =
                        |file: &mut File, end: u64| file.set_len(end).and_then(|()| file.seek(SeekFrom::Start(end)));
                    let _ = truncate(file, end);
                    for line in block.split_inclusive('\n') {
                        if file.write_all(line.as_bytes()).is_err() {
                            let _ = truncate(file, end);
                            break;
                        }
                        end += line.len() as u64;
                        self.rows += u64::from(line.starts_with(|c: char| c.is_ascii_digit()));
                    }
                    *complete = end;
                    self.bytes = end;
                }
                Err(failed(&self.path, error))
            }
        }
    }

    /// Returns the number of rows in the file.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Returns the number of bytes in the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Describes the destination of the rows.
    pub fn destination(&self) -> String {
        match self.sink {
            Sink::StandardOutput => "standard output".into(),
            Sink::File { .. } => self.path.display().to_string(),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.flush();
    }
}

/// A writer of telemetry in either format.
#[derive(Debug)]
pub enum RowWriter {
    /// CSV, with its columns.
    Csv(Box<Recorder>, Vec<Column>),
    /// MCAP.
    Mcap(Box<McapRecorder>),
}

/// Returns true if a file of this name is MCAP.
pub fn is_mcap(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

impl RowWriter {
    /// Creates the file in the format of its extension (`-`: CSV to standard output).
    pub fn create(path: &Path, about: &About, columns: &[Column], overwrite: Overwrite) -> Result<Self, Failure> {
        if is_mcap(path) {
            return Ok(Self::Mcap(Box::new(McapRecorder::create(path, about, columns, overwrite)?)));
        }
        let labels = columns.iter().map(|column| column.label.clone());
        let names: Vec<String> = ["step".to_string(), "time_s".into()].into_iter().chain(labels).collect();
        Ok(Self::Csv(Box::new(Recorder::create(path, about.text(), &names, overwrite)?), columns.to_vec()))
    }

    /// Adds a row: its step, its time since the first row (s), and a number for each column.
    pub fn add_row(&mut self, step: u32, time: f64, row: &[f64]) -> Result<(), RecordError> {
        match self {
            Self::Mcap(recorder) => recorder.add_row(step, time, row),
            Self::Csv(recorder, columns) => {
                let values = columns.iter().zip(row).map(|(column, value)| match Value::of(column, *value) {
                    Value::Word(_) if !recorder.has_comments => Value::Number(*value),
                    value => value,
                });
                let row: Vec<Value> =
                    [Value::Number(f64::from(step)), Value::Number(time)].into_iter().chain(values).collect();
                recorder.add_row(&row)
            }
        }
    }

    /// Adds an event at a time since the first row (s).
    pub fn add_event(&mut self, time: f64, words: &str) -> Result<(), RecordError> {
        match self {
            Self::Mcap(recorder) => recorder.add_event(time, words),
            Self::Csv(recorder, _) => {
                recorder.add_comment(&format!("{time} s: {words}"));
                Ok(())
            }
        }
    }

    /// Writes the gathered rows.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        match self {
            Self::Mcap(recorder) => recorder.flush(),
            Self::Csv(recorder, _) => recorder.flush(),
        }
    }

    /// Writes the summary, which ends the file.
    pub fn end(&mut self, words: &str, losses: &Losses) -> Result<(), RecordError> {
        match self {
            Self::Mcap(recorder) => recorder.end(words, losses),
            Self::Csv(recorder, _) => {
                recorder.add_comment(words);
                recorder.flush()
            }
        }
    }

    /// Returns the number of rows in the file.
    pub fn rows(&self) -> u64 {
        match self {
            Self::Mcap(recorder) => recorder.rows(),
            Self::Csv(recorder, _) => recorder.rows(),
        }
    }

    /// Returns the number of bytes in the file.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::Mcap(recorder) => recorder.bytes(),
            Self::Csv(recorder, _) => recorder.bytes(),
        }
    }

    /// Describes the destination of the rows.
    pub fn destination(&self) -> String {
        match self {
            Self::Mcap(recorder) => recorder.path().display().to_string(),
            Self::Csv(recorder, _) => recorder.destination(),
        }
    }
}

/// A recording read from a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Comment lines, without their `# `.
    pub about: Vec<String>,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows of numbers; a state is its index in [`STATES`].
    pub rows: Vec<Vec<f64>>,
    /// True if the file is cut short: a partial last line or chunk is left out.
    pub torn: bool,
}

impl Recording {
    /// Reads a file of either format. Errors name the file.
    pub fn load(path: &Path) -> Result<Self, Failure> {
        let name = path.display();
        let bytes = haptic_host::input::read_recording(path).map_err(|error| {
            Failure::wrong(format!("{name} cannot be read: {error}")).remedy("name a recording, a .mcap or .csv file")
        })?;
        let read = if bytes.starts_with(mcap::MAGIC) {
            mcap::parse(&bytes)
        } else {
            String::from_utf8(bytes).map_err(|_| "neither MCAP nor text".into()).and_then(|text| Self::parse(&text))
        };
        let recording = read.map_err(|why| {
            Failure::wrong(format!("{name}: {why}")).remedy("name a file that `haptic record` or `haptic stream` wrote")
        })?;
        if recording.columns.is_empty() {
            return Err(Failure::wrong(format!("{name} is not a recording")).remedy("name a file of `haptic record`"));
        }
        Ok(recording)
    }

    /// Returns the rest of the first comment line that begins with this word.
    pub fn header_value(&self, word: &str) -> Option<&str> {
        self.about.iter().find_map(|line| line.strip_prefix(word)?.strip_prefix(' '))
    }

    /// Returns the control rate of the board, Hz.
    pub fn rate_hz(&self) -> Option<f64> {
        self.header_value("control rate")?.split(' ').next()?.parse().ok()
    }

    /// Returns the index of a column.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// Parses the text of a recording up to its last complete line. Errors name the line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut recording = Self::default();
        let complete = text.rfind('\n').map_or(0, |end| end + 1);
        recording.torn = complete < text.len();
        let number = |field: &str| {
            let state = STATES.iter().position(|state| *state == field);
            state.map_or_else(|| field.parse().ok(), |state| Some(state as f64))
        };
        for (line_number, line) in text[..complete].lines().enumerate() {
            if let Some(comment) = line.strip_prefix('#') {
                recording.about.push(comment.trim().into());
            } else if recording.columns.is_empty() {
                recording.columns = line.split(',').map(Into::into).collect();
                if recording.columns.iter().any(String::is_empty) {
                    return Err(format!("line {} does not name the columns of a recording", line_number + 1));
                }
            } else {
                let row: Option<Vec<f64>> = line.split(',').map(number).collect();
                match row {
                    Some(row) if row.len() == recording.columns.len() => recording.rows.push(row),
                    _ => {
                        let values = counted(recording.columns.len(), "value");
                        return Err(format!("line {}: expected {values}", line_number + 1));
                    }
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
        vec!["step".into(), "force_n".into(), "state".into()]
    }

    #[test]
    fn recorded_values_are_read_back_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.csv");
        let mut recorder = Recorder::create(&path, "a device\n20 kHz", &columns(), Overwrite::Never).unwrap();
        for step in 0..10_000 {
            let force = 0.1 * f64::from(step) / 3.0;
            recorder.add_row(&[Value::Number(f64::from(step)), Value::Number(force), Value::Word("Fault")]).unwrap();
        }
        recorder.add_comment("10000 rows");
        drop(recorder);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\n1,0.03333333333333333,Fault\n"), "{}", &text[..200]);
        let recording = Recording::parse(&text).unwrap();
        assert_eq!(recording.about, ["a device", "20 kHz", "10000 rows"]);
        assert_eq!(recording.columns, columns());
        assert_eq!(recording.rows.len(), 10_000);
        assert_eq!(recording.rows[9_999], [9999.0, 0.1 * 9999.0 / 3.0, 3.0]);
        assert!(!recording.torn);
        assert!(Recorder::create(&path, "", &columns(), Overwrite::Never).is_err(), "a recording is not overwritten");
    }

    #[test]
    fn single_precision_is_written_with_its_own_digits() {
        for (value, text) in [(0.1, "0.1"), (-1.862_645_1e-9, "-1.8626451e-9"), (0.0, "0"), (2.5e7, "25000000")] {
            assert_eq!(Value::Single(value).to_string(), text);
            assert_eq!(text.parse::<f32>().unwrap(), value);
        }
    }

    #[test]
    fn torn_recordings_are_read_up_to_the_last_complete_line() {
        let recording = Recording::parse("# x\nstep,force_n\n1,2\n3,4\n5,6.1").unwrap();
        assert_eq!(recording.rows, [[1.0, 2.0], [3.0, 4.0]]);
        assert!(recording.torn);
        assert!(Recording::parse("step,force_n\n1\n").is_err());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_an_error_with_a_remedy() {
        let refused = Recorder::create(Path::new("/dev/full"), "", &columns(), Overwrite::Never).unwrap_err();
        assert!(refused.to_string().contains("/dev/full cannot be written"), "{refused}");
        assert!(refused.to_string().contains("free space"), "{refused}");
    }
}
