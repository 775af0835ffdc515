//! Writes a board's scene as a file and its device as text (docs/files.md), and lists the differences between two such
//! files or texts.
//!
//! A board that loads the written scene file gets the same numbers to the bit. A board's device cannot be written as a
//! file, because its links are lumped into the coefficients of the equations of motion, which the text lists.

use crate::digits::shorten;
use crate::error::on_one_line;
use core::f64::consts::TAU;
use haptic_bridge::model::description::{ANGLE_COUNTS, EncoderAt, Homing};
use haptic_bridge::model::device::{Device, Joint};
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::model::motor::Winding;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::render::scene::shape::Meaning;
use haptic_bridge::render::scene::{Scene, Wall};
use haptic_bridge::render::velocity::CutoffMeaning;
use serde::Serialize;
use std::fmt;

/// The value of a key.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A number.
    Number(f64),
    /// A list of numbers.
    Numbers(Vec<f64>),
    /// A string.
    Text(String),
    /// `true` or `false`.
    Flag(bool),
}

impl fmt::Display for Value {
    /// Formats the value as TOML.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number:?}"),
            Self::Numbers(numbers) => write!(f, "{numbers:?}"),
            // JSON's escapes are valid in TOML too, and keep the text on one line.
            Self::Text(text) => write!(f, "{}", on_one_line(&serde_json::Value::from(text.as_str()).to_string())),
            Self::Flag(flag) => write!(f, "{flag}"),
        }
    }
}

/// A key in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Table as in the file, such as `[[wall]]`; empty at the top.
    table: &'static str,
    /// Index among the tables of this name.
    index: usize,
    key: String,
    value: Value,
    unit: &'static str,
}

impl Entry {
    /// Returns the key with its table, such as `[[wall]] 1 stiffness`.
    fn place(&self) -> String {
        match self.table {
            "" => self.key.clone(),
            LUMPED_TABLE => format!("lumped {}", self.key),
            "[home]" | "[posture]" => format!("{} {}", self.table, self.key),
            table => format!("{table} {} {}", self.index, self.key),
        }
    }
}

/// Table of the coefficients of a device's equations of motion, which no device file contains.
const LUMPED_TABLE: &str = "[lumped]";

/// A key whose values differ in two files.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The key with its table.
    pub key: String,
    /// Unit of a number, otherwise empty.
    pub unit: &'static str,
    /// Value in the first file; `None` if the key is missing.
    pub from: Option<Value>,
    /// Value in the second file; `None` if the key is missing.
    pub to: Option<Value>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = |value: &Option<Value>| value.as_ref().map_or("none".to_string(), Value::to_string);
        write!(f, "{}: {} -> {}", self.key, value(&self.from), value(&self.to))?;
        if self.unit.is_empty() { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

/// Returns the differences between two lists of entries, in the order of the entries.
pub fn differences(from: &[Entry], to: &[Entry]) -> Vec<Difference> {
    let same = |a: &Entry, b: &Entry| (a.table, a.index, &a.key) == (b.table, b.index, &b.key);
    let difference = |entry: &Entry, from: Option<&Entry>, to: Option<&Entry>| Difference {
        key: entry.place(),
        unit: entry.unit,
        from: from.map(|entry| entry.value.clone()),
        to: to.map(|entry| entry.value.clone()),
    };
    let mut differences = Vec::new();
    for entry in from {
        let other = to.iter().find(|other| same(entry, other));
        if other.is_none_or(|other| other.value != entry.value) {
            differences.push(difference(entry, Some(entry), other));
        }
    }
    let new = to.iter().filter(|entry| !from.iter().any(|other| same(entry, other)));
    differences.extend(new.map(|entry| difference(entry, None, Some(entry))));
    differences
}

/// Formats the entries as a file that begins with the lines of `about` as comments.
pub fn to_toml(about: &[String], entries: &[Entry]) -> String {
    let mut text: String = about.iter().map(|line| format!("# {}\n", on_one_line(line))).collect();
    let mut table = ("", 0);
    for entry in entries {
        if table != (entry.table, entry.index) {
            table = (entry.table, entry.index);
            text += &format!("\n{}\n", entry.table);
        }
        let line = format!("{} = {}", entry.key, entry.value);
        text += &match entry.unit {
            "" => line + "\n",
            unit => format!("{line:31} # {unit}\n"),
        };
    }
    text
}

/// Collects the entries of one table.
struct Writer<'a> {
    entries: &'a mut Vec<Entry>,
    table: &'static str,
    index: usize,
}

impl Writer<'_> {
    fn put(&mut self, key: &str, value: Value, unit: &'static str) {
        let Self { table, index, .. } = *self;
        self.entries.push(Entry { table, index, key: key.into(), value, unit });
    }
    fn number(&mut self, key: &str, value: f64, unit: &'static str) {
        self.put(key, Value::Number(shorten(value)), unit);
    }
    fn numbers(&mut self, key: &str, values: &[f64], unit: &'static str) {
        self.put(key, Value::Numbers(values.iter().map(|value| shorten(*value)).collect()), unit);
    }
    fn word(&mut self, key: &str, word: &str) {
        self.put(key, Value::Text(word.into()), "");
    }
    fn flag(&mut self, key: &str, flag: bool) {
        self.put(key, Value::Flag(flag), "");
    }
}

fn table<'a>(entries: &'a mut Vec<Entry>, table: &'static str, index: usize) -> Writer<'a> {
    Writer { entries, table, index }
}

fn to_f64(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| shorten(f64::from(*value))).collect()
}

/// Returns the entries of the file of a scene.
pub fn scene(scene: &Scene<f32>) -> Vec<Entry> {
    let mut entries = Vec::new();
    let task = usize::from(scene.task).min(3);
    let mut top = table(&mut entries, "", 0);
    top.number("rate_hz", scene.rate_hz.into(), "Hz");
    top.word("estimator", scene.estimator.name());
    let (spec, chosen) = (scene.estimator.spec(), scene.estimator.chosen());
    if let (Some(key), Some(chosen)) = (spec.and_then(|spec| spec.key), chosen) {
        top.number(key.name, chosen.value.into(), key.unit);
    }
    // Omits the cutoff, because a cutoff in the file would add a low-pass to this estimator.
    let unfiltered = spec.is_some_and(|spec| spec.cutoff == CutoffMeaning::LowPassAfter)
        && chosen.is_some_and(|chosen| !chosen.filtered);
    if !unfiltered {
        top.number("cutoff_hz", scene.cutoff_hz.into(), "Hz");
    }
    top.flag("gravity_compensation", scene.gravity_compensation);
    top.word("velocity_terms", scene.velocity_terms.name());
    top.number("feed_forward_gain", scene.feed_forward_gain.into(), "");
    top.word("admissible", scene.admissible.name());
    for (index, wall) in scene.walls.iter().enumerate() {
        put_wall(&mut table(&mut entries, "[[wall]]", index), wall, task);
    }
    for (index, spring) in scene.springs.iter().enumerate() {
        let mut into = table(&mut entries, "[[spring]]", index);
        into.numbers("point", &to_f64(&spring.point[..task]), "m");
        if spring.direction != [0.0; 3] {
            into.numbers("direction", &direction(&spring.direction, task), "");
        }
        into.number("stiffness", spring.stiffness.into(), "N/m");
        into.number("damping", spring.damping.into(), "N s/m");
    }
    if scene.field_damping != 0.0 {
        table(&mut entries, "[[field]]", 0).number("damping", scene.field_damping.into(), "N s/m");
    }
    if let Some(posture) = &scene.posture {
        let mut into = table(&mut entries, "[posture]", 0);
        into.number("orientation", posture.orientation.into(), "rad");
        into.number("stiffness", posture.stiffness.into(), "N m/rad");
        into.number("damping", posture.damping.into(), "N m s/rad");
    }
    entries
}

fn put_wall(into: &mut Writer, wall: &Wall<f32>, task: usize) {
    let spec = wall.surface.spec();
    into.word("shape", spec.name);
    let values = wall.surface.values();
    let mut rest = &values[..];
    for (key, meaning) in spec.keys {
        let Some((value, after)) = rest.split_at_checked(meaning.width()) else { return };
        rest = after;
        match (meaning, value) {
            (Meaning::Point, point) => into.numbers(key, &to_f64(&point[..task]), "m"),
            (Meaning::Direction, [x, y, z]) => into.numbers(key, &direction(&[*x, *y, *z], task), ""),
            (Meaning::Length, [length]) => into.number(key, f64::from(*length), "m"),
            (Meaning::Flag, [flag]) => into.flag(key, *flag > 0.0),
            _ => {}
        }
    }
    into.number("stiffness", wall.stiffness.into(), "N/m");
    into.number("damping", wall.damping.into(), "N s/m");
    into.word("feed_forward", wall.feed_forward.name());
    into.number("washout_hz", wall.washout_hz.into(), "Hz");
    into.flag("damping_compensation", wall.damping_compensation);
    into.flag("bilateral", wall.bilateral);
}

/// Returns the interval of the f64 numbers that round to this f32 number.
fn rounding_interval(number: f32) -> (f64, f64) {
    let middle = |other: f32| 0.5 * (f64::from(number) + f64::from(other));
    (middle(number.next_down()), middle(number.next_up()))
}

/// Returns a vector whose unit vector, computed in double precision, rounds to `rounded`. Because the length of
/// `rounded` is not exactly 1, moves all entries by the same share of their rounding intervals until the length is 1.
fn direction(rounded: &[f32; 3], task: usize) -> Vec<f64> {
    let rounded = &rounded[..task];
    let short = to_f64(rounded);
    let rounds_back = |values: &[f64]| {
        crate::vectors::unit(values).is_some_and(|unit| unit.iter().zip(rounded).all(|(a, b)| *a as f32 == *b))
    };
    if rounds_back(&short) {
        return short;
    }
    let squared_length = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let exact: Vec<f64> = rounded.iter().map(|value| f64::from(*value)).collect();
    let grows = squared_length(&exact) < 1.0;
    let interval = rounded.iter().map(|value| {
        let (low, high) = rounding_interval(*value);
        let end = if grows == (*value > 0.0) { high } else { low };
        if *value == 0.0 { 0.0 } else { end - f64::from(*value) }
    });
    let interval: Vec<f64> = interval.collect();
    let at_share =
        |share: f64| exact.iter().zip(&interval).map(|(value, interval)| value + share * interval).collect::<Vec<_>>();
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if (squared_length(&at_share(middle)) < 1.0) == grows { low = middle } else { high = middle }
    }
    at_share(low)
}

fn put_joint(entries: &mut Vec<Entry>, index: usize, joint: &Joint<f32>, prismatic: bool) {
    let units = JointUnits::of(prismatic);
    let mut into = table(entries, "[[joint]]", index);
    into.number("viscous", joint.viscous.into(), units.viscous);
    into.number("coulomb", joint.coulomb.into(), units.torque);
    if let Some((low, high)) = joint.limits {
        into.numbers("limits", &to_f64(&[low, high]), units.travel);
    }
    let size = f64::from(joint.radians_per_count.abs());
    if size > 0.0 {
        let counts = f64::from(joint.counts_per_turn);
        let turns = (counts * size / TAU).round();
        let mut into = table(entries, "[joint.encoder]", index);
        match (joint.absolute, prismatic) {
            (Some(sensor), _) => {
                into.word("kind", sensor.chip.name());
                into.word("at", if sensor.at == EncoderAt::Joint { "joint" } else { "motor" });
            }
            (None, true) => into.number("counts_per_metre", 1.0 / size, ""),
            (None, false) => into.number("counts_per_turn", if turns > 0.0 { counts / turns } else { TAU / size }, ""),
        }
        into.number("offset", joint.offset.into(), units.travel);
        into.flag("inverted", joint.radians_per_count < 0.0);
    }
    if let Some(motor) = joint.motor {
        let mut into = table(entries, "[joint.motor]", index);
        if let Winding::ThreePhase { pole_pairs, ratio } = motor.winding {
            into.word("kind", "brushless");
            into.number("pole_pairs", pole_pairs.into(), "");
            put_ratio(&mut into, ratio.into(), prismatic);
        } else if joint.absolute.is_some_and(|sensor| sensor.at == EncoderAt::Motor) {
            put_ratio(&mut into, TAU / (size * f64::from(ANGLE_COUNTS)), prismatic);
        }
        match prismatic {
            true => into.number("force_constant", motor.torque_constant.into(), "N/A"),
            false => into.number("torque_constant", motor.torque_constant.into(), "N m/A"),
        }
        into.number("resistance", motor.resistance.into(), "ohm");
        into.number("inductance", motor.inductance.into(), "H");
        into.number("back_emf", motor.back_emf.into(), if prismatic { "V s/m" } else { "V s/rad" });
        into.number("max_current", motor.max_current.into(), "A");
        into.flag("verified", motor.verified);
    }
}

/// Writes the turns of the motor's shaft per turn of its joint, of a slide per 2π m.
fn put_ratio(into: &mut Writer, ratio: f64, prismatic: bool) {
    match prismatic {
        true => into.number("turns_per_metre", f64::from((ratio / TAU) as f32), ""),
        false => into.number("ratio", f64::from(ratio as f32), ""),
    }
}

/// Returns the entries of a device as a board stores it. The entries of the mechanism are the coefficients of the
/// equations of motion, with their names in src/model/mechanism.
pub fn device_entries(device: &Device<f32>) -> Vec<Entry> {
    let spec = device.mechanism.kind().spec();
    let mut entries = Vec::new();
    let mut top = table(&mut entries, "", 0);
    top.word("name", &device.name);
    top.word("mechanism", spec.name);
    put_coefficients(&mut table(&mut entries, LUMPED_TABLE, 0), &device.mechanism);
    for (index, joint) in device.joints.iter().enumerate().take(spec.joints) {
        put_joint(&mut entries, index, joint, device.mechanism.is_prismatic(index));
    }
    for (index, joint) in device.sensed.iter().enumerate() {
        let mut into = table(&mut entries, "[[sensed]]", index);
        let counts_per_turn = TAU / f64::from(joint.radians_per_count.abs());
        into.number("counts_per_turn", f64::from(counts_per_turn as f32), "");
        into.number("offset", joint.offset.into(), "rad");
        into.flag("inverted", joint.radians_per_count < 0.0);
    }
    if let Some(home) = device.home {
        let units = device.mechanism.units();
        let unit = if units.iter().all(|other| other == &units[0]) { units[0].travel } else { "rad or m" };
        let mut into = table(&mut entries, "[home]", 0);
        into.numbers("q", &to_f64(&home[..spec.joints]), unit);
        match device.homing {
            Homing::Hand => {}
            Homing::Index => into.word("by", "index"),
            Homing::Stop(stops) => {
                into.word("by", "stop");
                into.numbers("stop", &to_f64(&stops[..spec.joints]), unit);
            }
        }
    }
    entries
}

fn put_coefficients(into: &mut Writer, mechanism: &AnyMechanism<f32>) {
    fn collect(name: &str, value: &serde_json::Value, into: &mut Writer) {
        let under = |key: &str| if name.is_empty() { key.to_string() } else { format!("{name}.{key}") };
        match value {
            serde_json::Value::Object(map) => map.iter().for_each(|(key, value)| collect(&under(key), value, into)),
            serde_json::Value::Array(values) => match values.iter().map(serde_json::Value::as_f64).collect() {
                Some::<Vec<f64>>(numbers) => into.numbers(name, &numbers, unit(name)),
                None => values.iter().enumerate().for_each(|(at, value)| collect(&under(&at.to_string()), value, into)),
            },
            serde_json::Value::Bool(flag) => into.flag(name, *flag),
            serde_json::Value::Null => {}
            value => into.number(name, value.as_f64().unwrap_or(f64::NAN), unit(name)),
        }
    }
    let whole = serde_json::to_value(mechanism).unwrap_or_default();
    // The outermost key is the name of the mechanism.
    whole.as_object().into_iter().flatten().for_each(|(_, fields)| collect("", fields, into));
}

/// Returns the unit of a coefficient; empty for an unknown name.
fn unit(coefficient: &str) -> &'static str {
    let name = coefficient.trim_start_matches("plane.").split('.').next().unwrap_or_default();
    match name {
        "arc" | "tip" | "origin" | "length" | "lengths" | "base" | "proximal" | "axis_floor" | "offset" | "upper" => {
            "m"
        }
        "inverse_length" | "inverse_lengths" | "reach_scale" => "1/m",
        "reach" | "distal_difference" | "elbow_floor" | "rods_floor" | "leg_floor" | "fore_squared" => "m²",
        "elbow_scale" | "rods_scale" | "leg_scale" => "1/m²",
        "volume_floor" => "m³",
        "volume_scale" => "1/m³",
        "triangle_floor" => "m⁴",
        "inertias" | "inertia" | "arm_inertia" | "turret_inertia" | "coupling" | "spin" | "rotor" => "kg m²",
        "rod_coupling" | "tip_mass" | "elbow_load" | "tip_load" | "elbow_spin" | "coupled_spin" | "tip_spin" => "kg",
        "loads" => "kg m",
        "weight" | "weights" => "N m",
        "elbow_weights" | "tip_weight" => "N",
        "gravity" | "gravity_z" => "m/s²",
        _ => "",
    }
}
