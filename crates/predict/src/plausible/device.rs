//! Warnings about a device file.

use super::{FileWarning, Key, full_turns, in_degrees};
use crate::boards::torque_at_rest;
use core::f64::consts::{PI, TAU};
use haptic_bridge::drive::stage::MAX_DUTY;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{Description, Joint, Link};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::motor::Winding;
use haptic_bridge::model::units::SLIDE_LEVER;
use haptic_bridge::with_mechanism;
use haptic_host::device_file::{DeviceFile, includes_body_inertia};
use haptic_host::words::{digits, listed, with_unit};
use haptic_sim::PowerStage;
use haptic_stability::analysis::pose::TaskPose;
use nalgebra::{DMatrix, DVector, SVector, Vector3};

/// Density of steel, kg/m³.
const STEEL_DENSITY: f64 = 7850.0;
/// Plausible lengths of links, m, from desktop devices to exoskeletons.
const LINK_LENGTHS_M: (f64, f64) = (1e-3, 3.0);
/// Smallest implausible joint inertia, kg m²: the inertia of 20 kg at 10 cm, typical of machine tools.
const IMPLAUSIBLE_JOINT_INERTIA: f64 = 0.2;
/// Fewest plausible counts per turn at the joint. A smaller number is probably a count of lines without x4 decoding and
/// gear ratio; encoders of devices that render walls have at least 700 counts.
const LEAST_COUNTS: f64 = 600.0;
/// Largest plausible resistance times inertia over the torque constant squared, s. Motors have 2 to 30 ms whatever the
/// gear. The value is too large by the ratio squared if only the torque constant lacks the gear ratio.
const LARGEST_MOTOR_TIME_S: f64 = 0.25;
/// Largest plausible twist of a transmission by its motor, rad. Cables and belts twist by hundredths of a radian.
const LARGEST_WIND_UP: f64 = 0.1;
/// Largest plausible product of resistance and largest current, V. The boards take up to 56 V.
const LARGEST_SUPPLY_V: f64 = 120.0;
/// Smallest implausible inductance, H. Windings of desktop motors have 0.01 to 10 mH.
const IMPLAUSIBLE_INDUCTANCE: f64 = 0.1;
/// Force that no hand can hold, N.
const LARGEST_FORCE_N: f64 = 500.0;
/// Sine of the singular angle at home below which a device can hardly push.
const HOME_SINE: f64 = 0.02;

fn key(table: &'static str, index: Option<usize>, part: &'static str, name: &'static str) -> Key {
    Key { table, index, part, name }
}

/// Returns all warnings about a device.
pub fn file_warnings(file: &DeviceFile) -> Vec<FileWarning> {
    let (description, spec) = (&file.description, file.spec());
    let mut warnings = length_warnings(description);
    let longest = longest_length(description);
    let heaviest = STEEL_DENSITY * (longest / 2.0).powi(3);
    for (index, link) in description.links.iter().enumerate().take(spec.links.len()) {
        let place = format!("[[link]] {index} ({})", spec.links[index]);
        warnings.extend(link_warnings(link, spec.name == "chain", index, &place, longest, heaviest));
    }
    if description.handle_mass > heaviest {
        warnings.push(mass_warning(key("handle", None, "", "mass"), "[handle]", description.handle_mass, heaviest));
    }
    for (index, joint) in description.joints.iter().enumerate().take(spec.joints) {
        warnings.extend(joint_warnings(joint, index, description.kind));
        warnings.extend(motor_warnings(joint, index, spec.joints, includes_body_inertia(&spec, index)));
        warnings.extend(current_shortfall(file, index));
    }
    warnings.extend(missing_transmission(description));
    let gravity = description.gravity.iter().take(spec.task).map(|g| g * g).sum::<f64>().sqrt();
    if gravity != 0.0 && !(1.0..12.0).contains(&gravity) {
        let text = format!("gravity is {gravity:.3} m/s² in total: on earth it is 9.81");
        warnings.push(FileWarning::new(key("", None, "", "gravity"), text));
    }
    warnings.extend(home_warnings(description));
    warnings
}

/// Warns if the file does not state the compliance between motor and link, which limits the stiffness of walls.
fn missing_transmission(description: &Description) -> Option<FileWarning> {
    let joints = &description.joints[..description.kind.spec().joints];
    let is_unspecified = |joint: &Joint| joint.motor.is_some() && joint.transmission.is_none() && !joint.rigid;
    let first = joints.iter().position(is_unspecified)?;
    let unspecified: Vec<String> = joints
        .iter()
        .enumerate()
        .filter(|(_, joint)| is_unspecified(joint))
        .map(|(index, _)| index.to_string())
        .collect();
    let text = format!(
        "the file does not describe the transmission of joint {}: predictions take it for rigid, but a cable or a belt limits \
         the stiffness of a wall; write [joint.transmission], or transmission = \"rigid\" if the motor sits on the joint",
        listed(&unspecified)
    );
    Some(FileWarning::new(key("joint", Some(first), "", "transmission"), text))
}

fn longest_length(description: &Description) -> f64 {
    let of_chain = |at: [f64; 3]| Vector3::from(at).norm();
    let [x, y, z, ..] = description.geometry;
    match description.kind {
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => description
            .joints
            .iter()
            .map(|joint| of_chain(joint.frame.origin))
            .fold(of_chain([x, y, z]).max(0.1), f64::max),
        _ => named_lengths(description).map(|(_, length)| length).fold(0.0, f64::max),
    }
}

/// Returns the lengths of the geometry with their keys. A chain's tip may have any coordinates.
fn named_lengths(description: &Description) -> impl Iterator<Item = (&'static str, f64)> + '_ {
    let keys = description.kind.spec().geometry.iter().flat_map(|(key, count)| (0..*count).map(move |_| *key));
    keys.zip(description.geometry).filter(|(key, _)| !["assembly", "azimuth", "tip", "task"].contains(key))
}

fn length_warnings(description: &Description) -> Vec<FileWarning> {
    let mut warnings: Vec<FileWarning> = Vec::new();
    for (name, length) in named_lengths(description) {
        // The base may be zero because two motors may share an axis.
        let short = length < LINK_LENGTHS_M.0 && name != "base";
        let at = key("geometry", None, "", name);
        if (short || length > LINK_LENGTHS_M.1) && warnings.iter().all(|warning| warning.key != Some(at)) {
            let meant = if short {
                format!("{} mm?", digits(length * 1e3))
            } else {
                format!("{length} mm are {} m", digits(length / 1e3))
            };
            warnings.push(FileWarning::new(
                at,
                format!("`{name}` in [geometry] is {length} m: lengths are in metres ({meant})"),
            ));
        }
    }
    warnings
}

fn mass_warning(at: Key, place: &str, mass: f64, heaviest: f64) -> FileWarning {
    let text = format!(
        "{place} weighs {mass} kg, more than a steel cube half as wide as the longest link ({}): masses are in kg \
         ({mass} g are {} kg)",
        with_unit(heaviest, "kg"),
        digits(mass / 1e3)
    );
    FileWarning::new(at, text)
}

/// Warns of values that no body of this mass and length has.
fn link_warnings(
    link: &Link,
    is_chain: bool,
    index: usize,
    place: &str,
    longest: f64,
    heaviest: f64,
) -> Vec<FileWarning> {
    let at = |name| key("link", Some(index), "", name);
    let mut warnings = Vec::new();
    if link.mass > heaviest {
        warnings.push(mass_warning(at("mass"), place, link.mass, heaviest));
    }
    let com = Vector3::from(link.com_vector()).norm();
    if com > 2.0 * longest {
        let text = format!(
            "the centre of mass of {place} lies {com} m from its joint, and the longest link has {longest} m: lengths are \
             in metres"
        );
        warnings.push(FileWarning::new(at("com"), text));
    }
    // A chain's link may lie along any axis, so the mean of its two largest principal inertias is judged.
    let inertia = if is_chain { 0.5 * link.tensor().trace() } else { link.inertia };
    // A link with an inertia of zero is a point mass.
    if link.mass == 0.0 || inertia == 0.0 {
        return warnings;
    }
    let gyration = (inertia / link.mass).sqrt();
    // A solid ball is the most compact body of its mass.
    let ball = (3.0 * link.mass / (4.0 * PI * STEEL_DENSITY)).cbrt() * 0.4_f64.sqrt();
    if gyration > longest || gyration < ball {
        let bound = if gyration > longest {
            format!("more than if all of it were {longest} m away, the longest link's length")
        } else {
            let least = link.mass * ball * ball;
            let least = if least < 1e-3 { format!("{least:.2e}") } else { digits(least) };
            format!("less than a steel ball of that mass ({least} kg m²)")
        };
        let text = format!(
            "`inertia` of {place} is {} kg m² for {}: {bound}; it is taken about the centre of mass, in kg m² \
             (1 g cm² is 1e-7)",
            digits(inertia),
            with_unit(link.mass, "kg")
        );
        warnings.push(FileWarning::new(at("inertia"), text));
    }
    // No body has an inertia that exceeds the sum of the inertias about the two perpendicular axes.
    let three = [link.inertia, link.inertia_axial, link.inertia_transverse];
    let sum: f64 = three.iter().sum();
    if !is_chain && three.iter().any(|one| *one > 1.01 * (sum - one)) {
        let text = format!(
            "the three inertias of {place} ({}, axial {}, transverse {}) fit no body: one exceeds the sum of the \
             other two",
            link.inertia, link.inertia_axial, link.inertia_transverse
        );
        warnings.push(FileWarning::new(at("inertia_axial"), text));
    }
    warnings
}

fn joint_warnings(joint: &Joint, index: usize, kind: Kind) -> Vec<FileWarning> {
    let mut warnings = Vec::new();
    let mut warning =
        |part, name, text: String| warnings.push(FileWarning::new(key("joint", Some(index), part, name), text));
    // A slide's inertia is a mass.
    if joint.inertia > IMPLAUSIBLE_JOINT_INERTIA && !joint.prismatic {
        let text = format!(
            "`inertia` of joint {index} is {} kg m², as much as {:.0} kg at 10 cm: 1 g cm² is 1e-7 kg m²",
            digits(joint.inertia),
            100.0 * joint.inertia
        );
        warning("", "inertia", text);
    }
    if let Some((low, high)) = joint.limits
        && let Some(angle) = [low, high].into_iter().find(|angle| in_degrees(kind, *angle))
    {
        warning("", "limits", full_turns(&format!("a limit of joint {index}"), angle));
    }
    if let Some(encoder) = joint.encoder {
        if joint.prismatic {
            // As coarse at the lever as the least counts of a turn.
            if encoder.counts_per_turn * f64::from(SLIDE_LEVER) < LEAST_COUNTS {
                let text = format!(
                    "the encoder of joint {index} has {} counts per metre, {} each: count after x4 decoding",
                    digits(encoder.counts_per_turn / TAU),
                    with_unit(TAU / encoder.counts_per_turn, "m")
                );
                warning("encoder", "counts_per_metre", text);
            }
        } else if encoder.counts_per_turn < LEAST_COUNTS {
            let text = format!(
                "the encoder of joint {index} has {} counts per turn, {:.1} degrees each: count after x4 decoding, times \
                 the gear ratio, at the joint ({} lines are {} counts without a gear)",
                encoder.counts_per_turn,
                360.0 / encoder.counts_per_turn,
                encoder.counts_per_turn,
                4.0 * encoder.counts_per_turn
            );
            warning("encoder", "counts_per_turn", text);
        }
        if in_degrees(kind, encoder.offset) {
            warning("encoder", "offset", full_turns(&format!("the encoder offset of joint {index}"), encoder.offset));
        }
    }
    warnings
}

/// Warns of a `max_current` that the supply cannot drive through the motor.
fn current_shortfall(file: &DeviceFile, index: usize) -> Option<FileWarning> {
    let motor = file.description.joints[index].motor?;
    let (volts, supply) = (motor.supply_at_rest(motor.max_current), PowerStage::default().bus_voltage);
    let given = with_unit(motor.max_current, "A");
    let text = if let Some((supply, written)) = file.supply.zip(file.max_current_in_file[index]) {
        format!(
            "the supply of {supply} V drives {given} through the motor of joint {index} at rest ({MAX_DUTY} of it over its \
             resistance), not its max_current of {}: predictions use {given}",
            with_unit(written, "A")
        )
    } else if file.supply.is_none() && volts > supply * f64::from(MAX_DUTY) && volts <= LARGEST_SUPPLY_V {
        format!(
            "the motor of joint {index} takes {} at rest for its max_current, and a simulated board has {supply} V where \
             the file names no supply: write supply = {supply} (V) at its top, or what feeds your board",
            with_unit(volts, "V")
        )
    } else {
        return None;
    };
    Some(FileWarning::new(key("joint", Some(index), "motor", "max_current"), text))
}

/// Warns of implausible motor values. `carries_body` is true if the joint's inertia includes more than the motor's.
fn motor_warnings(joint: &Joint, index: usize, joints: usize, carries_body: bool) -> Vec<FileWarning> {
    let mut warnings = Vec::new();
    let mut warning =
        |part, name, text: String| warnings.push(FileWarning::new(key("joint", Some(index), part, name), text));
    let Some(motor) = joint.motor else { return warnings };
    let (torque, units) = (torque_at_rest(&motor, joints), joint.units());
    let (lever, constant) =
        (f64::from(units.lever), if joint.prismatic { "force_constant" } else { "torque_constant" });
    let volts = motor.supply_at_rest(motor.max_current);
    if volts > LARGEST_SUPPLY_V {
        let text = format!(
            "the motor of joint {index} would need {} for its max_current: resistance is in ohm, current in A",
            with_unit(volts, "V")
        );
        warning("motor", "max_current", text);
    }
    let (emf_share, relation) = match motor.winding {
        Winding::Brushed => (1.0, "in SI both are the same number"),
        Winding::ThreePhase { .. } => (1.5, "in SI the back-EMF of a phase is two thirds of the torque constant"),
    };
    if motor.back_emf > 0.0 && !(0.5..2.0).contains(&(emf_share * motor.back_emf / motor.torque_constant)) {
        let text = format!(
            "back_emf of joint {index} is {} {} and {constant} {} {}/A: {relation}",
            motor.back_emf,
            if joint.prismatic { "V s/m" } else { "V s/rad" },
            motor.torque_constant,
            units.torque
        );
        warning("motor", "back_emf", text);
    }
    if motor.inductance >= IMPLAUSIBLE_INDUCTANCE {
        let text = format!("`inductance` of joint {index} is {} H: 1 mH is 0.001", motor.inductance);
        warning("motor", "inductance", text);
    }
    let seconds = motor.resistance * joint.inertia / motor.torque_constant.powi(2);
    if seconds > LARGEST_MOTOR_TIME_S && !carries_body {
        let text = format!(
            "`{constant}` of joint {index}, {} {}/A, takes {seconds:.1} s to speed up its own rotor (resistance times \
             inertia over its square), and motors take hundredths: write the motor's constant times the gear ratio, and as \
             inertia the rotor's times the ratio squared",
            motor.torque_constant, units.torque
        );
        warning("motor", constant, text);
    }
    if let Some(wound) =
        joint.transmission.map(|between| torque / between.stiffness).filter(|wound| *wound > LARGEST_WIND_UP * lever)
    {
        let most = with_unit(torque, units.torque);
        let text = match joint.prismatic {
            true => format!(
                "the transmission of joint {index} stretches by {} at the largest force of its motor ({most}): stiffness is \
                 in N/m",
                with_unit(wound, "m")
            ),
            false => format!(
                "the transmission of joint {index} winds up by {:.0} degrees at the largest torque of its motor ({most}): \
                 stiffness is in N m/rad at the joint, and a cable of c N/m on a sector of radius r has c r²",
                wound.to_degrees()
            ),
        };
        warning("transmission", "stiffness", text);
    }
    if joint.coulomb > torque {
        let text = format!(
            "the friction of joint {index} ({} {}) exceeds the torque of its motor ({}): the joint cannot move",
            joint.coulomb,
            units.torque,
            with_unit(torque, units.torque)
        );
        warning("", "coulomb", text);
    } else if joint.viscous * TAU * lever > torque {
        let speed = if joint.prismatic { "0.5 m/s" } else { "one turn per second" };
        let text = format!(
            "viscous friction of joint {index} needs {} at {speed}, more than its motor has ({})",
            with_unit(joint.viscous * TAU * lever, units.torque),
            with_unit(torque, units.torque)
        );
        warning("", "viscous", text);
    }
    warnings
}

/// Warns of angles in degrees, a singular pose, motors too weak for the device's weight, and excessive force at home.
fn home_warnings(description: &Description) -> Vec<FileWarning> {
    let joints = description.kind.spec().joints;
    let at = key("home", None, "", "q");
    let Some(home) = description.home else { return Vec::new() };
    let home = &home[..joints];
    let degrees = home.iter().enumerate().filter(|(_, angle)| in_degrees(description.kind, **angle));
    let mut warnings: Vec<FileWarning> = degrees
        .map(|(joint, angle)| FileWarning::new(at, full_turns(&format!("home of joint {joint}"), *angle)))
        .collect();
    let Ok(device) = Device::<f64>::new("", description) else { return warnings };
    let Ok(pose) = TaskPose::of(&device.mechanism, home) else { return warnings };
    if warnings.is_empty() && pose.regularity.serial.min(pose.regularity.parallel) < HOME_SINE {
        let text = "home is a singular pose, where the device can hardly push: choose another home".into();
        warnings.push(FileWarning::new(at, text));
    }
    if arms_cross(description, home) {
        let text = "the arms cross at home, each between its motor and its elbow: joint 0 is the motor at -base/2, joint 1 the \
                    one at +base/2; exchange them, or write the other angles"
            .into();
        warnings.push(FileWarning::new(at, text));
    }
    for (joint, weight) in weight(&device, home).iter().enumerate().take(joints) {
        let Some(motor) = device.joints[joint].motor else { continue };
        let (torque, units) = (torque_at_rest(&motor, joints), description.joints[joint].units());
        if weight.abs() > torque {
            let text = format!(
                "the device's weight needs {} at joint {joint} at home, but its motor has {}: the device falls when armed",
                with_unit(weight.abs(), units.torque),
                with_unit(torque, units.torque)
            );
            let constant = if description.joints[joint].prismatic { "force_constant" } else { "torque_constant" };
            warnings.push(FileWarning::new(key("joint", Some(joint), "motor", constant), text));
        }
    }
    if let Some((weakest, _)) = force_at(&device, &pose).filter(|(weakest, _)| *weakest > LARGEST_FORCE_N) {
        let text = format!(
            "the motors push with {} at the tip at home, more than a hand can hold: torque constants are in N m/A (a data sheet's \
             mN m/A are thousandths), currents in A",
            with_unit(weakest, "N")
        );
        warnings.push(FileWarning::new(key("joint", Some(0), "motor", "torque_constant"), text));
    }
    warnings
}

/// Returns true if the proximal arms of a five-bar cross at these joint angles, rad.
fn arms_cross(description: &Description, q: &[f64]) -> bool {
    let q = match description.kind {
        Kind::FiveBar => q,
        Kind::FiveBarTurret => &q[1..],
        _ => return false,
    };
    let [base, first, second, ..] = description.geometry;
    // Elbow positions relative to the left motor. Arms on one axis do not cross.
    let (c, d) = ((first * q[0].cos(), first * q[0].sin()), (base + second * q[1].cos(), second * q[1].sin()));
    let cross_product =
        |p: (f64, f64), q: (f64, f64), r: (f64, f64)| (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
    let apart = |p, q, r, s| cross_product(p, q, r) * cross_product(p, q, s) < 0.0;
    let (a, b) = ((0.0, 0.0), (base, 0.0));
    base > 0.0 && apart(a, c, b, d) && apart(b, d, a, c)
}

/// Returns the joint torques that carry the device's weight, N m.
pub(crate) fn weight(device: &Device<f64>, q: &[f64]) -> Vec<f64> {
    fn of<const N: usize, M: Mechanism<f64, N>>(m: &M, q: &[f64]) -> Vec<f64> {
        m.gravity(&m.pose::<Libm>(&SVector::<f64, N>::from_column_slice(q))).iter().copied().collect()
    }
    with_mechanism!(&device.mechanism, m => of(m, q))
}

/// Returns the largest force of the motors at a pose along their weakest and their strongest direction, N. The force
/// acts only along this direction; a redundant device makes no moment at the tip.
///
/// Forces f with |Jᵀ f| within the motors' torques fill a polytope. Its nearest boundary point is on the face of one
/// joint. Its farthest point is a corner, at which as many joints as directions have their largest torque.
pub fn force_at(device: &Device<f64>, pose: &TaskPose) -> Option<(f64, f64)> {
    let jacobian = pose.jacobian.rows(0, pose.task);
    let motors = device.joints.iter().take(jacobian.ncols()).map(|joint| joint.motor);
    let most: Vec<f64> =
        motors.map(|motor| motor.map(|motor| torque_at_rest(&motor, device.axes()))).collect::<Option<_>>()?;
    let faces = most.iter().zip(jacobian.column_iter()).map(|(torque, column)| torque / column.norm());
    let weakest = faces.fold(f64::INFINITY, f64::min);
    let mut strongest = 0.0_f64;
    for chosen in (0..1_usize << most.len()).filter(|chosen| chosen.count_ones() as usize == pose.task) {
        let joints: Vec<usize> = (0..most.len()).filter(|joint| chosen >> joint & 1 == 1).collect();
        let rows = DMatrix::from_fn(pose.task, pose.task, |row, axis| jacobian[(axis, joints[row])]);
        let Some(inverse) = rows.try_inverse() else { continue };
        for signs in 0..1_usize << pose.task {
            let sign = |row: usize| if signs >> row & 1 == 1 { -1.0 } else { 1.0 };
            let force = &inverse * DVector::from_fn(pose.task, |row, _| sign(row) * most[joints[row]]);
            let torques = jacobian.tr_mul(&force);
            if torques.iter().zip(&most).all(|(torque, most)| torque.abs() <= most * (1.0 + 1e-9)) {
                strongest = strongest.max(force.norm());
            }
        }
    }
    (weakest.is_finite() && strongest > 0.0).then_some((weakest, strongest))
}
