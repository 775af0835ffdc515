//! Scene files (docs/files.md): TOML in, a checked [`Scene`] out, or an error that names the line.
//!
//! Normals, points and directions must have as many entries as the task dimension of the device. Directions become unit
//! vectors. Defaults:
//! | key | default |
//! |---|---|
//! | `rate_hz` | 20000 |
//! | `cutoff_hz` | 500, or a tenth of the rate if that is less |
//! | `estimator` | `"butterworth"` (also `"first-order"`, `"backward-difference"`, and [`Estimator::SPECS`], each with its own key; with some of them, `cutoff_hz` adds a Butterworth low-pass) |
//! | `velocity_terms` | `"rendered"` (also `"paper"`, `"off"`) |
//! | `feed_forward_gain` | 1 |
//! | `admissible` | `"orientation"` (also `"joint-0"`, `"joint-1"`, `"joint-2"`, `"consistent"`; redundant devices only) |
//! | `gravity_compensation` | true (no effect on a device without gravity) |
//! | wall `shape` | `"plane"` (also `"sphere"`, `"cylinder"`) |
//! | wall `damping`, spring `damping` | 0 |
//! | wall `feed_forward`, `washout_hz` | `"washout"`, 2 |
//! | wall `damping_compensation`, `bilateral`, `inside` | false |
//! | `[posture]` `damping` | 0 (with `orientation`, rad, and `stiffness`, N m/rad; redundant devices only) |
//! | spring `direction` | none: the spring pulls to its point; with a direction, to the line through the point |

use crate::device_file::DeviceFile;
use crate::toml_file::{Document, FileError, Must, Problem, Table};
use crate::vectors::{padded, unit};
use haptic_bridge::math::{Libm, Real};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::scene::shape::{Meaning, SHAPE_VALUES, ShapeSpec};
use haptic_bridge::render::scene::{
    Admissible, DEFAULT_RATE_HZ, FeedForward, MAX_FEED_FORWARD_GAIN, MAX_RATE_HZ, MAX_SPRINGS, MAX_WALLS, MIN_RATE_HZ,
    Posture, Scene, SceneError, Spring, Surface, VelocityTerms, Wall,
};
use haptic_bridge::render::velocity::{Chosen, CutoffMeaning, Estimator};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;
use std::path::{Path, PathBuf};

/// Default cutoff at rates from 5 kHz, Hz. At lower rates the default is a tenth of the rate, as in the paper (20 Hz at
/// 200 Hz).
pub const DEFAULT_CUTOFF_HZ: f64 = 500.0;
/// Default corner frequency of the washout, Hz, which keeps 99 % of the gained stable area at 20 kHz (docs/model.md
/// section 3).
pub const DEFAULT_WASHOUT_HZ: f64 = 2.0;

/// A checked scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// Path of the file.
    pub path: PathBuf,
    /// The scene in double precision.
    pub scene: Scene<f64>,
    /// Speed of the hand, m/s, that a plan assumes for the scene.
    pub hand_speed: Option<f64>,
}

impl SceneFile {
    /// Reads and checks the file at `path` for a device of task dimension `task`.
    pub fn load(path: impl AsRef<Path>, task: usize) -> Result<Self, FileError> {
        Self::read(&Document::load(path.as_ref())?, task)
    }
    /// Reads and checks a text. Error messages name `origin` as the file.
    pub fn parse(text: &str, origin: impl Into<PathBuf>, task: usize) -> Result<Self, FileError> {
        Self::read(&Document::new(text, origin), task)
    }
    /// Returns the indices of the one-sided walls that contain the tip at joint angles `q` (rad).
    pub fn walls_entered(&self, device: &DeviceFile, q: &[f64; MAX_JOINTS]) -> Vec<usize> {
        fn entered_walls<const N: usize, M: Mechanism<f64, N>>(
            m: &M,
            scene: &Scene<f64>,
            q: &[f64; MAX_JOINTS],
        ) -> Vec<usize> {
            let mut tip = m.tip(&m.pose::<Libm>(&SVector::<f64, N>::from_fn(|i, _| q[i])));
            (M::SPEC.task..N).for_each(|i| tip[i] = 0.0);
            let walls = scene.walls.iter().enumerate().filter(|(_, wall)| !wall.bilateral);
            let inside = walls.filter(|(_, wall)| wall.surface.contact::<Libm, N>(&tip).distance < 0.0);
            inside.map(|(index, _)| index).collect()
        }
        with_mechanism!(&device.mechanism, m => entered_walls(m, &self.scene, q))
    }

    /// Checks a document.
    pub fn read(document: &Document, task: usize) -> Result<Self, FileError> {
        let (scene, hand_speed) =
            document.read(|top| Ok((scene(top, task)?, top.number("hand_speed", Must::BePositive)?)))?;
        Ok(Self { path: document.path().into(), scene, hand_speed })
    }

    /// Converts the scene to the precision of the control loop: f32 on a board.
    ///
    /// Errors: only if rounding makes a number invalid, such as a radius that becomes 0.
    pub fn scene<T: Real>(&self) -> Result<Scene<T>, SceneError> {
        let scene = self.scene.cast::<T>();
        scene.check(usize::from(scene.task)).map(|()| scene)
    }
}

fn scene(top: &Table<'_>, task: usize) -> Result<Scene<f64>, FileError> {
    if top.has("mechanism") || top.has("geometry") {
        let reason = "this looks like a device file, not a scene file".into();
        let remedy = "name a scene file here; a device file goes before it, or to `haptic device`".into();
        return Err(top.error_here(Problem::Impossible { reason, remedy }));
    }
    let estimator = top.word("estimator", Estimator::ALL)?.unwrap_or_default();
    let own = estimator.spec().and_then(|spec| spec.key).map(|key| key.name);
    let common = [
        "rate_hz",
        "cutoff_hz",
        "estimator",
        "gravity_compensation",
        "velocity_terms",
        "feed_forward_gain",
        "admissible",
        "hand_speed",
        "posture",
        "wall",
        "spring",
        "field",
    ];
    top.refuse_unknown_keys(&[&common[..], own.as_slice()].concat());
    // A wrong rate becomes NaN, so that comparisons with the rate report no further errors.
    let rate_hz = top.keep(rate(top), f64::NAN);
    let cutoff_hz = top.number_or("cutoff_hz", Must::BePositive, DEFAULT_CUTOFF_HZ.min(0.1 * rate_hz));
    top.keep(check_below_half_rate(top, "cutoff_hz", cutoff_hz, rate_hz), ());
    let mut scene = Scene {
        task: task as u8,
        rate_hz,
        cutoff_hz,
        estimator: top.keep(estimator_with_key(top, estimator), estimator),
        gravity_compensation: top.flag_or("gravity_compensation", true),
        velocity_terms: top.keep(top.word("velocity_terms", &VelocityTerms::ALL), None).unwrap_or_default(),
        feed_forward_gain: top.keep(feed_forward_gain(top), 1.0),
        admissible: top.keep(top.word("admissible", &Admissible::ALL), None).unwrap_or_default(),
        posture: top.keep(top.table("posture"), None).map(|table| posture(&table)),
        ..Scene::default()
    };
    let walls = top.keep(top.tables("wall"), Vec::new());
    for table in &walls {
        let Some(wall) = top.keep(wall(table, task, rate_hz), None) else { continue };
        scene.walls.push(wall).map_err(|_| too_many_error(table, "[[wall]]", walls.len(), MAX_WALLS))?;
    }
    let springs = top.keep(top.tables("spring"), Vec::new());
    for table in &springs {
        let spring = spring(table, task);
        scene.springs.push(spring).map_err(|_| too_many_error(table, "[[spring]]", springs.len(), MAX_SPRINGS))?;
    }
    for table in top.keep(top.tables("field"), Vec::new()) {
        table.refuse_unknown_keys(&["damping"]);
        scene.field_damping += table.required_number("damping", Must::NotBeNegative, "damping = 2.0");
    }
    top.check_no_errors()?;
    let with_feed_forward = scene.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off).count();
    if scene.feed_forward_gain > 1.0 && with_feed_forward > 1 {
        let must = "at most 1 where several walls have a feed-forward";
        return Err(out_of_range_error(top, "feed_forward_gain", scene.feed_forward_gain, must));
    }
    Ok(scene)
}

fn rate(top: &Table<'_>) -> Result<f64, FileError> {
    let rate_hz = top.number("rate_hz", Must::BePositive)?.unwrap_or(DEFAULT_RATE_HZ);
    if !(MIN_RATE_HZ..=MAX_RATE_HZ).contains(&rate_hz) {
        return Err(out_of_range_error(top, "rate_hz", rate_hz, &format!("from {MIN_RATE_HZ} to {MAX_RATE_HZ} Hz")));
    }
    Ok(rate_hz)
}

/// Reads the value of the estimator's own key and, for an estimator that a low-pass may follow, adds the low-pass if
/// the file has a cutoff.
fn estimator_with_key(top: &Table<'_>, estimator: Estimator) -> Result<Estimator, FileError> {
    let (Some(spec), Some(usual)) = (estimator.spec(), estimator.chosen()) else { return Ok(estimator) };
    let mut value = usual.value;
    if let Some(key) = spec.key
        && let Some(found) = top.number(key.name, Must::BePositive)?
    {
        let (least, most) = key.range;
        if found.fract() != 0.0 || !(f64::from(least)..=f64::from(most)).contains(&found) {
            let must = format!("a whole number from {least} to {most} ({})", key.unit);
            return Err(out_of_range_error(top, key.name, found, &must));
        }
        value = found as u32;
    }
    let filtered = spec.cutoff == CutoffMeaning::LowPassAfter && top.has("cutoff_hz");
    Ok(estimator.with_options(Chosen { value, filtered }))
}

/// Reads the gain α of the feed-forward, by default 1. The limit of α for several walls is checked with the scene.
fn feed_forward_gain(top: &Table<'_>) -> Result<f64, FileError> {
    let gain = top.number("feed_forward_gain", Must::NotBeNegative)?.unwrap_or(1.0);
    if gain > MAX_FEED_FORWARD_GAIN {
        return Err(out_of_range_error(top, "feed_forward_gain", gain, &format!("from 0 to {MAX_FEED_FORWARD_GAIN}")));
    }
    Ok(gain)
}

fn too_many_error(table: &Table<'_>, name: &str, found: usize, most: usize) -> FileError {
    table.error_here(Problem::WrongCount {
        table: name.into(),
        expected: format!("at most {most}"),
        found,
        meaning: "the limit of a board".into(),
    })
}

fn out_of_range_error(table: &Table<'_>, key: &str, found: f64, must: &str) -> FileError {
    let place = table.place().to_string();
    table.error_at(key, Problem::OutOfRange { key: key.into(), place, found, must: must.into() })
}

fn check_below_half_rate(table: &Table<'_>, key: &str, found: f64, rate_hz: f64) -> Result<(), FileError> {
    if found < 0.5 * rate_hz || rate_hz.is_nan() {
        return Ok(());
    }
    Err(out_of_range_error(table, key, found, &format!("below half the rate of {rate_hz} Hz")))
}

/// Reads a wall. Returns `None` if the table has an unknown key.
fn wall(table: &Table<'_>, task: usize, rate_hz: f64) -> Result<Option<Wall<f64>>, FileError> {
    let shapes: Vec<(&str, ShapeSpec)> = Surface::<f64>::SPECS.iter().map(|spec| (spec.name, *spec)).collect();
    let shape = table.word("shape", &shapes)?.unwrap_or(shapes[0].1);
    let table = table.clone().with_place(format!("{} ({})", table.place(), shape.name));
    let common = ["shape", "stiffness", "damping", "feed_forward", "washout_hz", "damping_compensation", "bilateral"];
    let own: Vec<&str> = shape.keys.iter().map(|(key, _)| *key).collect();
    // Ignores the rest of the table, because an unknown key may belong to another shape.
    if !table.refuse_unknown_keys(&[&own[..], &common].concat()) {
        return Ok(None);
    }
    if task < shape.least_task {
        let name = shape.name;
        let problem = Problem::Impossible {
            reason: format!("a {name} needs a device that moves in space, and this device has {task} task directions"),
            remedy: "use shape = \"sphere\", which is a disc in the plane".into(),
        };
        return Err(table.error_at("shape", problem));
    }
    let surface = surface(&table, &shape, task);
    let washout_hz = table.number_or("washout_hz", Must::BePositive, DEFAULT_WASHOUT_HZ);
    table.keep(check_below_half_rate(&table, "washout_hz", washout_hz, rate_hz), ());
    Ok(Some(Wall {
        surface,
        stiffness: table.required_number("stiffness", Must::NotBeNegative, "stiffness = 2000.0"),
        damping: table.number_or("damping", Must::NotBeNegative, 0.0),
        feed_forward: table.keep(table.word("feed_forward", &FeedForward::ALL), None).unwrap_or_default(),
        washout_hz,
        damping_compensation: table.flag_or("damping_compensation", false),
        bilateral: table.flag_or("bilateral", false),
    }))
}

/// Reads the surface of a wall from the keys of its shape.
fn surface(table: &Table<'_>, shape: &ShapeSpec, task: usize) -> Surface<f64> {
    let mut values = Vec::with_capacity(SHAPE_VALUES);
    for (key, meaning) in shape.keys {
        match meaning {
            Meaning::Point => values.extend(point(table, key, task)),
            Meaning::Direction => values.extend(direction(table, key, task)),
            Meaning::Length => values.push(table.required_number(key, Must::BePositive, format!("{key} = 0.03"))),
            Meaning::Flag => values.push(f64::from(u8::from(table.flag_or(key, false)))),
        }
    }
    Surface::from_values(shape.name, &padded(&values))
        .expect("the name comes from the shape's own spec, and the values fit into SHAPE_VALUES")
}

/// Returns the first key of a shape with this meaning, and the index of the key's first number among the shape's
/// values.
pub fn place_of(shape: &ShapeSpec, meaning: Meaning) -> Option<(&'static str, usize)> {
    let mut next = 0;
    shape.keys.iter().find_map(|(key, of)| {
        let begin = next;
        next += of.width();
        (*of == meaning).then_some((*key, begin))
    })
}

fn posture(table: &Table<'_>) -> Posture<f64> {
    table.refuse_unknown_keys(&["orientation", "stiffness", "damping"]);
    Posture {
        orientation: table.required_number("orientation", Must::BeFinite, "orientation = 2.0"),
        stiffness: table.required_number("stiffness", Must::NotBeNegative, "stiffness = 1.0"),
        damping: table.number_or("damping", Must::NotBeNegative, 0.0),
    }
}

fn spring(table: &Table<'_>, task: usize) -> Spring<f64> {
    table.refuse_unknown_keys(&["point", "direction", "stiffness", "damping"]);
    Spring {
        point: point(table, "point", task),
        direction: if table.has("direction") { direction(table, "direction", task) } else { [0.0; 3] },
        stiffness: table.required_number("stiffness", Must::NotBeNegative, "stiffness = 200.0"),
        damping: table.number_or("damping", Must::NotBeNegative, 0.0),
    }
}

fn point(table: &Table<'_>, key: &str, task: usize) -> [f64; 3] {
    table.keep(vector(table, key, &vec![0.0; task], "a point in metres"), [f64::NAN; 3])
}

/// Reads a task vector and pads it with zeros; `example` has the length of the vector.
fn vector(table: &Table<'_>, key: &str, example: &[f64], meaning: &str) -> Result<[f64; 3], FileError> {
    let task = example.len();
    let axes = ["x", "x, y", "x, y, z"][task.clamp(1, 3) - 1];
    let values = table.numbers(key, task, Must::BeFinite, &format!("{axes}, {meaning} of this device"))?;
    Ok(padded(&table.require(key, values, format!("{key} = {example:?}"))?))
}

/// Reads a direction as a unit vector; refuses zero.
fn direction(table: &Table<'_>, key: &str, task: usize) -> [f64; 3] {
    let mut example = vec![0.0; task];
    example[usize::from(task > 1)] = 1.0;
    let found = vector(table, key, &example, "a direction").and_then(|values| {
        unit(&values).ok_or_else(|| {
            let reason = format!("`{key}` in {} is zero, which points nowhere", table.place());
            let remedy = format!("write a direction of any length, such as {example:?}");
            table.error_at(key, Problem::Impossible { reason, remedy })
        })
    });
    padded(&table.keep(found, example))
}
