//! Device files (docs/files.md): TOML in, a checked [`Description`] out, or an error that names the line.
//!
//! A mechanism's [`Spec`] lists the contents of its file, so a new mechanism needs no change here.
//! [`AnyMechanism::new`] accepts every description that this module returns: the geometry closes, and every joint has
//! inertia.

use crate::toml_file::{Document, FileError, Must, Problem, Table};
use crate::vectors::padded;
use core::f64::consts::TAU;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::drive::stage::MAX_DUTY;
use haptic_bridge::math::{Libm, Real};
use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS, Spec};
use haptic_bridge::model::description::{
    ANGLE_COUNTS, ARC, AngleChip, AngleSensor, Cogging, CoggingHarmonic, Description, DescriptionError, Encoder,
    EncoderAt, Homing, Joint, JointFrame, Link, MAX_COGGING, MAX_MODES, MAX_SENSED, Stribeck, StructuralMode,
    Transmission,
};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::with_mechanism;
use nalgebra::{Matrix3, SVector};
use std::path::{Path, PathBuf};

/// A checked device file.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Name of the device.
    pub name: String,
    /// The device.
    pub description: Description,
    /// The device's lumped coefficients in double precision.
    pub mechanism: AnyMechanism<f64>,
    /// Supply voltage of the board, V, if the file contains the voltage. Every motor's `max_current` in `description`
    /// is at most the current that the supply can drive through the motor at rest.
    pub supply: Option<f64>,
    /// `max_current` in the file, A, of each motor for which the supply reduces the current.
    pub max_current_in_file: [Option<f64>; MAX_JOINTS],
    /// Names of the encoders without motors, one each; empty if the file has none.
    pub sensed_names: Vec<String>,
}

/// Encoder inputs of every board (docs/wiring-*.md).
pub const BOARD_ENCODERS: usize = 3;

impl DeviceFile {
    /// Reads and checks the file at `path`.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, FileError> {
        Self::read(&Document::load(path.as_ref())?)
    }
    /// Reads and checks a text. Error messages name `origin` as the file.
    pub fn parse(text: &str, origin: impl Into<PathBuf>) -> Result<Self, FileError> {
        Self::read(&Document::new(text, origin))
    }
    /// Returns the number of joints and links, and the task dimension, of this device's mechanism.
    pub fn spec(&self) -> Spec {
        self.description.kind.spec()
    }
    /// Returns the device as a board receives it: lumped in double precision, rounded once.
    ///
    /// Errors: those of [`AnyMechanism::new`], which never occur for a device that this module has read.
    pub fn device<T: Real>(&self) -> Result<Device<T>, DescriptionError> {
        Device::new(&self.name, &self.description)
    }
    /// Returns the entries that a real board still needs before it arms, each with the key to write.
    pub fn missing_for_board(&self) -> Vec<String> {
        let mut missing = Vec::new();
        for (index, joint) in self.description.joints.iter().take(self.spec().joints).enumerate() {
            let place = format!("[[joint]] {index}");
            if joint.limits.is_none() {
                missing.push(format!("{place} needs limits = [lowest, highest]"));
            }
            if joint.encoder.is_none() {
                missing.push(format!("{place} needs [joint.encoder]"));
            }
            match joint.motor {
                None => missing.push(format!("{place} needs [joint.motor]")),
                Some(motor) if !motor.verified => {
                    missing.push(format!("check the motor data of {place}, then write verified = true"));
                }
                Some(motor) if motor.inductance == 0.0 => {
                    missing.push(format!("measure the inductance of the motor of {place}"));
                }
                Some(_) => {}
            }
        }
        let sensed = self.sensed_names.len();
        let surplus = (self.spec().joints + sensed).saturating_sub(BOARD_ENCODERS);
        if surplus > 0 {
            missing.push(format!(
                "a board has {BOARD_ENCODERS} encoder inputs, {surplus} too few for the joints and {sensed} [[sensed]]: \
                 remove {surplus} of them"
            ));
        }
        if self.description.home.is_none() && !self.device::<f64>().is_ok_and(|device| device.homes_itself()) {
            missing.push("[home] needs q, the pose that homing declares".into());
        }
        missing
    }

    /// Checks a document.
    pub fn read(document: &Document) -> Result<Self, FileError> {
        document.read(|top| {
            let (name, mut description, mechanism, supply, sensed_names) = device(top)?;
            let mut max_current_in_file = [None; MAX_JOINTS];
            for (joint, in_file) in description.joints.iter_mut().zip(&mut max_current_in_file) {
                let Some((motor, supply)) = joint.motor.as_mut().zip(supply) else { continue };
                let drivable = supply * f64::from(MAX_DUTY) / motor.supply_at_rest(1.0);
                if motor.max_current > drivable {
                    *in_file = Some(motor.max_current);
                    motor.max_current = drivable;
                }
            }
            let path = document.path().into();
            Ok(Self { path, name, description, mechanism, supply, max_current_in_file, sensed_names })
        })
    }
}

/// Name, description, lumped coefficients, supply (V), and the names of encoders without motors.
type Contents = (String, Description, AnyMechanism<f64>, Option<f64>, Vec<String>);

fn device(top: &Table<'_>) -> Result<Contents, FileError> {
    if !top.has("mechanism") && ["wall", "spring", "field", "rate_hz", "cutoff_hz"].iter().any(|key| top.has(key)) {
        let reason = "this looks like a scene file, not a device file";
        return Err(top.error_here(impossible(reason, "name the device file first, then its scene files")));
    }
    let tables = ["geometry", "link", "joint", "handle", "home", "sensed"];
    top.refuse_unknown_keys(&[&["name", "mechanism", "gravity", "supply"][..], &tables].concat());
    let name = top.keep(name(top), "");
    let kind = kind(top)?;
    let spec = kind.spec();
    let gravity = top.keep(gravity(top, &spec), Vec::new());

    let supply = top.keep(top.number("supply", Must::BePositive), None);
    let table = top.table("geometry").and_then(|table| top.require("geometry", table, "[geometry]"));
    let geometry_table = top.keep(table.map(Some), None);
    let geometry = geometry_table.as_ref().map_or([0.0; MAX_GEOMETRY], |table| geometry(table, &spec));
    let links = top.keep(links(top, &spec), Default::default());
    let joints = top.keep(joints(top, &spec), Default::default());
    let handle_mass = top.keep(handle(top, &spec), None).map_or(0.0, |handle| {
        handle.refuse_unknown_keys(&["mass"]);
        handle.required_number("mass", Must::NotBeNegative, "mass = 0.01")
    });
    let (home, homing) = top.keep(home(top, &spec, &joints), None).unzip();
    let homing = homing.unwrap_or_default();
    let sensed = top.keep(sensed(top), Vec::new());
    // The following checks need values without errors.
    top.check_no_errors()?;
    let geometry_table = geometry_table.unwrap_or_else(|| top.clone());

    let (sensed_names, encoders): (Vec<String>, Vec<Encoder>) = sensed.into_iter().unzip();
    let sensed = std::array::from_fn(|index| encoders.get(index).copied());
    let gravity = padded(&gravity);
    let description = Description { kind, gravity, geometry, links, joints, handle_mass, home, homing, sensed };
    let mechanism =
        AnyMechanism::new(&description).map_err(|error| description_error(error, top, &geometry_table, &spec))?;
    if description.is_flexible() && AnyMechanism::<f64>::new(&description.link_side()).is_err() {
        let reason = "without the motors' inertia a link has no inertia: a link behind a transmission needs its own";
        let remedy = "give the links masses, or a smaller motor_inertia in [joint.transmission]";
        return Err(top.error_here(impossible(reason, remedy)));
    }
    if let Some(joint) = joint_without_remaining_inertia(&description, &home.unwrap_or_default()) {
        let reason =
            format!("the modes of joint {joint} swing with more inertia than the links have about this joint at home");
        let remedy = "write the swinging part of the inertia about the joint, in kg m²";
        return Err(top.tables("joint")?[joint].error_at("mode", impossible(reason, remedy)));
    }
    let at = home.unwrap_or_default().map(|angle| angle as f32);
    if !AnyMechanism::<f32>::new(&description).is_ok_and(|board| board.is_finite_at::<BoardMath>(&at)) {
        let reason = "a number overflows the board's 32-bit floats";
        return Err(top.error_here(impossible(reason, "check the numbers and their units (SI: m, kg, s)")));
    }
    if let Some(q) = home
        && !linkage_closes(&mechanism, &q)
        && let Some(table) = top.table("home")?
    {
        let reason = "at the home pose the linkage cannot close: the links do not reach each other";
        return Err(table.error_at("q", impossible(reason, "write the joint angles of a pose the device can take")));
    }
    Ok((name.to_string(), description, mechanism, supply, sensed_names))
}

/// Reads the mechanism. Mechanisms of one name differ in the number of joints.
fn kind(top: &Table<'_>) -> Result<Kind, FileError> {
    let mut words: Vec<(&str, &str)> = Kind::ALL.iter().map(|kind| (kind.spec().name, kind.spec().name)).collect();
    words.dedup();
    let name = top.require("mechanism", top.word("mechanism", &words)?, "mechanism = \"five-bar\"")?;
    let joints = top.tables("joint")?.len();
    let named = || Kind::ALL.iter().copied().filter(|kind| kind.spec().name == name);
    // The error about a wrong number of joints is that of the smallest mechanism of the name.
    Ok(named().find(|kind| kind.spec().joints == joints).or(named().next()).unwrap_or(Kind::Paddle))
}

/// Reads gravity, m/s². A paddle's gravity may also be the single number zero.
fn gravity(top: &Table<'_>, spec: &Spec) -> Result<Vec<f64>, FileError> {
    let single = spec.are_links_optional && top.count("gravity") == Some(1);
    let count = if single { 1 } else { spec.gravity };
    let axes = ["x", "x, y", "x, y, z"][(count - 1).min(2)];
    let gravity = top.numbers("gravity", count, Must::BeFinite, &format!("{axes} in m/s²"));
    let example = format!("gravity = {:?}", vec![0.0; count]);
    let gravity = gravity.and_then(|value| match value {
        None if spec.are_links_optional && spec.joints > 1 => Ok(vec![0.0; count]),
        value => top.require("gravity", value, example),
    })?;
    if single && gravity != [0.0] {
        let remedy = "write gravity = [x, y] in m/s², in the plane in which angle 0 is along x";
        return Err(top.error_at("gravity", impossible("a paddle's gravity has two entries", remedy)));
    }
    Ok(gravity)
}

/// Reads the table of the handle, which paddles do not have.
fn handle<'a>(top: &Table<'a>, spec: &Spec) -> Result<Option<Table<'a>>, FileError> {
    let handle = top.table("handle")?;
    if spec.are_links_optional && handle.is_some() {
        let remedy = "add its mass to [[link]], or its mass times length² to the joint's inertia";
        return Err(top.error_at("handle", impossible("paddles take no [handle]", remedy)));
    }
    Ok(handle)
}

fn name<'a>(top: &Table<'a>) -> Result<&'a str, FileError> {
    let name = top.require("name", top.string("name")?, "name = \"my-device\"")?;
    if name.trim().is_empty() || name.chars().any(char::is_control) {
        let reason = "a device's name must be printable text on one line";
        return Err(top.error_at("name", impossible(reason, "write a name such as \"my-device\"")));
    }
    Ok(name)
}

fn impossible(reason: impl Into<String>, remedy: impl Into<String>) -> Problem {
    Problem::Impossible { reason: reason.into(), remedy: remedy.into() }
}

/// Reads the numbers of `[geometry]` in the order of the mechanism's [`Spec`].
fn geometry(table: &Table<'_>, spec: &Spec) -> [f64; MAX_GEOMETRY] {
    let known: Vec<&str> = spec.geometry.iter().map(|(key, _)| *key).collect();
    table.refuse_unknown_keys(&known);
    let mut flat = Vec::with_capacity(MAX_GEOMETRY);
    for (key, count) in spec.geometry {
        let default: &[f64] = match *key {
            "azimuth" => &[0.0, TAU / 3.0, 2.0 * TAU / 3.0],
            "assembly" if spec.name == "delta" => &[1.0],
            _ => &[],
        };
        if !default.is_empty() && !table.has(key) {
            flat.extend(default);
            continue;
        }
        if *key == "task" {
            flat.extend(table.keep(task(table, *count), vec![f64::NAN; *count]));
            continue;
        }
        if *count == 1 {
            flat.push(table.required_number(key, Must::BeFinite, format!("{key} = 0.1")));
            continue;
        }
        let values = table.numbers(key, *count, Must::BeFinite, "metres");
        let example = format!("{key} = {:?}", vec![0.1; *count]);
        let values = values.and_then(|values| table.require(key, values, example));
        flat.extend(table.keep(values, vec![f64::NAN; *count]));
    }
    padded(&flat)
}

/// Reads the task coordinates of a chain, as values of [`Description::geometry`].
fn task(table: &Table<'_>, count: usize) -> Result<Vec<f64>, FileError> {
    let known = [("x", 0.0), ("y", 1.0), ("z", 2.0), ("arc", ARC)];
    let example = ["task = [\"x\"]", "task = [\"x\", \"y\"]", "task = [\"x\", \"y\", \"z\"]"][(count - 1).min(2)];
    let words = table.require("task", table.words("task", count, &known)?, example)?;
    let twice = (1..count).find(|i| words[..*i].contains(&words[*i]));
    if let Some(element) = twice {
        let remedy = format!("write each of x, y and z at most once, such as {example}");
        return Err(table.error_at_element("task", element, impossible("a task coordinate occurs twice", remedy)));
    }
    Ok(words)
}

fn links(top: &Table<'_>, spec: &Spec) -> Result<[Link; MAX_LINKS], FileError> {
    let tables = top.tables("link")?;
    if spec.are_links_optional && tables.is_empty() {
        return Ok(Default::default());
    }
    let meaning = if spec.links.is_empty() {
        format!("a {} has no links: the joint's inertia includes its body", spec.name)
    } else {
        spec.links.join(", ")
    };
    top.keep(check_count(top, &tables, "link", spec.links.len(), meaning), ());
    let mut links = [Link::default(); MAX_LINKS];
    for ((index, table), name) in tables.into_iter().enumerate().zip(spec.links) {
        let table = table.with_place(format!("[[link]] {index} ({name})"));
        // A delta's rods are slender and uniform, and its platform does not turn.
        if spec.name == "delta" && index > 0 {
            table.refuse_unknown_keys(&["mass"]);
            let mass = table.required_number("mass", Must::NotBeNegative, "mass = 0.02");
            links[index] = Link { mass, ..Link::default() };
            continue;
        }
        if spec.name == "chain" {
            links[index] = spatial_link(&table);
            continue;
        }
        table.refuse_unknown_keys(&["mass", "com", "inertia", "inertia_axial", "inertia_transverse"]);
        let inertia = table.required_number("inertia", Must::NotBeNegative, "inertia = 1.0e-5");
        links[index] = Link {
            mass: table.required_number("mass", Must::NotBeNegative, "mass = 0.02"),
            com: table.required_number("com", Must::BeFinite, "com = 0.03"),
            inertia,
            inertia_axial: table.number_or("inertia_axial", Must::NotBeNegative, 0.0),
            inertia_transverse: table.number_or("inertia_transverse", Must::NotBeNegative, inertia),
            ..Link::default()
        };
    }
    Ok(links)
}

/// Reads a link of a chain.
fn spatial_link(table: &Table<'_>) -> Link {
    table.refuse_unknown_keys(&["mass", "com", "inertia"]);
    let mass = table.required_number("mass", Must::NotBeNegative, "mass = 0.02");
    let vector = |key: &str, count: usize, meaning: &str| {
        let values = table.numbers(key, count, Must::BeFinite, meaning);
        let example = format!("{key} = {:?}", vec![0.0; count]);
        table.keep(values.and_then(|values| table.require(key, values, example)), vec![f64::NAN; count])
    };
    let com = vector("com", 3, "x, y, z in m, in the link's frame");
    let inertia = vector("inertia", 6, "ixx, iyy, izz, ixy, ixz, iyz in kg m²");
    let link = Link {
        mass,
        com: com[0],
        com_across: [com[1], com[2]],
        inertia_axial: inertia[0],
        inertia_transverse: inertia[1],
        inertia: inertia[2],
        inertia_products: [inertia[3], inertia[4], inertia[5]],
    };
    // A body of points has a tensor with Σ m (r²/2 I - r rᵀ) positive semidefinite.
    let tensor = link.tensor();
    let spread = Matrix3::from_diagonal_element(0.5 * tensor.trace()) - tensor;
    let largest = tensor.amax();
    if spread.iter().all(|entry| entry.is_finite()) && spread.symmetric_eigenvalues().min() < -1e-6 * largest {
        let reason = "no body has this inertia tensor: each principal inertia is at most the sum of the other two";
        let remedy = "write ixx, iyy, izz, ixy, ixz, iyz about the centre of mass; a CAD program may print the products \
                      with the other sign";
        let result: Result<(), FileError> = Err(table.error_at("inertia", impossible(reason, remedy)));
        table.keep(result, ());
    }
    link
}

/// Refuses a wrong number of `[[key]]` tables. The error is at the first surplus table, otherwise at the last table.
fn check_count(
    top: &Table<'_>,
    tables: &[Table<'_>],
    key: &str,
    expected: usize,
    meaning: String,
) -> Result<(), FileError> {
    if tables.len() == expected {
        return Ok(());
    }
    let problem = Problem::WrongCount {
        table: format!("[[{key}]]"),
        expected: if expected == 0 { "no".into() } else { expected.to_string() },
        found: tables.len(),
        meaning,
    };
    Err(match tables.get(expected).or(tables.last()) {
        Some(table) => table.error_here(problem),
        None => top.error_here(problem),
    })
}

fn joints(top: &Table<'_>, spec: &Spec) -> Result<[Joint; MAX_JOINTS], FileError> {
    let tables = top.tables("joint")?;
    top.keep(check_count(top, &tables, "joint", spec.joints, "one per actuated joint, joint 0 first".into()), ());
    let mut joints = [Joint::default(); MAX_JOINTS];
    for ((index, table), joint) in tables.into_iter().enumerate().zip(&mut joints).take(spec.joints) {
        let place = format!("[[joint]] {index}");
        *joint = joint_of(&table.with_place(place), spec, index);
    }
    Ok(joints)
}

/// Reads joint `index` of a mechanism.
fn joint_of(table: &Table<'_>, spec: &Spec, index: usize) -> Joint {
    let is_chain = spec.name == "chain";
    let of_chain = ["type", "origin", "rpy", "axis"];
    let of_all =
        ["inertia", "viscous", "coulomb", "limits", "encoder", "motor", "transmission", "friction", "cogging", "mode"];
    table.refuse_unknown_keys(&[&of_all[..], if is_chain { &of_chain } else { &[] }].concat());
    let types = [("revolute", false), ("prismatic", true)];
    let prismatic = is_chain && table.keep(table.word("type", &types), None).unwrap_or(false);
    let frame = if is_chain { joint_frame(table) } else { JointFrame::SAME };
    // Returns an optional table of the joint.
    let part = |key: &str| {
        let place = format!("[joint.{key}] of {}", table.place());
        table.keep(table.table(key), None).map(|part| part.with_place(place))
    };
    let inertia = table.required_number("inertia", Must::NotBeNegative, "inertia = 2.0e-6");
    let coulomb = table.number_or("coulomb", Must::NotBeNegative, 0.0);
    let (rigid, transmission) = match table.is_string("transmission") {
        true => (table.keep(table.word("transmission", &[("rigid", true)]), None).is_some(), None),
        false => (false, part("transmission")),
    };
    let transmission = transmission.map(|part| transmission_of(&part, inertia, includes_body_inertia(spec, index)));
    let transmission = transmission.and_then(|found| table.keep(found.map(Some), None));
    let (encoder, motor) = (part("encoder"), part("motor"));
    // After an error, the rest of the table is read as that of an absolute encoder.
    let wrong = Some(AngleSensor { chip: AngleChip::As5047, at: EncoderAt::Motor });
    let absolute = encoder.as_ref().and_then(|part| table.keep(angle_sensor_of(part, prismatic), wrong));
    let transmission = match (transmission, absolute) {
        (Some(transmission), Some(sensor)) if part("transmission").is_some_and(|part| part.has("encoder_at")) => {
            if transmission.encoder_at != sensor.at {
                let reason = "`at` and the `encoder_at` of [joint.transmission] are different shafts";
                let error = Err(table.error_here(impossible(reason, "remove encoder_at: `at` is enough")));
                table.keep(error, ());
            }
            Some(transmission)
        }
        (Some(transmission), Some(sensor)) => Some(Transmission { encoder_at: sensor.at, ..transmission }),
        (transmission, _) => transmission,
    };
    let is_on_motor = absolute.is_some_and(|sensor| sensor.at == EncoderAt::Motor);
    let ratio = match &motor {
        Some(motor) if is_on_motor || is_brushless(motor) => ratio_of(motor, prismatic),
        None if is_on_motor && prismatic => {
            table.keep(table.require("motor", None, "[joint.motor] with turns_per_metre = 25"), 1.0)
        }
        _ => 1.0,
    };
    let friction = part("friction").and_then(|part| table.keep(friction_of(&part, coulomb).map(Some), None));
    Joint {
        prismatic,
        frame,
        inertia,
        viscous: table.number_or("viscous", Must::NotBeNegative, 0.0),
        coulomb,
        limits: table.keep(limits(table, JointUnits::of(prismatic).travel), None),
        encoder: encoder.map(|part| match absolute {
            None => encoder_of(&part, prismatic),
            Some(_) => Encoder {
                counts_per_turn: f64::from(ANGLE_COUNTS) * if is_on_motor { ratio } else { 1.0 },
                ..encoder_at(&part)
            },
        }),
        absolute,
        motor: motor.map(|part| motor_of(&part, prismatic, ratio, is_on_motor)),
        transmission,
        rigid,
        friction,
        cogging: part("cogging").map(|part| cogging_of(&part)),
        modes: table.keep(modes(table), Default::default()),
    }
}

/// Reads place and axis of a chain's joint.
fn joint_frame(table: &Table<'_>) -> JointFrame {
    let vector = |key: &str, usual: [f64; 3], meaning: &str| {
        let values = table.keep(table.numbers(key, 3, Must::BeFinite, meaning), None);
        values.map_or(usual, |values| padded(&values))
    };
    let JointFrame { origin, rpy, axis } = JointFrame::SAME;
    JointFrame {
        origin: vector("origin", origin, "x, y, z in m, in the frame of the link before"),
        rpy: vector("rpy", rpy, "roll, pitch, yaw in rad"),
        axis: vector("axis", axis, "x, y, z of a direction in the joint's frame"),
    }
}

/// Returns true if the joint's `inertia` includes the body that the joint turns, as for a paddle or a turret.
pub fn includes_body_inertia(spec: &Spec, joint: usize) -> bool {
    match spec.name {
        "paddle" | "paddles" => true,
        "five-bar-turret" | "parallelogram" => joint == 0,
        _ => false,
    }
}

/// Reads the transmission of a joint with this `inertia`, kg m². By default the motor has all of the inertia, except if
/// `includes_body`.
fn transmission_of(table: &Table<'_>, inertia: f64, includes_body: bool) -> Result<Transmission, FileError> {
    table.refuse_unknown_keys(&["stiffness", "damping", "motor_inertia", "encoder_at"]);
    let stiffness = table.required_number("stiffness", Must::BePositive, "stiffness = 50.0");
    let damping = table.number_or("damping", Must::NotBeNegative, 0.0);
    let motor_inertia = match table.number("motor_inertia", Must::BePositive)? {
        None if includes_body => table.require("motor_inertia", None, "motor_inertia = 1.0e-5")?,
        None if inertia == 0.0 => {
            let reason = "a transmission needs a motor with inertia on one side, and this joint has no inertia";
            let remedy = "write the rotor's reflected inertia as the joint's `inertia`";
            return Err(table.error_here(impossible(reason, remedy)));
        }
        None => inertia,
        Some(part) if part > inertia => {
            let reason = format!("motor_inertia is {part} kg m², more than all of the joint's inertia ({inertia})");
            let remedy = "write the part of the joint's `inertia` that is on the motor's side";
            return Err(table.error_at("motor_inertia", impossible(reason, remedy)));
        }
        Some(part) => part,
    };
    let sides = [("motor", EncoderAt::Motor), ("joint", EncoderAt::Joint)];
    let encoder_at = table.word("encoder_at", &sides)?.unwrap_or_default();
    Ok(Transmission { stiffness, damping, motor_inertia, encoder_at })
}

/// Reads the friction at rest of a joint with Coulomb friction `coulomb`, N m.
fn friction_of(table: &Table<'_>, coulomb: f64) -> Result<Stribeck, FileError> {
    table.refuse_unknown_keys(&["static", "stribeck_speed"]);
    let rest = table.required_number("static", Must::NotBeNegative, format!("static = {:?}", 1.5 * coulomb));
    let stribeck_speed = table.required_number("stribeck_speed", Must::BePositive, "stribeck_speed = 0.1");
    if rest < coulomb {
        let reason =
            format!("static is {rest} N m, less than the joint's coulomb ({coulomb}): friction is largest at rest");
        return Err(table.error_at("static", impossible(reason, "write at least as much as `coulomb`")));
    }
    Ok(Stribeck { rest, stribeck_speed })
}

/// Reads one harmonic from numbers, or several from lists of equal length.
fn cogging_of(table: &Table<'_>) -> Cogging {
    table.refuse_unknown_keys(&["amplitude", "per_turn", "phase"]);
    let mut harmonics = [CoggingHarmonic::default(); MAX_COGGING];
    let Some(count) = table.count("amplitude") else {
        harmonics[0] = CoggingHarmonic {
            amplitude: table.required_number("amplitude", Must::NotBeNegative, "amplitude = 0.001"),
            per_turn: table.required_number("per_turn", Must::BePositive, "per_turn = 24"),
            phase: table.number_or("phase", Must::BeFinite, 0.0),
        };
        return Cogging { harmonics };
    };
    if count > MAX_COGGING {
        let reason = format!("{} has {count} harmonics, and at most {MAX_COGGING} are simulated", table.place());
        table.keep(Err(table.error_at("amplitude", impossible(reason, "keep the largest"))), ());
    }
    let list = |key: &str, must: Must| table.numbers(key, count, must, "one for each harmonic");
    let amplitudes = table.keep(list("amplitude", Must::NotBeNegative), None).unwrap_or_default();
    let per_turn = list("per_turn", Must::BePositive);
    let example = "per_turn = [24, 48]";
    let per_turn = table.keep(per_turn.and_then(|value| table.require("per_turn", value, example)), Vec::new());
    let phases = table.keep(list("phase", Must::BeFinite), None).unwrap_or_else(|| vec![0.0; count]);
    for (harmonic, ((amplitude, per_turn), phase)) in
        harmonics.iter_mut().zip(amplitudes.into_iter().zip(per_turn).zip(phases))
    {
        *harmonic = CoggingHarmonic { amplitude, per_turn, phase };
    }
    Cogging { harmonics }
}

/// Reads the `[[joint.mode]]` tables of a joint.
fn modes(joint: &Table<'_>) -> Result<[Option<StructuralMode>; MAX_MODES], FileError> {
    let tables = joint.tables("mode")?;
    if let Some(surplus) = tables.get(MAX_MODES) {
        let reason = format!("{} has {} modes, and a joint has {MAX_MODES} at most", joint.place(), tables.len());
        return Err(surplus.error_here(impossible(reason, "keep the modes with the lowest frequencies")));
    }
    let mut modes = [None; MAX_MODES];
    for (index, table) in tables.into_iter().enumerate() {
        let table = table.with_place(format!("[[joint.mode]] {index} of {}", joint.place()));
        table.refuse_unknown_keys(&["frequency", "damping", "inertia"]);
        modes[index] = Some(StructuralMode {
            frequency: table.required_number("frequency", Must::BePositive, "frequency = 150.0"),
            damping: table.number_or("damping", Must::NotBeNegative, 0.0),
            inertia: table.required_number("inertia", Must::BePositive, "inertia = 1.0e-5"),
        });
    }
    Ok(modes)
}

/// Reads a joint's limits in this unit.
fn limits(joint: &Table<'_>, unit: &str) -> Result<Option<(f64, f64)>, FileError> {
    let meaning = if unit == "m" { "lowest, highest travel in m" } else { "lowest, highest angle in rad" };
    match joint.numbers("limits", 2, Must::BeFinite, meaning)?.as_deref() {
        Some([low, high]) if low < high => Ok(Some((*low, *high))),
        Some([low, high]) => {
            let reason = format!("limits of {} are the wrong way round: {low} is not below {high}", joint.place());
            Err(joint.error_at("limits", impossible(reason, format!("write [{meaning}]"))))
        }
        _ => Ok(None),
    }
}

fn encoder_of(table: &Table<'_>, prismatic: bool) -> Encoder {
    let (key, example, turn) = match prismatic {
        true => ("counts_per_metre", "counts_per_metre = 40000", TAU),
        false => ("counts_per_turn", "counts_per_turn = 16384", 1.0),
    };
    table.refuse_unknown_keys(&["kind", key, "offset", "inverted"]);
    Encoder { counts_per_turn: turn * table.required_number(key, Must::BePositive, example), ..encoder_at(table) }
}

/// Reads the angle at count 0 and the direction of an encoder.
fn encoder_at(table: &Table<'_>) -> Encoder {
    Encoder {
        counts_per_turn: f64::NAN,
        offset: table.number_or("offset", Must::BeFinite, 0.0),
        inverted: table.flag_or("inverted", false),
    }
}

/// Reads chip and place of an absolute encoder; `None` for an incremental encoder.
fn angle_sensor_of(table: &Table<'_>, prismatic: bool) -> Result<Option<AngleSensor>, FileError> {
    let chips = [AngleChip::As5047, AngleChip::As5048].map(|chip| (chip.name(), Some(chip)));
    let kinds = [("incremental", None), chips[0], chips[1]];
    let Some(chip) = table.word("kind", &kinds)?.flatten() else { return Ok(None) };
    if let Some(key) = ["counts_per_turn", "counts_per_metre"].into_iter().find(|key| table.has(key)) {
        let reason = format!("an {} always has {ANGLE_COUNTS} counts in a turn of its magnet", chip.name());
        let remedy = format!("remove {key}; for an encoder on the motor write `ratio` in [joint.motor]");
        return Err(table.error_at(key, impossible(reason, remedy)));
    }
    table.refuse_unknown_keys(&["kind", "at", "offset", "inverted"]);
    let at = table.word("at", &[("motor", EncoderAt::Motor), ("joint", EncoderAt::Joint)])?.unwrap_or_default();
    if prismatic && at == EncoderAt::Joint {
        let reason = "a slide does not turn, so its absolute encoder is on the motor";
        return Err(table.error_at("at", impossible(reason, "write at = \"motor\"")));
    }
    Ok(Some(AngleSensor { chip, at }))
}

/// Reads names and data of the encoders without motors.
fn sensed(top: &Table<'_>) -> Result<Vec<(String, Encoder)>, FileError> {
    let tables = top.tables("sensed")?;
    if let Some(surplus) = tables.get(MAX_SENSED) {
        let reason = format!("there are {} [[sensed]] tables, and a device has {MAX_SENSED} at most", tables.len());
        return Err(surplus.error_here(impossible(reason, "remove the others")));
    }
    let sensed = tables.into_iter().enumerate().map(|(index, table)| {
        let table = table.with_place(format!("[[sensed]] {index}"));
        table.refuse_unknown_keys(&["counts_per_turn", "offset", "inverted", "name"]);
        let name = table.keep(table.string("name"), None).map_or(format!("sensed {index}"), String::from);
        let encoder = Encoder {
            counts_per_turn: table.required_number("counts_per_turn", Must::BePositive, "counts_per_turn = 4096"),
            offset: table.number_or("offset", Must::BeFinite, 0.0),
            inverted: table.flag_or("inverted", false),
        };
        (name, encoder)
    });
    Ok(sensed.collect())
}

/// Returns true if a motor is brushless.
fn is_brushless(motor: &Table<'_>) -> bool {
    // An unknown kind is an error of `motor_of`.
    motor.word("kind", &[("brushed", false), ("brushless", true)]).ok().flatten().unwrap_or(false)
}

/// Reads the turns of a motor's shaft per turn of its joint, of a slide per 2π m.
fn ratio_of(motor: &Table<'_>, prismatic: bool) -> f64 {
    match prismatic {
        true => TAU * motor.required_number("turns_per_metre", Must::BePositive, "turns_per_metre = 25"),
        false => motor.number_or("ratio", Must::BePositive, 1.0),
    }
}

/// Reads a motor whose shaft makes `ratio` turns per turn of its joint. `has_ratio` if a brushed motor's file says it.
fn motor_of(table: &Table<'_>, prismatic: bool, ratio: f64, has_ratio: bool) -> Motor<f64> {
    let (key, example) = match prismatic {
        true => ("force_constant", "force_constant = 5.0"),
        false => ("torque_constant", "torque_constant = 0.05"),
    };
    let kinds = [("brushed", false), ("brushless", true)];
    let is_brushless = table.keep(table.word("kind", &kinds), None).unwrap_or(false);
    let of_all = ["kind", key, "resistance", "inductance", "back_emf", "max_current", "verified"];
    let turns = if prismatic { "turns_per_metre" } else { "ratio" };
    let further: &[&str] = match is_brushless {
        true => &["pole_pairs", turns],
        false if has_ratio => &[turns],
        false => &[],
    };
    table.refuse_unknown_keys(&[&of_all[..], further].concat());
    let torque_constant = table.required_number(key, Must::BePositive, example);
    // The power of three phases is 3/2 of the product of the peaks of voltage and current.
    let back_emf = if is_brushless { torque_constant / 1.5 } else { torque_constant };
    Motor {
        winding: if is_brushless { three_phase(table, ratio) } else { Winding::Brushed },
        torque_constant,
        resistance: table.required_number("resistance", Must::BePositive, "resistance = 2.0"),
        inductance: match is_brushless {
            true => table.required_number("inductance", Must::BePositive, "inductance = 0.001"),
            false => table.number_or("inductance", Must::NotBeNegative, 0.0),
        },
        back_emf: table.number_or(
            "back_emf",
            if is_brushless { Must::BePositive } else { Must::NotBeNegative },
            back_emf,
        ),
        max_current: table.required_number("max_current", Must::BePositive, "max_current = 3.0"),
        verified: table.flag_or("verified", false),
    }
}

/// Reads the poles of a brushless motor.
fn three_phase(table: &Table<'_>, ratio: f64) -> Winding<f64> {
    let pole_pairs = table.required_number("pole_pairs", Must::BePositive, "pole_pairs = 7");
    // A missing number is already an error.
    let is_count = pole_pairs.is_nan() || pole_pairs.fract() == 0.0 && pole_pairs <= f64::from(u8::MAX);
    let remedy = "write the number of magnets of the rotor, divided by two";
    let reason = format!("pole_pairs is {pole_pairs}, not a whole number from 1 to {}", u8::MAX);
    let checked = if is_count { Ok(()) } else { Err(table.error_at("pole_pairs", impossible(reason, remedy))) };
    table.keep(checked, ());
    Winding::ThreePhase { pole_pairs: pole_pairs as u8, ratio }
}

/// Home pose (rad) and reference of homing.
type Home = ([f64; MAX_JOINTS], Homing<f64>);

fn home(top: &Table<'_>, spec: &Spec, joints: &[Joint]) -> Result<Option<Home>, FileError> {
    let Some(table) = top.table("home")? else { return Ok(None) };
    let references = [("hand", Homing::Hand), ("index", Homing::Index), ("stop", Homing::Stop([0.0; MAX_JOINTS]))];
    let by = table.word("by", &references)?.unwrap_or_default();
    table.refuse_unknown_keys(if matches!(by, Homing::Stop(_)) { &["q", "by", "stop"] } else { &["q", "by"] });
    let q =
        table.numbers("q", spec.joints, Must::BeFinite, "one angle per joint in rad, of a slide its travel in m")?;
    let q = table.require("q", q, format!("q = {:?}", vec![0.0; spec.joints]))?;
    for (index, (angle, joint)) in q.iter().zip(joints).enumerate() {
        if let Some((low, high)) = joint.limits
            && !(low..=high).contains(angle)
        {
            let unit = JointUnits::of(joint.prismatic).travel;
            let reason = format!("home puts joint {index} at {angle} {unit}, outside its limits [{low}, {high}]");
            let radians = angle.to_radians();
            let remedy = match angle.abs() > TAU && (low..=high).contains(&radians) {
                _ if joint.prismatic => "move home or widen the limits; lengths are in metres".into(),
                true => format!("angles are in radians: {angle} degrees are {radians:.4} rad"),
                false if low.abs().max(high.abs()) > TAU && (low.to_radians()..=high.to_radians()).contains(angle) => {
                    let [low, high] = [low, high].map(f64::to_radians);
                    format!("angles are in radians: these limits, if meant in degrees, are [{low:.4}, {high:.4}] rad")
                }
                false => "move home or widen the limits".into(),
            };
            return Err(table.error_at_element("q", index, impossible(reason, remedy)));
        }
    }
    let homing = match by {
        Homing::Hand => by,
        Homing::Index => {
            if let Some(index) = joints.iter().position(|joint| joint.absolute.is_some()) {
                let reason = format!("the absolute encoder of joint {index} has no index mark");
                let remedy = "remove `by`; an absolute encoder needs no mark";
                return Err(table.error_at("by", impossible(reason, remedy)));
            }
            for (index, joint) in top.tables("joint")?.iter().enumerate() {
                if !joint.table("encoder")?.is_some_and(|encoder| encoder.has("offset")) {
                    let reason =
                        format!("homing by index needs the angle of joint {index} at its encoder's index mark");
                    let remedy = format!("write offset = 0.0 in [joint.encoder] of joint {index}, in rad");
                    return Err(table.error_at("by", impossible(reason, remedy)));
                }
            }
            by
        }
        Homing::Stop(_) => Homing::Stop(stops(&table, spec, joints)?),
    };
    Ok(Some((padded(&q), homing)))
}

/// Largest distance of a stop from the nearest limit of its joint, as a share of the limits' range.
const MAX_STOP_DISTANCE: f64 = 0.1;

/// Reads the joint angles (rad) at the stops, each at or just beyond a limit.
fn stops(table: &Table<'_>, spec: &Spec, joints: &[Joint]) -> Result<[f64; MAX_JOINTS], FileError> {
    let stops = table.numbers("stop", spec.joints, Must::BeFinite, "one angle per joint in rad")?;
    let ends = joints.iter().take(spec.joints).map(|joint| joint.limits.map_or(0.0, |(low, _)| low));
    let stops = table.require("stop", stops, format!("stop = {:?}", ends.collect::<Vec<f64>>()))?;
    for (index, (stop, joint)) in stops.iter().zip(joints).enumerate() {
        let near = |(low, high): (f64, f64)| {
            let beyond = (low - stop).max(stop - high);
            (0.0..=MAX_STOP_DISTANCE * (high - low)).contains(&beyond)
        };
        if !joint.limits.is_some_and(near) {
            let reason = format!("joint {index} has no limit near a stop at {stop} rad");
            let remedy = "a stop is at a limit of its joint or beyond it by at most a tenth of the limits' range";
            return Err(table.error_at_element("stop", index, impossible(reason, remedy)));
        }
    }
    Ok(padded(&stops))
}

/// Returns the first joint whose modes, together with the modes of the joints before this joint, leave the links no
/// inertia at the angles `q`, rad.
fn joint_without_remaining_inertia(description: &Description, q: &[f64; MAX_JOINTS]) -> Option<usize> {
    fn first_joint<const N: usize, M: Mechanism<f64, N>>(
        mechanism: &M,
        description: &Description,
        q: &[f64; MAX_JOINTS],
    ) -> Option<usize> {
        let pose = mechanism.pose::<Libm>(&SVector::<f64, N>::from_fn(|index, _| q[index]));
        let mut mass = mechanism.mass(&pose);
        if mass.iter().any(|entry| !entry.is_finite()) {
            // The linkage cannot close in this pose, and `linkage_closes` reports the error.
            return None;
        }
        (0..N).find(|&joint| {
            let swings: f64 = description.joints[joint].structural_modes().map(|mode| mode.inertia).sum();
            mass[(joint, joint)] -= swings;
            swings > 0.0 && mass.cholesky().is_none()
        })
    }
    if description.joints.iter().all(|joint| joint.structural_modes().next().is_none()) {
        return None;
    }
    let links = AnyMechanism::new(&description.link_side()).ok()?;
    with_mechanism!(&links, m => first_joint(m, description, q))
}

/// Returns true if the linkage closes at these joint angles.
fn linkage_closes(mechanism: &AnyMechanism<f64>, q: &[f64; MAX_JOINTS]) -> bool {
    fn is_regular<const N: usize, M: Mechanism<f64, N>>(mechanism: &M, q: &[f64; MAX_JOINTS]) -> bool {
        let angles = SVector::<f64, N>::from_fn(|index, _| q[index]);
        mechanism.regularity(&mechanism.pose::<Libm>(&angles)).parallel > 0.0
    }
    with_mechanism!(mechanism, m => is_regular(m, q))
}

/// Converts an error of the mechanism to an error at the key that causes the error.
fn description_error(error: DescriptionError, top: &Table<'_>, geometry: &Table<'_>, spec: &Spec) -> FileError {
    let problem = |remedy: &str| impossible(error.to_string(), remedy);
    match error {
        DescriptionError::GeometryNotPositive(index) => {
            let keys = spec.geometry.iter().flat_map(|(key, count)| (0..*count).map(move |element| (*key, element)));
            let (key, element) = keys.clone().nth(index).unwrap_or(("", 0));
            let reason = format!("`{key}` in [geometry]: {error}");
            geometry.error_at_element(key, element, impossible(reason, "write the length in metres"))
        }
        DescriptionError::Assembly => {
            geometry.error_at("assembly", problem("write 1 or -1, the side of the tip (docs/model.md section 1)"))
        }
        DescriptionError::CannotClose => {
            geometry.error_here(problem("check the lengths, in metres: each link must reach from one end to the other"))
        }
        DescriptionError::Axis(joint) => match top.tables("joint") {
            Ok(joints) if joints.len() > joint => {
                joints[joint].error_at("axis", problem("write axis = [0.0, 0.0, 1.0]"))
            }
            _ => top.error_here(problem("write axis = [0.0, 0.0, 1.0]")),
        },
        DescriptionError::Task => geometry.error_at(
            "task",
            problem(
                "choose the coordinates along which the joints move the tip; \"arc\" is for \
                one revolute joint",
            ),
        ),
        DescriptionError::NoInertia => match top.tables("joint") {
            Ok(joints) if !joints.is_empty() => {
                joints[0].error_at("inertia", problem("write the reflected rotor inertia in kg m²"))
            }
            _ => top.error_here(problem("write the reflected rotor inertia in kg m²")),
        },
        DescriptionError::WrongKind => top.error_at("mechanism", problem("name another mechanism")),
        DescriptionError::NotFinite | DescriptionError::Negative => {
            top.error_here(problem("check the numbers and their units (SI)"))
        }
    }
}
