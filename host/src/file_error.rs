//! Why a file is refused: every mistake a device or scene file can hold, in words, with what to do about it.
//!
//! One line each: `file:line:column: what is wrong; what to do`. A file is told all its mistakes that can be seen at once.

use core::fmt;
use std::path::PathBuf;

/// Why a file was refused, where, and what to do about it.
#[derive(Clone, Debug, PartialEq)]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// Line and column, both from 1; none when the file as a whole is meant.
    pub position: Option<(usize, usize)>,
    /// The first problem.
    pub problem: Box<Problem>,
    /// Further problems in the same file, in the order of their lines.
    pub others: Vec<FileError>,
}

impl FileError {
    /// One mistake.
    pub fn new(path: PathBuf, position: Option<(usize, usize)>, problem: Problem) -> Self {
        Self { path, position, problem: Box::new(problem), others: Vec::new() }
    }

    /// The mistakes of one file as one, in the order of the file; none where there are none. A key that is missed only
    /// because it is misspelt or stands in the wrong table is one mistake.
    pub fn together(mut errors: Vec<Self>) -> Option<Self> {
        let unknown: Vec<Problem> = errors.iter().map(|error| (*error.problem).clone()).collect();
        let explained = |missing: &Problem| unknown.iter().any(|problem| problem.explains(missing));
        errors.retain(|error| !explained(&error.problem));
        errors.sort_by_key(|error| error.position);
        let mut errors = errors.into_iter();
        let first = errors.next()?;
        Some(Self { others: errors.collect(), ..first })
    }

    fn line(&self) -> String {
        let place = self.position.map_or(String::new(), |(line, column)| format!(":{line}:{column}"));
        format!("{}{place}: {}; {}", self.path.display(), self.problem, self.problem.remedy())
    }
}

/// Everything a file can be refused for. `place` is the table, such as `[geometry]` or `[[link]] 1 (proximal-2)`:
/// counted from 0.
#[derive(Clone, Debug, PartialEq)]
pub enum Problem {
    /// The file cannot be read at all.
    Unreadable(String),
    /// Nothing that such a file can be: a pipe, a device, far too long.
    Unfit(String),
    /// Not UTF-8 text.
    NotText,
    /// Not TOML.
    Syntax(String),
    /// A key that is not known in its table.
    UnknownKey {
        /// The key as written.
        key: String,
        /// Its table.
        place: String,
        /// The known key it resembles.
        nearest: Option<String>,
        /// Every key that may stand here.
        known: Vec<String>,
        /// It belongs at the top of the file.
        on_top: bool,
    },
    /// A key that must be there is not.
    MissingKey {
        /// The key.
        key: String,
        /// Its table.
        place: String,
        /// A line that would do.
        example: String,
    },
    /// A value of the wrong type.
    WrongType {
        /// The key.
        key: String,
        /// Its table.
        place: String,
        /// A description of the expected value.
        expected: String,
        /// The type of the value that stands there.
        found: &'static str,
    },
    /// A list of the wrong length.
    WrongLength {
        /// The key.
        key: String,
        /// Its table.
        place: String,
        /// The required number of numbers.
        expected: usize,
        /// The number of numbers found.
        found: usize,
        /// The meaning of the numbers.
        meaning: String,
    },
    /// Infinite, not a number, or beyond what the board's 32-bit floats hold.
    NotFinite {
        /// The key.
        key: String,
        /// Its table.
        place: String,
    },
    /// A number outside its range.
    OutOfRange {
        /// The key.
        key: String,
        /// Its table.
        place: String,
        /// The number.
        found: f64,
        /// The condition that it must meet, with the unit or the reason.
        must: String,
    },
    /// A word that is not one of a fixed set.
    UnknownWord {
        /// The key.
        key: String,
        /// Its table.
        place: String,
        /// The word as written.
        found: String,
        /// Every word that may stand here.
        known: Vec<String>,
    },
    /// The wrong number of repeated tables.
    WrongCount {
        /// The table, such as `[[link]]`.
        table: String,
        /// The required number of entries.
        expected: String,
        /// The number of entries found.
        found: usize,
        /// The meaning of the entries, in order.
        meaning: String,
    },
    /// Every value is fine by itself, but together they cannot be.
    Impossible {
        /// The contradiction.
        reason: String,
        /// The change to make.
        remedy: String,
    },
}

impl Problem {
    /// Returns true if this unknown key is the missing one, misspelt or in the wrong table.
    fn explains(&self, missing: &Self) -> bool {
        let (Self::UnknownKey { key: unknown, place, on_top, .. }, Self::MissingKey { key, place: lacking, .. }) =
            (self, missing)
        else {
            return false;
        };
        let misspelt = place == lacking && nearest(unknown, std::slice::from_ref(key)).is_some();
        misspelt || *on_top && lacking.is_empty() && unknown == key
    }

    /// Returns the advice that goes with the problem.
    pub fn remedy(&self) -> String {
        match self {
            Self::Unreadable(_) => "check the path and its permissions".into(),
            Self::Unfit(_) => "name the TOML file that is meant".into(),
            Self::NotText => "save the file as UTF-8 text".into(),
            Self::Syntax(_) => "mend the TOML at this place".into(),
            Self::UnknownKey { on_top: true, .. } => "it belongs at the top of the file, above the first table".into(),
            Self::UnknownKey { nearest: Some(nearest), .. } => format!("did you mean `{nearest}`?"),
            Self::UnknownKey { nearest: None, known, .. } if known.is_empty() => "remove it".into(),
            Self::UnknownKey { nearest: None, known, .. } => {
                format!("remove it; known here: {}", known.join(", "))
            }
            Self::MissingKey { example, .. } => format!("add `{example}`"),
            Self::WrongType { expected, .. } => format!("write {expected}"),
            Self::WrongLength { expected: 1, meaning, .. } => format!("write one number: {meaning}"),
            Self::WrongLength { expected, meaning, .. } => format!("write {expected} numbers: {meaning}"),
            Self::NotFinite { .. } => "write an ordinary number, in SI units".into(),
            Self::OutOfRange { must, .. } => format!("it must be {must}"),
            Self::UnknownWord { found, known, .. } => match nearest(found, known) {
                Some(nearest) => format!("did you mean \"{nearest}\"? known: {}", known.join(", ")),
                None => format!("known: {}", known.join(", ")),
            },
            Self::WrongCount { table, expected, meaning, .. } => {
                format!("write {expected} {table} tables: {meaning}")
            }
            Self::Impossible { remedy, .. } => remedy.clone(),
        }
    }
}

/// `key` in `place`, or `key` alone at the top of the file.
fn at(key: &str, place: &str) -> String {
    if place.is_empty() { format!("`{key}`") } else { format!("`{key}` in {place}") }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) | Self::Unfit(why) => write!(f, "cannot be read: {why}"),
            Self::NotText => write!(f, "not UTF-8 text"),
            Self::Syntax(why) => write!(f, "not valid TOML: {why}"),
            Self::UnknownKey { key, place, .. } => write!(f, "unknown key {}", at(key, place)),
            Self::MissingKey { key, place, .. } => write!(f, "{} is missing", at(key, place)),
            Self::WrongType { key, place, expected, found } => {
                write!(f, "{} is {found}, not {expected}", at(key, place))
            }
            Self::WrongLength { key, place, expected, found, .. } => {
                let noun = if *found == 1 { "number" } else { "numbers" };
                write!(f, "{} has {found} {noun} instead of {expected}", at(key, place))
            }
            Self::NotFinite { key, place } => write!(f, "{} is not a finite number", at(key, place)),
            Self::OutOfRange { key, place, found, .. } => write!(f, "{} cannot be {found}", at(key, place)),
            Self::UnknownWord { key, place, found, .. } => {
                write!(f, "{} cannot be \"{}\"", at(key, place), found.escape_debug())
            }
            Self::WrongCount { table, expected, found, .. } => {
                write!(f, "{found} {table} tables instead of {expected}")
            }
            Self::Impossible { reason, .. } => f.write_str(reason),
        }
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.line())?;
        self.others.iter().try_for_each(|other| write!(f, "\n{}", other.line()))
    }
}

impl std::error::Error for FileError {}

impl From<FileError> for crate::error::Failure {
    fn from(error: FileError) -> Self {
        Self::wrong(error.line()).also(error.others.iter().map(FileError::line))
    }
}

/// The known word that `word` was probably meant to be.
pub(crate) fn nearest(word: &str, known: &[String]) -> Option<String> {
    let lower = word.to_lowercase();
    known
        .iter()
        .map(|candidate| (strsim::jaro_winkler(&lower, candidate), candidate))
        .filter(|(likeness, _)| *likeness >= 0.8)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, candidate)| candidate.clone())
}
