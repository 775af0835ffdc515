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
    /// A description in another format.
    Foreign(&'static Foreign),
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
            Self::Foreign(format) => format.instead.into(),
            Self::UnknownKey { on_top: true, .. } => "it belongs at the top of the file, above the first table".into(),
            Self::UnknownKey { key, place, .. } if let Some(instead) = instead_of(key, place) => instead.into(),
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

/// Words of data sheets and of other projects' files, a part of the name of the tables in which they are meant so, and the
/// keys to write instead.
const SHEET_WORDS: &[(&[&str], &str, &str)] = &[
    (
        &[
            "ratio",
            "gear",
            "gears",
            "gear_ratio",
            "gearing",
            "gearbox",
            "reduction",
            "capstan_ratio",
            "transmission_ratio",
        ],
        "",
        "multiply torque_constant, back_emf and counts_per_turn by the ratio and the rotor's inertia by its square: every \
         number counts at the joint (docs/devices.md)",
    ),
    (&["efficiency"], "", "multiply torque_constant by the efficiency"),
    (
        &["kv", "speed_constant", "rpm_per_volt"],
        "",
        "write torque_constant = 9.549 / kv, with kv in rpm/V, times the gear ratio",
    ),
    (&["kt", "k_t"], "", "write torque_constant, in N m/A, times the gear ratio"),
    (&["ke", "k_e", "emf_constant"], "", "write back_emf, in V s/rad, times the gear ratio"),
    (
        &["phase_resistance", "terminal_resistance", "winding_resistance", "r_phase"],
        "",
        "write resistance, in ohm, between the two terminals of a brushed motor",
    ),
    (
        &["phase_inductance", "terminal_inductance", "l_phase"],
        "",
        "write inductance, in H, between the two terminals of a brushed motor",
    ),
    (
        &["pole_pairs", "poles", "phases", "commutation", "hall"],
        "",
        "boards drive brushed motors only; a brushless motor cannot be described yet (docs/devices.md)",
    ),
    (
        &["lines", "ppr", "pulses_per_turn"],
        "",
        "write counts_per_turn = 4 x lines x gear ratio: it counts the edges of A and B, at the joint",
    ),
    (
        &["cpr", "resolution", "ticks", "ticks_per_turn", "counts_per_rev", "counts_per_revolution"],
        "encoder",
        "write counts_per_turn = the edges of A and B in one motor turn x gear ratio (4 x the lines, where the sheet counts \
         lines)",
    ),
    (
        &["type", "absolute", "bits", "sensor", "chip", "spi", "i2c", "pwm", "analog"],
        "encoder",
        "boards read incremental encoders with A and B only; an absolute or analog one cannot be described yet: use its A and \
         B outputs where it has them (docs/devices.md)",
    ),
    (
        &["index", "index_offset", "index_angle"],
        "encoder",
        "an index mark needs no key: write offset = the joint angle at which it passes",
    ),
    (
        &["noise", "jitter", "backlash", "play", "slip", "hysteresis"],
        "",
        "leave it out: noise, backlash and slip cannot be described yet, and simulation and predictions are without them",
    ),
    (
        &["rotor_inertia", "armature", "reflected_inertia"],
        "",
        "write the joint's inertia = rotor inertia x gear ratio squared, in kg m²",
    ),
    (
        &["max_torque", "peak_torque", "stall_torque", "torque_limit", "effort", "nominal_torque"],
        "",
        "write max_current = torque / torque_constant, in A",
    ),
    (
        &["stall_current", "nominal_current", "continuous_current", "current_limit"],
        "",
        "write max_current, in A: what motor, board and supply stand continuously",
    ),
    (&["no_load_current"], "", "write the joint's coulomb = no-load current x torque_constant, in N m"),
];

/// The keys to write instead of a data sheet's word.
fn instead_of(key: &str, place: &str) -> Option<&'static str> {
    let key = key.to_lowercase().replace('-', "_");
    let meant = |(words, part, _): &&(&[&str], &str, &str)| words.contains(&key.as_str()) && place.contains(part);
    SHEET_WORDS.iter().find(meant).map(|(_, _, instead)| *instead)
}

/// A format in which people have descriptions of their devices, or other data.
#[derive(Debug, PartialEq, Eq)]
pub struct Foreign {
    name: &'static str,
    instead: &'static str,
}

impl Foreign {
    /// The format of a text that is no TOML, by its first line.
    pub fn of(text: &str) -> Option<&'static Self> {
        const DESCRIBE: &str = "begin with `haptic new KIND -o mine.toml` and take lengths, masses, centres of mass, inertias and \
                                limits from this file (docs/devices.md)";
        const WRITE: &str = "write it as TOML: `haptic new` shows every key (docs/devices.md)";
        let text = text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']);
        let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'))?;
        let key = |word: &str| !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || "_- ".contains(c));
        Some(match () {
            () if text.starts_with('<') && text.contains("xacro") => {
                &Self { name: "xacro (a URDF template)", instead: DESCRIBE }
            }
            () if text.starts_with('<') && text.contains("<robot") => &Self { name: "URDF", instead: DESCRIBE },
            () if text.starts_with('<') && text.contains("<mujoco") => {
                &Self { name: "MJCF (a MuJoCo model)", instead: DESCRIBE }
            }
            () if text.starts_with('<') => &Self { name: "XML", instead: DESCRIBE },
            () if text.starts_with('{') => &Self { name: "JSON", instead: WRITE },
            () if first == "---" || first.split_once(':').is_some_and(|(word, _)| key(word)) => {
                &Self { name: "YAML", instead: WRITE }
            }
            () if first.contains(',') && first.split(',').all(|word| key(word.trim())) => &Self {
                name: "a table (CSV)",
                instead: "name a device or scene file in TOML; `haptic plot` draws recordings",
            },
            () => return None,
        })
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
            Self::Foreign(format) => write!(f, "this is {}, which cannot be read yet, and not TOML", format.name),
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
