//! A reader of the shipped and golden device files (docs/files.md) that does not check values.
//! tool/tests/quick/golden_model.rs compares it with the tool's own reader.

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{
    ANGLE_COUNTS, AngleChip, AngleSensor, Description, Encoder, EncoderAt, Homing, Joint, JointFrame, Link,
    Transmission,
};
use haptic_bridge::model::motor::{Motor, Winding};
use std::f64::consts::TAU;
use toml::{Table, Value};

pub fn shipped_device(name: &str) -> Description {
    let path = format!("{}/devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    parse(&std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}")))
}

/// Reads a device from the text of a file. Panics at an unknown key.
pub fn parse(text: &str) -> Description {
    let file: Table = text.parse().expect("a device file is TOML");
    assert_known_keys(
        &file,
        &["name", "mechanism", "gravity", "supply", "geometry", "link", "joint", "handle", "home", "sensed"],
    );
    let (mechanism, joints) = (file["mechanism"].as_str(), tables(&file, "joint").count());
    let is_kind = |kind: &&Kind| Some(kind.spec().name) == mechanism && kind.spec().joints == joints;
    let kind = *Kind::ALL.iter().find(is_kind).expect("a mechanism");
    let keys: Vec<&str> = kind.spec().geometry.iter().map(|(key, _)| *key).collect();
    let geometry = file["geometry"].as_table().expect("a table");
    assert_known_keys(geometry, &keys);
    let handle = file.get("handle").and_then(Value::as_table);
    Description {
        kind,
        gravity: to_array(numbers(&file["gravity"])),
        geometry: to_array(keys.iter().flat_map(|key| match (geometry.get(*key), *key) {
            (None, "azimuth") => vec![0.0, TAU / 3.0, 2.0 * TAU / 3.0],
            (None, "assembly") if kind == Kind::Delta => vec![1.0],
            (value, key) => coordinates(value.expect(key)),
        })),
        links: to_array(tables(&file, "link").map(link)),
        joints: to_array(tables(&file, "joint").map(joint)),
        handle_mass: handle.map_or(0.0, |handle| number(handle, "mass").expect("a mass")),
        home: file.get("home").map(|home| to_array(numbers(&home["q"]))),
        homing: Homing::Hand,
        sensed: to_array(tables(&file, "sensed").map(|table| Some(encoder(table)))),
    }
}

fn link(table: &Table) -> Link {
    assert_known_keys(table, &["mass", "com", "inertia", "inertia_axial", "inertia_transverse"]);
    let all = |key: &str| table.get(key).map_or(Vec::new(), |value| numbers(value).collect());
    let mass = number(table, "mass").expect("a mass");
    match (&all("com")[..], &all("inertia")[..]) {
        (&[x, y, z], &[ixx, iyy, izz, ixy, ixz, iyz]) => Link {
            mass,
            com: x,
            com_across: [y, z],
            inertia: izz,
            inertia_axial: ixx,
            inertia_transverse: iyy,
            inertia_products: [ixy, ixz, iyz],
        },
        (com, inertia) => {
            let [com, inertia] = [com, inertia].map(|values| values.first().copied().unwrap_or(0.0));
            let inertia_transverse = number(table, "inertia_transverse").unwrap_or(inertia);
            let inertia_axial = number(table, "inertia_axial").unwrap_or(0.0);
            Link { mass, com, inertia, inertia_axial, inertia_transverse, ..Link::default() }
        }
    }
}

fn frame(table: &Table) -> JointFrame {
    let vector = |key: &str, default| table.get(key).map_or(default, |value| to_array(numbers(value)));
    let frame = JointFrame::default();
    JointFrame {
        origin: vector("origin", frame.origin),
        rpy: vector("rpy", frame.rpy),
        axis: vector("axis", frame.axis),
    }
}

fn joint(table: &Table) -> Joint {
    let of_all = ["inertia", "viscous", "coulomb", "limits", "encoder", "motor", "transmission"];
    assert_known_keys(table, &[&of_all[..], &["type", "origin", "rpy", "axis"]].concat());
    let limits: Option<Vec<f64>> = table.get("limits").map(|limits| numbers(limits).collect());
    Joint {
        prismatic: table.get("type").is_some_and(|kind| kind.as_str() == Some("prismatic")),
        frame: frame(table),
        inertia: number(table, "inertia").expect("an inertia"),
        viscous: number(table, "viscous").unwrap_or(0.0),
        coulomb: number(table, "coulomb").unwrap_or(0.0),
        limits: limits.map(|limits| (limits[0], limits[1])),
        encoder: table.get("encoder").and_then(Value::as_table).map(encoder),
        absolute: table.get("encoder").and_then(Value::as_table).and_then(angle_sensor),
        motor: table.get("motor").and_then(Value::as_table).map(motor),
        rigid: table.get("transmission").is_some_and(|word| word.as_str() == Some("rigid")),
        transmission: table.get("transmission").and_then(Value::as_table).map(|values| transmission(values, table)),
        ..Joint::default()
    }
}

/// Returns an absolute encoder at the joint.
fn angle_sensor(table: &Table) -> Option<AngleSensor> {
    let chip = [AngleChip::As5047, AngleChip::As5048]
        .into_iter()
        .find(|chip| table.get("kind").is_some_and(|kind| kind.as_str() == Some(chip.name())))?;
    assert_eq!(table.get("at").and_then(Value::as_str), Some("joint"), "the place of an absolute encoder");
    Some(AngleSensor { chip, at: EncoderAt::Joint })
}

fn transmission(table: &Table, joint: &Table) -> Transmission {
    assert_known_keys(table, &["stiffness", "damping", "motor_inertia"]);
    Transmission {
        stiffness: number(table, "stiffness").expect("a stiffness"),
        damping: number(table, "damping").unwrap_or(0.0),
        motor_inertia: number(table, "motor_inertia").or(number(joint, "inertia")).expect("an inertia"),
        encoder_at: EncoderAt::Motor,
    }
}

fn encoder(table: &Table) -> Encoder {
    assert_known_keys(table, &["kind", "at", "counts_per_turn", "counts_per_metre", "offset", "inverted", "name"]);
    let counts_per_metre = number(table, "counts_per_metre").map(|counts| counts * TAU);
    let absolute = angle_sensor(table).map(|_| ANGLE_COUNTS.into());
    Encoder {
        counts_per_turn: number(table, "counts_per_turn").or(counts_per_metre).or(absolute).expect("counts"),
        offset: number(table, "offset").unwrap_or(0.0),
        inverted: table.get("inverted").is_some_and(|flag| flag.as_bool().expect("a flag")),
    }
}

fn motor(table: &Table) -> Motor<f64> {
    let is_brushless = table.get("kind").is_some_and(|kind| kind.as_str() == Some("brushless"));
    let keys = ["torque_constant", "force_constant"];
    let torque_constant = keys.iter().find_map(|key| number(table, key)).expect("a torque constant");
    let known = ["kind", "resistance", "inductance", "back_emf", "max_current", "verified", "pole_pairs", "ratio"];
    assert_known_keys(table, &[&keys[..], &known].concat());
    let [resistance, max_current] = ["resistance", "max_current"].map(|key| number(table, key).expect(key));
    Motor {
        torque_constant,
        resistance,
        inductance: number(table, "inductance").unwrap_or(0.0),
        back_emf: number(table, "back_emf").unwrap_or(torque_constant / if is_brushless { 1.5 } else { 1.0 }),
        max_current,
        winding: match is_brushless {
            false => Winding::Brushed,
            true => Winding::ThreePhase {
                pole_pairs: number(table, "pole_pairs").expect("pole pairs") as u8,
                ratio: number(table, "ratio").unwrap_or(1.0),
            },
        },
        verified: table.get("verified").is_some_and(|flag| flag.as_bool().expect("a flag")),
    }
}

/// Panics if the table has a key that the reader would ignore.
fn assert_known_keys(table: &Table, keys: &[&str]) {
    let unknown = table.keys().find(|key| !keys.contains(&key.as_str()));
    assert!(unknown.is_none(), "unknown key {unknown:?}; known keys: {keys:?}");
}

fn number(table: &Table, key: &str) -> Option<f64> {
    table.get(key).map(|value| numbers(value).next().expect("a number"))
}

/// Returns the entries of a list, or the single number.
fn numbers(value: &Value) -> impl Iterator<Item = f64> {
    let list = value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice);
    list.iter().map(|value| value.as_float().or(value.as_integer().map(|whole| whole as f64)).expect("a number"))
}

/// Returns the entries of a list of numbers or of task coordinates.
fn coordinates(value: &Value) -> Vec<f64> {
    let words = value.as_array().and_then(|list| list.iter().map(Value::as_str).collect::<Option<Vec<_>>>());
    let place =
        |word: &str| ["x", "y", "z", "arc"].iter().position(|known| *known == word).expect("a coordinate") as f64;
    words.map_or_else(|| numbers(value).collect(), |words| words.into_iter().map(place).collect())
}

fn tables<'a>(file: &'a Table, key: &str) -> impl Iterator<Item = &'a Table> {
    let list = file.get(key).map_or(&[][..], |list| list.as_array().expect("tables"));
    list.iter().map(|value| value.as_table().expect("a table"))
}

/// Fills an array with the values and pads it with the default.
fn to_array<T: Copy + Default, const N: usize>(values: impl Iterator<Item = T>) -> [T; N] {
    let mut array = [T::default(); N];
    values.enumerate().for_each(|(i, value)| array[i] = value);
    array
}
