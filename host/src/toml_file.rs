//! TOML files whose values have positions, so that every error names the file, the line and the remedy.
//!
//! [`Document`] parses a text; [`Table`] returns typed values and refuses unknown keys. Device files and scene files
//! are read with both. [`Table::keep`] stores an error and lets reading continue, so that all errors of a file are
//! reported at once.

pub use crate::file_error::{FileError, Problem};
use crate::file_error::{ForeignFormat, nearest};
use core::ops::Range;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The condition that a number must meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Must {
    /// Any finite number.
    BeFinite,
    /// Zero or more.
    NotBeNegative,
    /// More than zero.
    BePositive,
}

/// The text of a file, and its path.
#[derive(Clone, Debug)]
pub struct Document {
    path: PathBuf,
    text: String,
}

impl Document {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let whole = |problem| FileError::new(path.into(), None, problem);
        let bytes = crate::input::read(path).map_err(|error| {
            let why = error.to_string();
            whole(if error.kind() == std::io::ErrorKind::Other {
                Problem::NotReadableFile(why)
            } else {
                Problem::Unreadable(why)
            })
        })?;
        String::from_utf8(bytes).map(|text| Self { path: path.into(), text }).map_err(|error| {
            let good = error.utf8_error().valid_up_to();
            let before = String::from_utf8_lossy(&error.as_bytes()[..good]).into_owned();
            FileError::new(path.into(), Some(position(&before, before.len())), Problem::NotText)
        })
    }

    /// Creates a document from a text. Error messages name `origin` as the file.
    pub fn new(text: impl Into<String>, origin: impl Into<PathBuf>) -> Self {
        Self { path: origin.into(), text: text.into() }
    }
    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
    /// Returns the text.
    pub fn text(&self) -> &str {
        &self.text
    }
    /// Parses the text and calls `read` with its top table.
    pub fn read<T>(&self, read: impl FnOnce(&Table<'_>) -> Result<T, FileError>) -> Result<T, FileError> {
        let root = DeTable::parse(&self.text).map_err(|error| {
            if let Some(format) = ForeignFormat::of(&self.text) {
                return FileError::new(self.path.clone(), None, Problem::Foreign(format));
            }
            let span = error.span().unwrap_or(0..0);
            self.error(span, Problem::Syntax(error.message().to_string()))
        })?;
        let shared = RefCell::default();
        let entries = root.get_ref();
        let found = read(&Table { document: self, shared: &shared, place: String::new(), span: 0..0, entries });
        let mut errors = shared.into_inner().errors;
        errors.extend(found.as_ref().err().cloned());
        FileError::join(errors).map_or(found, Err)
    }

    /// Returns line and column of the value of a key, in `part` of the `index`-th table `table`. `part` and `table` may
    /// be empty. If the key is missing, returns the position of the table.
    pub fn find(&self, table: &str, index: Option<usize>, part: &str, key: &str) -> Option<(usize, usize)> {
        let root = DeTable::parse(&self.text).ok()?;
        let mut here = root.get_ref();
        let mut span = 0..0;
        for (name, index) in [(table, index), (part, None)] {
            if name.is_empty() {
                continue;
            }
            let found = here.get(name)?;
            let found = match (found.get_ref(), index) {
                (DeValue::Array(tables), Some(index)) => tables.get(index)?,
                _ => found,
            };
            span = found.span();
            here = found.get_ref().as_table()?;
        }
        Some(position(&self.text, here.get(key).map_or(span.start, |value| value.span().start)))
    }

    fn error(&self, span: Range<usize>, problem: Problem) -> FileError {
        FileError::new(self.path.clone(), Some(position(&self.text, span.start)), problem)
    }
}

/// Returns line and column (in characters), both from 1, of a byte offset.
fn position(text: &str, offset: usize) -> (usize, usize) {
    let mut offset = offset.min(text.len());
    while !text.is_char_boundary(offset) {
        offset -= 1;
    }
    let before = &text[..offset];
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// State that all tables of a document share.
#[derive(Debug, Default)]
struct Shared {
    errors: Vec<FileError>,
    /// Known keys at the top of the file.
    on_top: Vec<String>,
}

/// One table of a document.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    document: &'a Document,
    shared: &'a RefCell<Shared>,
    place: String,
    span: Range<usize>,
    entries: &'a DeTable<'a>,
}

impl<'a> Table<'a> {
    /// Changes the table's name in messages, such as to `[[link]] 1 (proximal-2)`.
    pub fn with_place(mut self, place: impl Into<String>) -> Self {
        self.place = place.into();
        self
    }
    /// Returns the table's name for messages.
    pub fn place(&self) -> &str {
        &self.place
    }
    /// Creates an error at the table's own line.
    pub fn error_here(&self, problem: Problem) -> FileError {
        self.document.error(self.span.clone(), problem)
    }
    /// Creates an error at the value of `key`, or at the table if the key is missing.
    pub fn error_at(&self, key: &str, problem: Problem) -> FileError {
        match self.entries.get(key) {
            Some(value) => self.document.error(value.span(), problem),
            None => self.error_here(problem),
        }
    }

    /// Creates an error at one number of the list `key`.
    pub fn error_at_element(&self, key: &str, element: usize, problem: Problem) -> FileError {
        match self.entries.get(key).map(|value| value.get_ref()) {
            Some(DeValue::Array(values)) if element < values.len() => {
                self.document.error(values[element].span(), problem)
            }
            _ => self.error_at(key, problem),
        }
    }

    /// Returns the value. If `value` is an error, stores the error, which refuses the file at the end, and returns
    /// `instead` so that reading continues.
    pub fn keep<T>(&self, value: Result<T, FileError>, instead: T) -> T {
        value.unwrap_or_else(|error| {
            self.shared.borrow_mut().errors.push(error);
            instead
        })
    }

    /// Returns the last stored error, if any, because the checks that follow need valid values.
    pub fn check_no_errors(&self) -> Result<(), FileError> {
        self.shared.borrow_mut().errors.pop().map_or(Ok(()), Err)
    }
    /// Stores an error for every key that is not in `known`. Returns true if every key is known.
    pub fn refuse_unknown_keys(&self, known: &[&str]) -> bool {
        let mut shared = self.shared.borrow_mut();
        let before = shared.errors.len();
        let all: Vec<String> = known.iter().map(ToString::to_string).collect();
        if self.place.is_empty() {
            shared.on_top.clone_from(&all);
        }
        for (key, value) in self.entries.iter().filter(|(key, _)| !known.contains(&key.get_ref().as_ref())) {
            let is_table = |value: &DeValue<'_>| matches!(value, DeValue::Table(_));
            let tables = match value.get_ref() {
                DeValue::Array(values) => values.iter().any(|value| is_table(value.get_ref())),
                value => is_table(value),
            };
            let problem = Problem::UnknownKey {
                key: key.get_ref().to_string(),
                place: self.place.clone(),
                nearest: nearest(key.get_ref(), &all),
                known: all.clone(),
                on_top: !tables && shared.on_top.iter().any(|known| known == key.get_ref()),
            };
            shared.errors.push(self.document.error(key.span(), problem));
        }
        shared.errors.len() == before
    }

    /// Returns true if the table has the key.
    pub fn has(&self, key: &str) -> bool {
        self.entries.contains_key(key)
    }
    /// Returns true if the value of the key is a string.
    pub fn is_string(&self, key: &str) -> bool {
        self.entries.get(key).is_some_and(|value| matches!(value.get_ref(), DeValue::String(_)))
    }
    /// Returns the value. If `value` is `None`, returns an error with `example` as the line to add.
    pub fn require<T>(&self, key: &str, value: Option<T>, example: impl Into<String>) -> Result<T, FileError> {
        value.ok_or_else(|| {
            self.error_here(Problem::MissingKey { key: key.into(), place: self.place.clone(), example: example.into() })
        })
    }

    /// Reads a required number. Returns NaN if the number is missing or wrong (see [`Table::keep`]).
    pub fn required_number(&self, key: &str, must: Must, example: impl Into<String>) -> f64 {
        self.keep(self.number(key, must).and_then(|value| self.require(key, value, example)), f64::NAN)
    }
    /// Reads a number. Returns `usual` if the number is missing or wrong (see [`Table::keep`]).
    pub fn number_or(&self, key: &str, must: Must, usual: f64) -> f64 {
        self.keep(self.number(key, must), None).unwrap_or(usual)
    }
    /// Reads `true` or `false`. Returns `usual` if the value is missing or wrong (see [`Table::keep`]).
    pub fn flag_or(&self, key: &str, usual: bool) -> bool {
        self.keep(self.flag(key), None).unwrap_or(usual)
    }
    fn wrong_type(&self, key: &str, expected: impl Into<String>, value: &Spanned<DeValue<'_>>) -> FileError {
        let problem = Problem::WrongType {
            key: key.into(),
            place: self.place.clone(),
            expected: expected.into(),
            found: type_name(value.get_ref()),
        };
        self.document.error(value.span(), problem)
    }

    /// Reads a string.
    pub fn string(&self, key: &str) -> Result<Option<&'a str>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::String(text) => Ok(Some(text.as_ref())),
                _ => Err(self.wrong_type(key, "a string in quotes", value)),
            },
        }
    }

    /// Reads a word of a fixed set and returns the meaning of the word.
    pub fn word<T: Copy>(&self, key: &str, words: &[(&str, T)]) -> Result<Option<T>, FileError> {
        let Some(found) = self.string(key)? else { return Ok(None) };
        match words.iter().find(|(word, _)| *word == found) {
            Some((_, meaning)) => Ok(Some(*meaning)),
            None => Err(self.error_at(
                key,
                Problem::UnknownWord {
                    key: key.into(),
                    place: self.place.clone(),
                    found: found.into(),
                    known: words.iter().map(|(word, _)| word.to_string()).collect(),
                },
            )),
        }
    }

    /// Reads a list of exactly `count` words of a fixed set and returns their meanings.
    pub fn words<T: Copy>(&self, key: &str, count: usize, words: &[(&str, T)]) -> Result<Option<Vec<T>>, FileError> {
        let Some(value) = self.entries.get(key) else { return Ok(None) };
        let known: Vec<String> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        let expected = || format!("a list of {count} of {}", known.join(", "));
        let DeValue::Array(values) = value.get_ref() else { return Err(self.wrong_type(key, expected(), value)) };
        let meaning = |value: &Spanned<DeValue<'_>>| match value.get_ref() {
            DeValue::String(text) => words.iter().find(|(word, _)| *word == text.as_ref()).map(|(_, meaning)| *meaning),
            _ => None,
        };
        match values.iter().map(meaning).collect::<Option<Vec<T>>>().filter(|found| found.len() == count) {
            Some(found) => Ok(Some(found)),
            None => Err(self.wrong_type(key, expected(), value)),
        }
    }

    /// Returns the length of the list under a key, or `None` if the key holds no list.
    pub fn count(&self, key: &str) -> Option<usize> {
        match self.entries.get(key)?.get_ref() {
            DeValue::Array(values) => Some(values.len()),
            _ => None,
        }
    }

    /// Reads `true` or `false`.
    pub fn flag(&self, key: &str) -> Result<Option<bool>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::Boolean(flag) => Ok(Some(*flag)),
                _ => Err(self.wrong_type(key, "true or false", value)),
            },
        }
    }

    /// Reads a number, which may be written as an integer.
    pub fn number(&self, key: &str, must: Must) -> Result<Option<f64>, FileError> {
        self.entries.get(key).map(|value| self.to_number(key, value, must, "a number")).transpose()
    }
    /// Reads a list of exactly `count` numbers. Error messages describe the numbers by `meaning`.
    pub fn numbers(&self, key: &str, count: usize, must: Must, meaning: &str) -> Result<Option<Vec<f64>>, FileError> {
        let Some(value) = self.entries.get(key) else { return Ok(None) };
        let expected = || match count {
            1 => format!("a list of one number ({meaning})"),
            _ => format!("a list of {count} numbers ({meaning})"),
        };
        let DeValue::Array(values) = value.get_ref() else {
            return Err(self.wrong_type(key, expected(), value));
        };
        let numbers = values
            .iter()
            .map(|value| self.to_number(key, value, must, &expected()))
            .collect::<Result<Vec<f64>, FileError>>()?;
        if numbers.len() != count {
            let problem = Problem::WrongLength {
                key: key.into(),
                place: self.place.clone(),
                expected: count,
                found: numbers.len(),
                meaning: meaning.into(),
            };
            return Err(self.document.error(value.span(), problem));
        }
        Ok(Some(numbers))
    }

    fn to_number(&self, key: &str, value: &Spanned<DeValue<'_>>, must: Must, expected: &str) -> Result<f64, FileError> {
        let number = match value.get_ref() {
            DeValue::Float(float) => float.as_str().parse::<f64>().unwrap_or(f64::NAN),
            DeValue::Integer(whole) => {
                i128::from_str_radix(whole.as_str(), whole.radix()).map_or(f64::NAN, |whole| whole as f64)
            }
            _ => return Err(self.wrong_type(key, expected, value)),
        };
        let error = |problem| Err(self.document.error(value.span(), problem));
        // Refuses numbers that would be infinite in the board's 32-bit floats.
        if !(number as f32).is_finite() {
            return error(Problem::NotFinite { key: key.into(), place: self.place.clone() });
        }
        let out_of_range = |must: &str| Problem::OutOfRange {
            key: key.into(),
            place: self.place.clone(),
            found: number,
            must: must.into(),
        };
        match must {
            Must::NotBeNegative if number < 0.0 => error(out_of_range("zero or more")),
            // Refuses also numbers that round to 0 in the board's 32-bit floats.
            Must::BePositive if number as f32 <= 0.0 => error(out_of_range("more than zero")),
            _ => Ok(number),
        }
    }

    /// Returns the table `[key]`.
    pub fn table(&self, key: &str) -> Result<Option<Table<'a>>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::Table(entries) => Ok(Some(Table {
                    document: self.document,
                    shared: self.shared,
                    place: if self.place.is_empty() {
                        format!("[{key}]")
                    } else {
                        format!("[{key}] of {}", self.place)
                    },
                    span: value.span(),
                    entries,
                })),
                _ => Err(self.wrong_type(key, format!("one [{key}] table"), value)),
            },
        }
    }

    /// Returns the tables `[[key]]` in the order of the file; empty if the key is missing.
    pub fn tables(&self, key: &str) -> Result<Vec<Table<'a>>, FileError> {
        let Some(value) = self.entries.get(key) else { return Ok(Vec::new()) };
        let expected = || format!("[[{key}]] tables");
        let DeValue::Array(values) = value.get_ref() else { return Err(self.wrong_type(key, expected(), value)) };
        values
            .iter()
            .enumerate()
            .map(|(index, value)| match value.get_ref() {
                DeValue::Table(entries) => Ok(Table {
                    document: self.document,
                    shared: self.shared,
                    place: format!("[[{key}]] {index}"),
                    span: value.span(),
                    entries,
                }),
                _ => Err(self.wrong_type(key, expected(), value)),
            })
            .collect()
    }
}

fn type_name(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}
