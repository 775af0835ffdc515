//! Errors in device and scene files, with their remedies.
//!
//! Each error is one line: `file:line:column: problem; remedy`. All errors that one pass can find are reported at once.

use crate::error::Choice;
use core::fmt;
use std::path::PathBuf;

/// An error in a file, with its position.
#[derive(Clone, Debug, PartialEq)]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// Line and column, both from 1; `None` if the error concerns the complete file.
    pub position: Option<(usize, usize)>,
    /// The first problem.
    pub problem: Box<Problem>,
    /// Further problems in the same file, in the order of their lines.
    pub others: Vec<FileError>,
}

impl FileError {
    /// Creates an error without further errors.
    pub fn new(path: PathBuf, position: Option<(usize, usize)>, problem: Problem) -> Self {
        Self { path, position, problem: Box::new(problem), others: Vec::new() }
    }
    /// Joins the errors of one file in the order of their lines; `None` without errors. Drops the error about a missing
    /// key if the key is misspelt or in the wrong table.
    pub fn join(mut errors: Vec<Self>) -> Option<Self> {
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

/// A problem in a file. `key` is the key, `place` the table of the key, such as `[geometry]` or `[[link]] 1
/// (proximal-2)` (counted from 0), `found` the value in the file, `expected` or `must` the requirement, `meaning` the
/// meaning of the numbers or tables, and `example` the missing line. `on_top` is true if the key belongs at the top of
/// the file.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Problem {
    Unreadable(String),
    /// Not a regular file, or a file that is too long.
    NotReadableFile(String),
    NotText,
    Syntax(String),
    /// A file in another format.
    Foreign(&'static ForeignFormat),
    UnknownKey {
        key: String,
        place: String,
        nearest: Option<String>,
        known: Vec<String>,
        on_top: bool,
    },
    MissingKey {
        key: String,
        place: String,
        example: String,
    },
    WrongType {
        key: String,
        place: String,
        expected: String,
        found: &'static str,
    },
    WrongLength {
        key: String,
        place: String,
        expected: usize,
        found: usize,
        meaning: String,
    },
    /// A number that is infinite, NaN or too large for the board's 32-bit floats.
    NotFinite {
        key: String,
        place: String,
    },
    OutOfRange {
        key: String,
        place: String,
        found: f64,
        must: String,
    },
    UnknownWord {
        key: String,
        place: String,
        found: String,
        known: Vec<String>,
    },
    WrongCount {
        table: String,
        expected: String,
        found: usize,
        meaning: String,
    },
    /// Values that are valid alone but contradict each other.
    Impossible {
        reason: String,
        remedy: String,
    },
}

impl Problem {
    /// Returns true if `self` is an unknown key that is the `missing` key, misspelt or in the wrong table.
    fn explains(&self, missing: &Self) -> bool {
        let (Self::UnknownKey { key: unknown, place, on_top, .. }, Self::MissingKey { key, place: lacking, .. }) =
            (self, missing)
        else {
            return false;
        };
        let misspelt = place == lacking && nearest(unknown, std::slice::from_ref(key)).is_some();
        misspelt || *on_top && lacking.is_empty() && unknown == key
    }

    /// Returns the remedy.
    pub fn remedy(&self) -> String {
        match self {
            Self::Unreadable(_) => "check the path and its permissions".into(),
            Self::NotReadableFile(_) => "name a TOML file".into(),
            Self::NotText => "save the file as UTF-8 text".into(),
            Self::Syntax(_) => "correct the TOML at this place".into(),
            Self::Foreign(format) => format.remedy.into(),
            Self::UnknownKey { on_top: true, .. } => "the key belongs at the top of the file, above all tables".into(),
            Self::UnknownKey { key, place, .. } if let Some(instead) = sheet_word_remedy(key, place) => instead.into(),
            Self::UnknownKey { nearest: Some(nearest), .. } => format!("did you mean `{nearest}`?"),
            Self::UnknownKey { nearest: None, known, .. } if known.is_empty() => "remove this key".into(),
            Self::UnknownKey { nearest: None, known, .. } => {
                format!("remove this key; known here: {}", known.join(", "))
            }
            Self::MissingKey { example, .. } => format!("add `{example}`"),
            Self::WrongType { expected, .. } => format!("write {expected}"),
            Self::WrongLength { expected: 1, meaning, .. } => format!("write one number: {meaning}"),
            Self::WrongLength { expected, meaning, .. } => format!("write {expected} numbers: {meaning}"),
            Self::NotFinite { .. } => "write an ordinary number, in SI units".into(),
            Self::OutOfRange { must, .. } => format!("the value must be {must}"),
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

/// Words of data sheets and other projects that are not keys. Each row has the words, a part of the name of the tables
/// to which the row applies, and the remedy.
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
         number refers to the joint (docs/devices.md)",
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
        "a three-phase motor has kind = \"brushless\" and pole_pairs, half the number of its magnets (docs/devices.md)",
    ),
    (
        &["lines", "ppr", "pulses_per_turn"],
        "",
        "write counts_per_turn = 4 x lines x gear ratio: the edges of A and B in one turn of the joint",
    ),
    (
        &["cpr", "resolution", "ticks", "ticks_per_turn", "counts_per_rev", "counts_per_revolution"],
        "encoder",
        "write counts_per_turn = the edges of A and B in one motor turn x gear ratio (4 x the lines, if the data sheet \
         counts lines)",
    ),
    (
        &["type", "absolute", "bits", "sensor", "chip", "spi", "i2c", "pwm", "analog"],
        "encoder",
        "boards read incremental encoders with A and B only; an absolute or analog encoder cannot be described yet: \
         use its A and B outputs, if it has them (docs/devices.md)",
    ),
    (
        &["index", "index_offset", "index_angle"],
        "encoder",
        "there is no key for an index mark: set `offset` to the joint angle at the index mark",
    ),
    (
        &["noise", "jitter", "backlash", "play", "slip", "hysteresis"],
        "",
        "leave this key out: noise, backlash and slip cannot be described yet, and simulation and predictions ignore them",
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
        "write max_current, in A: the current that motor, board and supply can carry continuously",
    ),
    (&["no_load_current"], "", "write the joint's coulomb = no-load current x torque_constant, in N m"),
];

/// Returns the remedy for a data sheet's word `key` in the table `place`.
fn sheet_word_remedy(key: &str, place: &str) -> Option<&'static str> {
    let key = key.to_lowercase().replace('-', "_");
    let meant = |(words, part, _): &&(&[&str], &str, &str)| words.contains(&key.as_str()) && place.contains(part);
    SHEET_WORDS.iter().find(meant).map(|(_, _, instead)| *instead)
}

/// Another file format.
#[derive(Debug, PartialEq, Eq)]
pub struct ForeignFormat {
    name: &'static str,
    remedy: &'static str,
}

impl ForeignFormat {
    /// URDF that the program xacro has yet to expand.
    pub const XACRO: Self = Self {
        name: "xacro (a template of a URDF file)",
        remedy: "expand it by `xacro FILE -o OUT.urdf` of ROS, then convert OUT.urdf to a device file",
    };

    /// Detects the format of a text that is not TOML by its first lines.
    pub fn of(text: &str) -> Option<&'static Self> {
        const CONVERT: &str = "convert it to a device file";
        const EXPORT: &str =
            "write it as TOML (`haptic new` shows every key), or export it as URDF or MJCF and convert that";
        let text = text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']);
        let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'))?;
        let key = |word: &str| !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || "_- ".contains(c));
        Some(match text.starts_with('<') {
            true if ["<xacro:", "${", "$("].iter().any(|sign| text.contains(sign)) => &Self::XACRO,
            true if text.contains("<robot") => &Self { name: "URDF", remedy: CONVERT },
            true if text.contains("<mujoco") => &Self { name: "MJCF (a MuJoCo model)", remedy: CONVERT },
            true if text.contains("<sdf") => &Self { name: "SDF (a Gazebo model)", remedy: EXPORT },
            true => &Self { name: "XML", remedy: EXPORT },
            false if text.starts_with('{') => &Self { name: "JSON", remedy: EXPORT },
            false if first == "---" || first.split_once(':').is_some_and(|(word, _)| key(word)) => {
                &Self { name: "YAML", remedy: EXPORT }
            }
            false if first.contains(',') && first.split(',').all(|word| key(word.trim())) => &Self {
                name: "a table (CSV)",
                remedy: "name a device or scene file in TOML; `haptic plot` draws recordings",
            },
            false => return None,
        })
    }
    /// Returns the name of the format and the remedy.
    pub fn name_and_remedy(&self) -> (&'static str, &'static str) {
        (self.name, self.remedy)
    }
}

/// Formats `key` in `place`, or `key` alone at the top of the file.
fn key_in_place(key: &str, place: &str) -> String {
    if place.is_empty() { format!("`{key}`") } else { format!("`{key}` in {place}") }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) | Self::NotReadableFile(why) => write!(f, "cannot be read: {why}"),
            Self::NotText => write!(f, "not UTF-8 text"),
            Self::Syntax(why) => write!(f, "not valid TOML: {why}"),
            Self::Foreign(format) => write!(f, "this is {}, not TOML", format.name),
            Self::UnknownKey { key, place, .. } => write!(f, "unknown key {}", key_in_place(key, place)),
            Self::MissingKey { key, place, .. } => write!(f, "{} is missing", key_in_place(key, place)),
            Self::WrongType { key, place, expected, found } => {
                write!(f, "{} is {found}, not {expected}", key_in_place(key, place))
            }
            Self::WrongLength { key, place, expected, found, .. } => {
                let noun = if *found == 1 { "number" } else { "numbers" };
                write!(f, "{} has {found} {noun} instead of {expected}", key_in_place(key, place))
            }
            Self::NotFinite { key, place } => write!(f, "{} is not a finite number", key_in_place(key, place)),
            Self::OutOfRange { key, place, found, .. } => write!(f, "{} cannot be {found}", key_in_place(key, place)),
            Self::UnknownWord { key, place, found, .. } => {
                write!(f, "{} cannot be \"{}\"", key_in_place(key, place), found.escape_debug())
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
        let failure = Self::wrong(error.line()).with_further_lines(error.others.iter().map(FileError::line));
        match *error.problem {
            // A table has no model to convert.
            Problem::Foreign(format) if format.remedy.contains("convert") => failure.choose(Choice::Conversion),
            _ => failure,
        }
    }
}

/// Returns the known word that is most similar to `word`; `None` if no word is similar enough.
pub(crate) fn nearest(word: &str, known: &[String]) -> Option<String> {
    let lower = word.to_lowercase();
    known
        .iter()
        .map(|candidate| (strsim::jaro_winkler(&lower, candidate), candidate))
        .filter(|(likeness, _)| *likeness >= 0.8)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, candidate)| candidate.clone())
}
