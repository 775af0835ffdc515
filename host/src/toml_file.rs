//! TOML files whose every value knows where it stands, so that each refusal names the file, the line and the remedy.
//!
//! [`Document`] parses once; [`Table`] hands out typed values and refuses what it does not know. Device files and
//! scene files are written in terms of it.

use crate::file_error::nearest;
pub use crate::file_error::{FileError, Problem};
use core::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// What a number must be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Must {
    /// Any finite number.
    BeFinite,
    /// Zero or more.
    NotBeNegative,
    /// More than zero.
    BePositive,
}

/// A file's text and where it came from.
#[derive(Clone, Debug)]
pub struct Document {
    path: PathBuf,
    text: String,
}

impl Document {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let whole = |problem| FileError { path: path.into(), position: None, problem: Box::new(problem) };
        let bytes = crate::input::read(path).map_err(|error| {
            let why = error.to_string();
            whole(if error.kind() == std::io::ErrorKind::Other {
                Problem::Unfit(why)
            } else {
                Problem::Unreadable(why)
            })
        })?;
        String::from_utf8(bytes).map(|text| Self { path: path.into(), text }).map_err(|error| {
            let good = error.utf8_error().valid_up_to();
            let before = String::from_utf8_lossy(&error.as_bytes()[..good]).into_owned();
            FileError {
                path: path.into(),
                position: Some(position(&before, before.len())),
                problem: Box::new(Problem::NotText),
            }
        })
    }

    /// Takes text that is already there; `origin` is what messages call it.
    pub fn new(text: impl Into<String>, origin: impl Into<PathBuf>) -> Self {
        Self { path: origin.into(), text: text.into() }
    }

    /// Where the text came from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Parses the text and hands its top table to `read`.
    pub fn read<T>(&self, read: impl FnOnce(&Table<'_>) -> Result<T, FileError>) -> Result<T, FileError> {
        let root = DeTable::parse(&self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            self.error(span, Problem::Syntax(error.message().to_string()))
        })?;
        read(&Table { document: self, place: String::new(), span: 0..0, entries: root.get_ref() })
    }

    /// Line and column of a key's value: in `part` of the `index`-th table `table` (either may be empty). The table's
    /// own place where the key is not written.
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
        FileError {
            path: self.path.clone(),
            position: Some(position(&self.text, span.start)),
            problem: Box::new(problem),
        }
    }
}

/// Line and column (in characters), both from 1, of a byte offset.
fn position(text: &str, offset: usize) -> (usize, usize) {
    let mut offset = offset.min(text.len());
    while !text.is_char_boundary(offset) {
        offset -= 1;
    }
    let before = &text[..offset];
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// One table of a document.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    document: &'a Document,
    place: String,
    span: Range<usize>,
    entries: &'a DeTable<'a>,
}

impl<'a> Table<'a> {
    /// The same table under a name that says more, such as `[[link]] 1 (proximal-2)`.
    pub fn called(mut self, place: impl Into<String>) -> Self {
        self.place = place.into();
        self
    }

    /// What messages call this table.
    pub fn place(&self) -> &str {
        &self.place
    }

    /// An error at the table's own line.
    pub fn error_here(&self, problem: Problem) -> FileError {
        self.document.error(self.span.clone(), problem)
    }

    /// An error at the value of `key`, or at the table when the key is not there.
    pub fn error_at(&self, key: &str, problem: Problem) -> FileError {
        match self.entries.get(key) {
            Some(value) => self.document.error(value.span(), problem),
            None => self.error_here(problem),
        }
    }

    /// An error at one number of the list `key`.
    pub fn error_at_element(&self, key: &str, element: usize, problem: Problem) -> FileError {
        match self.entries.get(key).map(|value| value.get_ref()) {
            Some(DeValue::Array(values)) if element < values.len() => {
                self.document.error(values[element].span(), problem)
            }
            _ => self.error_at(key, problem),
        }
    }

    /// Refuses the first key in the file that is not in `known`.
    pub fn refuse_unknown_keys(&self, known: &[&str]) -> Result<(), FileError> {
        let unknown = self.entries.keys().filter(|key| !known.contains(&key.get_ref().as_ref()));
        let Some(key) = unknown.min_by_key(|key| key.span().start) else { return Ok(()) };
        let known: Vec<String> = known.iter().map(ToString::to_string).collect();
        let problem = Problem::UnknownKey {
            key: key.get_ref().to_string(),
            place: self.place.clone(),
            nearest: nearest(key.get_ref(), &known),
            known,
        };
        Err(self.document.error(key.span(), problem))
    }

    /// Whether the key is there.
    pub fn has(&self, key: &str) -> bool {
        self.entries.contains_key(key)
    }

    /// Whether the key is there with a string.
    pub fn is_string(&self, key: &str) -> bool {
        self.entries.get(key).is_some_and(|value| matches!(value.get_ref(), DeValue::String(_)))
    }

    /// The value, or an error that shows the `example` to add.
    pub fn required<T>(&self, key: &str, value: Option<T>, example: impl Into<String>) -> Result<T, FileError> {
        value.ok_or_else(|| {
            self.error_here(Problem::MissingKey { key: key.into(), place: self.place.clone(), example: example.into() })
        })
    }

    fn wrong_type(&self, key: &str, expected: impl Into<String>, value: &Spanned<DeValue<'_>>) -> FileError {
        let problem = Problem::WrongType {
            key: key.into(),
            place: self.place.clone(),
            expected: expected.into(),
            found: described(value.get_ref()),
        };
        self.document.error(value.span(), problem)
    }

    /// A string.
    pub fn string(&self, key: &str) -> Result<Option<&'a str>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::String(text) => Ok(Some(text.as_ref())),
                _ => Err(self.wrong_type(key, "a string in quotes", value)),
            },
        }
    }

    /// One word of a fixed set, as what it stands for.
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

    /// `true` or `false`.
    pub fn flag(&self, key: &str) -> Result<Option<bool>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::Boolean(flag) => Ok(Some(*flag)),
                _ => Err(self.wrong_type(key, "true or false", value)),
            },
        }
    }

    /// A number; whole numbers count as numbers.
    pub fn number(&self, key: &str, must: Must) -> Result<Option<f64>, FileError> {
        self.entries.get(key).map(|value| self.numeric(key, value, must, "a number")).transpose()
    }

    /// A list of exactly `count` numbers; `meaning` says what they are.
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
            .map(|value| self.numeric(key, value, must, &expected()))
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

    fn numeric(&self, key: &str, value: &Spanned<DeValue<'_>>, must: Must, expected: &str) -> Result<f64, FileError> {
        let number = match value.get_ref() {
            DeValue::Float(float) => float.as_str().parse::<f64>().unwrap_or(f64::NAN),
            DeValue::Integer(whole) => {
                i128::from_str_radix(whole.as_str(), whole.radix()).map_or(f64::NAN, |whole| whole as f64)
            }
            _ => return Err(self.wrong_type(key, expected, value)),
        };
        let error = |problem| Err(self.document.error(value.span(), problem));
        // The board computes in 32-bit floats: what they cannot hold is infinite there.
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
            // Also what vanishes in the board's 32-bit floats.
            Must::BePositive if number as f32 <= 0.0 => error(out_of_range("more than zero")),
            _ => Ok(number),
        }
    }

    /// The one table `[key]`.
    pub fn table(&self, key: &str) -> Result<Option<Table<'a>>, FileError> {
        match self.entries.get(key) {
            None => Ok(None),
            Some(value) => match value.get_ref() {
                DeValue::Table(entries) => Ok(Some(Table {
                    document: self.document,
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

    /// Every table `[[key]]`, in the order of the file; none when there is no such key.
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
                    place: format!("[[{key}]] {index}"),
                    span: value.span(),
                    entries,
                }),
                _ => Err(self.wrong_type(key, expected(), value)),
            })
            .collect()
    }
}

fn described(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}
