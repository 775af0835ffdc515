//! Warnings about a scene on a device: walls, springs and fields that the device cannot reach or render stably.

use super::{FileWarning, Key};
use crate::bench::probe::on_surface;
use crate::bench::wall::WallSimulation;
use crate::boards::force_along;
use crate::ripple::LIGHT_HAND;
use crate::tune::{Settings, USUAL_RIPPLE_N};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::shape::Meaning;
use haptic_bridge::render::scene::{FeedForward, Scene, Surface, Wall};
use haptic_bridge::safety::limits::{GENTLE_FORCE, Limits};
use haptic_host::scene_file::place_of;
use haptic_host::vectors::{padded, padded_to};
use haptic_host::words::{digits, with_unit};
use haptic_sim::HandSettings;
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::flexible::{Flexible, Hand};
use haptic_stability::analysis::map::Reachable;
use haptic_stability::analysis::oscillation::Oscillation;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject, round_as_printed};
use haptic_stability::analysis::range::{COSTLY_RATIO, lower_corner, oscillation, stiffness_at};
use haptic_stability::analysis::sampled::{AnalysisError, Mode};
use haptic_stability::analysis::several::Member;
use nalgebra::{DVector, SVector};
use serde::Serialize;
use std::convert::Infallible;

/// Hand speed at which a wall's damping alone should not need all of the motors' torque, m/s.
const SLOW_HAND_SPEED: f64 = 0.1;
/// Largest force change by one count without a warning, N. The ripple is half of this change (docs/encoder-steps.md).
const BUZZ_N: f64 = 1.0;
/// Largest stiffness that a hand cannot feel, N/m.
const IMPERCEPTIBLE_STIFFNESS: f64 = 1.0;
/// Number of grid poses per joint, by number of joints.
const POSES_PER_JOINT: [usize; 3] = [400, 60, 16];
/// Limits of a wall at the pose in which the tip touches it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Contact {
    /// Index of the wall, from 0.
    pub wall: usize,
    /// Pose of the device with the tip on the wall, rad.
    pub q: Vec<f64>,
    /// Normal of the wall at that pose.
    pub normal: Vec<f64>,
    /// Stiffness of the wall, N/m.
    pub stiffness: f64,
    /// Largest stiffness that is predicted stable with the wall's damping and feed-forward, N/m.
    pub stable_to: f64,
    /// Largest stiffness that is predicted stable without feed-forward, N/m; `None` if the wall has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub off_to: Option<f64>,
    /// Stiffness that a hand feels at rest at `stable_to`, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt_to: Option<f64>,
    /// Stiffness that a hand feels at rest at the wall's own stiffness, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub felt: Option<f64>,
    /// Largest damping at which any stiffness is stable, N s/m.
    pub damping_to: f64,
    /// Limits in a hand; `None` if they are not predicted, for example with compensated damping.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub in_hand: Option<InHand>,
    /// Frequency at which the wall, or a stiffer wall if this one is stable, oscillates in the hand, Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hz: Option<f64>,
    /// Growing oscillation of the wall in the hand; `None` if no oscillation grows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub buzz: Option<Oscillation>,
    /// Largest force of the motors along the normal, N; `None` if a joint has no motor.
    pub force: Option<f64>,
    /// Tip motion along the normal per encoder count, m.
    pub count: f64,
    /// Largest force change by one encoder count with the wall's gains and the scene's estimator, N.
    pub step_n: f64,
    /// Simulated rms force above 20 Hz under a sliding hand, N; `None` without [`simulate_ripple`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ripple_n: Option<f64>,
    /// Options with which `haptic range DEVICE` predicts these limits.
    pub options: String,
    /// True if the device comes from a board, which does not know its compliant parts.
    #[serde(skip)]
    pub is_assumed_rigid: bool,
}

/// Limits of a wall with a hand at the tip. A hand may reduce the limits of a device with cables.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct InHand {
    /// Mass (kg), damping (N s/m) and stiffness (N/m) of the hand.
    pub hand: [f64; 3],
    /// Largest stable stiffness in the hand, N/m.
    pub stable_to: f64,
    /// Largest damping in the hand at which any stiffness is stable, N s/m.
    pub damping_to: f64,
}

impl core::fmt::Display for InHand {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let [mass, damping, stiffness] = self.hand;
        write!(f, "a hand of {mass} kg, {damping} N s/m and {stiffness} N/m")
    }
}

/// Returns the default hand of predictions, which `haptic sim --hand loop` simulates.
#[must_use]
pub fn default_hand() -> Hand {
    let HandSettings { mass, grip_damping, grip_stiffness, .. } = HandSettings::default();
    Hand { mass, damping: grip_damping, stiffness: grip_stiffness }
}

/// Returns all warnings about a scene, and the limits of each wall at the pose in which the tip touches it.
pub fn file_warnings(subject: &Subject, scene: &Scene<f64>) -> (Vec<FileWarning>, Vec<Contact>) {
    let (mut warnings, mut contacts) = (Vec::new(), Vec::new());
    let (device, path) = (&subject.device, subject.torque_path(scene.rate_hz));
    for (index, wall) in scene.walls.iter().enumerate() {
        match first_touch(device, &wall.surface) {
            FirstTouch::At(q, normal) => {
                let Some(contact) = contact_limits(subject, scene, index, &q, &normal, &path) else {
                    warnings.extend(unpredicted_warning(subject, index, wall));
                    continue;
                };
                warnings.extend(gain_warnings(wall, &contact, true));
                warnings.extend(soft_wall_warning(device, wall, &contact));
                warnings.extend(buzz_warning(scene, &contact));
                warnings.extend(washout_warning(subject, scene, &path, &contact));
                contacts.push(contact);
            }
            FirstTouch::Never(nearest) => warnings.push(reach_warning(index, &wall.surface, nearest)),
            FirstTouch::Unknown => {}
        }
    }
    warnings.extend(posture_warning(subject, scene, &path));
    warnings.extend(home_warnings(subject, scene, &path).into_iter().flatten());
    (warnings, contacts)
}

/// Warns that stability is not predicted because the wall compensates damping on a compliant device.
fn unpredicted_warning(subject: &Subject, index: usize, wall: &Wall<f64>) -> Option<FileWarning> {
    let shaped = wall.damping_compensation && wall.feed_forward != FeedForward::Off;
    let text = format!("the stability of wall {index} is not predicted: {}", AnalysisError::CompensatedFlexible);
    let key = Key { table: "wall", index: Some(index), part: "", name: "damping_compensation" };
    (shaped && subject.is_flexible()).then(|| FileWarning::new(key, text))
}

/// Warns of springs and fields that are unstable at home along the direction of the smallest inertia.
fn home_warnings(subject: &Subject, scene: &Scene<f64>, path: &TorquePath) -> Option<Vec<FileWarning>> {
    let device = &subject.device;
    let spec = device.mechanism.kind().spec();
    let q = &device.home?[..spec.joints];
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?;
    let jacobian = pose.jacobian.rows(0, spec.task).into_owned();
    let mobility = &jacobian * pose.mass.clone().cholesky()?.solve(&jacobian.transpose());
    let motions = mobility.symmetric_eigen();
    let lightest = motions.eigenvectors.column(motions.eigenvalues.imax());
    let prediction = Prediction::in_scene(subject, scene, None, path)?;
    let stable = |damping| prediction.stiffness_at(q, lightest.as_slice(), Mode::Off, damping).ok();
    let mut warnings = Vec::new();
    let mut warning = |table, index: usize, name, what: &str, has: f64, most: f64, unit| {
        let text = format!(
            "the {name} of {what}, {}, is beyond what is predicted stable at home: up to {}; it will vibrate unless \
             friction damps it",
            with_unit(has, unit),
            with_unit(most, unit)
        );
        warnings.push(FileWarning::new(Key { table, index: Some(index), part: "", name }, text));
    };
    for (index, spring) in scene.springs.iter().enumerate() {
        let (stable_to, damping_to) = stable(spring.damping)?;
        let what = format!("spring {index}");
        if spring.damping > damping_to {
            warning("spring", index, "damping", &what, spring.damping, damping_to, "N s/m");
        } else if spring.stiffness > stable_to {
            warning("spring", index, "stiffness", &what, spring.stiffness, stable_to, "N/m");
        }
    }
    let (_, damping_to) = stable(0.0)?;
    if scene.field_damping > damping_to {
        warning("field", 0, "damping", "the fields", scene.field_damping, damping_to, "N s/m");
    }
    Some(warnings)
}

/// Warns of a posture that the device cannot hold, and of an unstable spring of the posture.
fn posture_warning(subject: &Subject, scene: &Scene<f64>, path: &TorquePath) -> Option<FileWarning> {
    let (device, posture) = (&subject.device, scene.posture?);
    let key = |name| Key { table: "posture", index: None, part: "", name };
    let spec = device.mechanism.kind().spec();
    if spec.joints == spec.task {
        let text = format!(
            "a {} has one posture at each place of its tip: a board refuses this scene; leave [posture] out",
            spec.name
        );
        return Some(FileWarning::new(key("orientation"), text));
    }
    let q = &device.home?[..spec.joints];
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?;
    let unit_motion = pose.inverse.column(spec.joints - 1).into_owned();
    let row = pose.jacobian.row(spec.joints - 1).transpose();
    let viscous = DVector::from_fn(spec.joints, |i, _| device.joints[i].viscous);
    let flexible = Flexible { normal: DVector::zeros(spec.task), ..subject.compliant_parts() };
    let turning = Linearised { mass: pose.mass, viscous, row, unit_motion, gain: 1.0, flexible };
    let around = Prediction::in_scene(subject, scene, None, path)?.around;
    let (stable_to, damping_to) = stiffness_at(&turning, &around, Mode::Off, posture.damping).ok()?;
    let (name, has, most, unit) = if posture.damping > damping_to {
        ("damping", posture.damping, damping_to, "N m s/rad")
    } else if posture.stiffness > stable_to {
        ("stiffness", posture.stiffness, stable_to, "N m/rad")
    } else {
        return None;
    };
    let text = format!(
        "the {name} of the posture, {}, is beyond what is predicted stable at home: up to {}; the arm will swing about \
         its tip",
        with_unit(has, unit),
        with_unit(most, unit)
    );
    Some(FileWarning::new(key(name), text))
}

/// Returns the limits of wall `index` of a scene at a pose, with this torque path. Returns `None` at a singularity, for
/// an estimator without linear analysis, and for compensated damping on a compliant device.
pub fn contact_limits(
    subject: &Subject,
    scene: &Scene<f64>,
    index: usize,
    q: &[f64],
    normal: &[f64],
    path: &TorquePath,
) -> Option<Contact> {
    let (device, wall) = (&subject.device, scene.walls.get(index)?);
    // Rounds the values as the options print them.
    let rounded = |values: &[f64]| values.iter().map(|value| round_as_printed(*value)).collect::<Vec<_>>();
    let (q, normal) = (rounded(q), rounded(normal));
    let pose = TaskPose::of(&device.mechanism, &q).ok()?.regular().ok()?;
    let prediction = Prediction::in_scene(subject, scene, Some(wall), path)?;
    let mode = Mode::of(wall.feed_forward, wall.washout_hz);
    let linearised = prediction.linearise(&q, &normal).ok()?;
    let (stable_to, damping_to) = stiffness_at(&linearised, &prediction.around, mode, wall.damping).ok()?;
    let off_to = match mode {
        Mode::Off => None,
        _ => stiffness_at(&linearised, &prediction.around, Mode::Off, wall.damping).ok().map(|(off_to, _)| off_to),
    };
    let hand = default_hand();
    let held = linearised.clone().with_hand(hand);
    let in_hand = stiffness_at(&held, &prediction.around, mode, wall.damping).ok().map(|(stable_to, damping_to)| {
        InHand { hand: [hand.mass, hand.damping, hand.stiffness], stable_to, damping_to }
    });
    let buzz = |stiffness| {
        let swing = oscillation(&held, &prediction.around, mode, stiffness, wall.damping).ok().flatten();
        swing.filter(Oscillation::grows)
    };
    // Uses a stiffness just beyond the boundary, where the oscillation grows.
    let beyond = in_hand.map_or(0.0, |held| 1.001 * held.stable_to);
    let count = count_along(device, &pose, &normal);
    let estimator = prediction.around.estimator;
    let mut options = prediction.options(&q, &[Member::new(normal.clone(), 1.0)]);
    if let Mode::Washout(hz) = mode {
        options += &format!(" --washout {hz}");
    }
    Some(Contact {
        wall: index,
        stiffness: wall.stiffness,
        stable_to,
        off_to,
        felt_to: linearised.felt_stiffness(mode, stable_to),
        felt: linearised.felt_stiffness(mode, wall.stiffness),
        damping_to,
        in_hand,
        hz: buzz(wall.stiffness.max(beyond)).map(|swing| swing.hz),
        buzz: buzz(wall.stiffness),
        force: force_along(device, &pose, &normal),
        count,
        step_n: count * (wall.stiffness + wall.damping * estimator.peak_step_response(scene.rate_hz)),
        ripple_n: None,
        options: format!("{options} --kd {}", wall.damping),
        is_assumed_rigid: subject.joints.is_none(),
        q,
        normal,
    })
}

/// Returns the largest tip motion along a normal per encoder count, m.
pub fn count_along(device: &Device<f64>, pose: &TaskPose, normal: &[f64]) -> f64 {
    let per_radian = pose.jacobian.tr_mul(&padded_to(pose.jacobian.nrows(), normal));
    let moved = per_radian.iter().zip(&device.joints).map(|(move_, joint)| (move_ * joint.radians_per_count).abs());
    moved.fold(0.0, f64::max)
}

/// Gains above which a wall can only be on or off, at a pose and within a board's limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LargestGains {
    /// Stiffness at which one encoder count needs the largest force, N/m.
    pub stiffness: f64,
    /// Damping at which a hand at 1 cm/s needs the largest force, N s/m.
    pub damping: f64,
    /// Largest force along the normal that motors and limits allow, N.
    pub force: f64,
}

/// Speed of a hand that barely moves, m/s.
const CREEP_SPEED: f64 = 0.01;

/// Returns the largest useful gains of a wall at `q` (rad); `None` at a singularity or without a motor.
pub fn largest_gains(device: &Device<f64>, surface: &Surface<f64>, q: &[f64], limits: &Limits) -> Option<LargestGains> {
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?;
    let tip = SVector::from(padded::<3>(&pose.position));
    let normal = surface.contact::<Libm, 3>(&tip).normal;
    let normal = &normal.as_slice()[..pose.task];
    let mut limited = device.clone();
    let limits = limits.in_units(&device.mechanism.units());
    let most = limits.torque.iter().zip(&limits.current);
    for (motor, (torque, current)) in limited.joints.iter_mut().filter_map(|joint| joint.motor.as_mut()).zip(most) {
        let allowed = f64::from(*current).min(f64::from(*torque) / motor.torque_constant.abs());
        motor.max_current = motor.max_current.min(allowed);
    }
    let force = force_along(&limited, &pose, normal)?.min(limits.tip_force.into());
    let stiffness = force / count_along(device, &pose, normal).max(f64::MIN_POSITIVE);
    Some(LargestGains { stiffness, damping: force / CREEP_SPEED, force })
}

/// Returns the limits of wall `index` of a scene as if the tip touched it at this pose.
pub fn contact_limits_at(
    subject: &Subject,
    scene: &Scene<f64>,
    index: usize,
    q: &[f64],
    path: &TorquePath,
) -> Option<Contact> {
    let pose = TaskPose::of(&subject.device.mechanism, q).ok()?;
    let tip = SVector::from(padded::<3>(&pose.position));
    let normal = scene.walls.get(index)?.surface.contact::<Libm, 3>(&tip).normal;
    contact_limits(subject, scene, index, q, &normal.as_slice()[..pose.task], path)
}

/// Warns of gains that the loop or the motors cannot render. `in_file` is true for a wall in a scene file.
pub fn gain_warnings(wall: &Wall<f64>, contact: &Contact, in_file: bool) -> Vec<FileWarning> {
    let index = contact.wall;
    let rigid = if contact.is_assumed_rigid { ", if the device is rigid" } else { "" };
    let warning = |name: &'static str, text: String| FileWarning {
        key: in_file.then_some(Key { table: "wall", index: Some(index), part: "", name }),
        text,
    };
    let mut warnings = Vec::new();
    if wall.damping > contact.damping_to {
        let text = format!(
            "the damping of wall {index}, {} N s/m, is beyond what is predicted stable{rigid}: up to {} here; {} \
             (`haptic range DEVICE {}`)",
            digits(wall.damping),
            with_unit(contact.damping_to, "N s/m"),
            instability_text(wall, contact),
            contact.options
        );
        warnings.push(warning("damping", text));
    } else if wall.stiffness > contact.stable_to && contact.stable_to < IMPERCEPTIBLE_STIFFNESS {
        let text = format!(
            "no stiffness of wall {index} is predicted stable with {} of damping (the wall has {}); write a damping of up to \
             {} (`haptic range DEVICE {}`)",
            with_unit(wall.damping, "N s/m"),
            with_unit(wall.stiffness, "N/m"),
            with_unit(0.5 * contact.damping_to, "N s/m"),
            contact.options
        );
        warnings.push(warning("damping", text));
    } else if wall.stiffness > contact.stable_to {
        let text = format!(
            "the stiffness of wall {index}, {}, is beyond what is predicted stable{rigid}: up to {} here; this is {} times \
             that, and {} (`haptic range DEVICE {}`)",
            with_unit(wall.stiffness, "N/m"),
            with_unit(contact.stable_to, "N/m"),
            two_digits(wall.stiffness / contact.stable_to),
            instability_text(wall, contact),
            contact.options
        );
        warnings.push(warning("stiffness", text));
    } else if contact.buzz.is_some() {
        let text = format!(
            "the stiffness of wall {index}, {}, is predicted stable{rigid} only without a hand on the tip: {} (`haptic \
             range DEVICE {}{}`)",
            with_unit(wall.stiffness, "N/m"),
            instability_text(wall, contact),
            contact.options,
            contact.in_hand.map_or(String::new(), |held| {
                let [mass, damping, stiffness] = held.hand;
                format!(" --hand {mass},{damping},{stiffness}")
            })
        );
        warnings.push(warning("stiffness", text));
    }
    let Some(force) = contact.force else { return warnings };
    let per_count = wall.stiffness * contact.count;
    if per_count > force {
        let text = format!(
            "one encoder count into wall {index} ({}) needs {}, but the motors have {} there: the wall can only be on or off",
            with_unit(contact.count, "m"),
            with_unit(per_count, "N"),
            with_unit(force, "N")
        );
        warnings.push(warning("stiffness", text));
    }
    if wall.damping * SLOW_HAND_SPEED > force {
        let text = format!(
            "the damping of wall {index} needs {} at {SLOW_HAND_SPEED} m/s, but the motors have {} there",
            with_unit(wall.damping * SLOW_HAND_SPEED, "N"),
            with_unit(force, "N")
        );
        warnings.push(warning("damping", text));
    }
    warnings
}

/// Describes the behaviour of a wall that is unstable with or without a hand.
fn instability_text(wall: &Wall<f64>, contact: &Contact) -> String {
    let Some(held) = contact.in_hand else { return "it will vibrate unless friction damps it".into() };
    let (limit, gain) = match wall.damping > held.damping_to {
        true => (with_unit(held.damping_to, "N s/m"), "damping"),
        false => (with_unit(held.stable_to, "N/m"), "stiffness"),
    };
    match contact.buzz {
        Some(buzz) => format!(
            "in {held}, which allows a {gain} of up to {limit}, it will vibrate at about {:.0} Hz unless friction damps it",
            buzz.hz
        ),
        None => format!("it will vibrate unless friction or a hand damps it: {held} damps it up to {limit}"),
    }
}

/// Warns of a wall that encoder steps make buzz at this rate.
fn buzz_warning(scene: &Scene<f64>, contact: &Contact) -> Option<FileWarning> {
    let wall = scene.walls.get(contact.wall)?;
    // An unstable wall has its own warning.
    if contact.step_n <= BUZZ_N || wall.stiffness > contact.stable_to || wall.damping > contact.damping_to {
        return None;
    }
    let text = format!(
        "one encoder count ({}) changes the force of wall {} by up to {} at {} Hz: it will buzz unless friction holds it \
         (`haptic range` with --wall {},{} simulates that); less damping, a lower cutoff, a slower velocity or more counts help",
        with_unit(contact.count, "m"),
        contact.wall,
        with_unit(contact.step_n, "N"),
        scene.rate_hz,
        wall.stiffness,
        wall.damping
    );
    Some(FileWarning::new(Key { table: "wall", index: Some(contact.wall), part: "", name: "damping" }, text))
}

/// Stiffness of the softest useful wall, the stiffness of a light hand, N/m.
pub const SOFTEST_WALL: f64 = LIGHT_HAND.stiffness;

/// Ripple of a wall under a hand, by the simulation that `haptic tune` uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ripple {
    /// Root mean square of the force above 20 Hz while a hand slides along the wall, N; `None` if the tip flies off.
    pub ripple_n: Option<f64>,
    /// Allowed ripple, N: [`USUAL_RIPPLE_N`], or the smallest ripple that the encoders allow if that is larger.
    pub allowed_n: f64,
}

/// Simulates the ripple of a wall at its contact pose; returns `None` if a joint has no encoder.
pub fn ripple(description: &Description, scene: &Scene<f64>, contact: &Contact) -> Option<Ripple> {
    let wall = Settings::of(scene, contact.wall)?;
    let simulation = WallSimulation::new(description, description, &contact.q, &contact.normal, scene.rate_hz).ok()?;
    let of = |wall: Settings| simulation.slide(&wall.rendered_wall(scene.admissible), f64::INFINITY).ok();
    let ripple_n = of(wall)?.ripple_n;
    if ripple_n.is_some_and(|ripple| ripple <= USUAL_RIPPLE_N) {
        return Some(Ripple { ripple_n, allowed_n: USUAL_RIPPLE_N });
    }
    let softest = Settings { stiffness: wall.stiffness.min(SOFTEST_WALL), damping: 0.0, ..wall };
    let least = of(softest)?.ripple_n.unwrap_or_default();
    Some(Ripple { ripple_n, allowed_n: least.max(USUAL_RIPPLE_N) })
}

/// Simulates the ripple of a stable wall, stores it in `contact`, and warns if the wall rattles.
pub fn simulate_ripple(description: &Description, scene: &Scene<f64>, contact: &mut Contact) -> Option<FileWarning> {
    let wall = scene.walls.get(contact.wall)?;
    // An unstable wall has its own warning.
    if wall.stiffness > contact.stable_to || wall.damping > contact.damping_to {
        return None;
    }
    // A hand passes through a wall that is softer than its own spring, so there is no contact to judge.
    if wall.stiffness < SOFTEST_WALL {
        return None;
    }
    let Ripple { ripple_n, allowed_n } = ripple(description, scene, contact)?;
    contact.ripple_n = ripple_n;
    if contact.step_n > BUZZ_N || ripple_n.is_some_and(|ripple| ripple <= allowed_n) {
        return None;
    }
    let text = format!(
        "wall {} rattles: its force ripples by {} rms under a hand that slides along it, and {} {}; less damping or \
         stiffness, a lower cutoff or a slower velocity help, and `haptic tune DEVICE --scene SCENE` finds the stiffest \
         wall that does not",
        contact.wall,
        ripple_n.map_or("its full size".into(), |ripple| with_unit(ripple, "N")),
        with_unit(allowed_n, "N"),
        if allowed_n > USUAL_RIPPLE_N { "is the least that the encoders allow" } else { "is hardly felt" },
    );
    Some(FileWarning::new(Key { table: "wall", index: Some(contact.wall), part: "", name: "damping" }, text))
}

/// Share of the stable stiffness at which a wall is near its limit.
const NEAR_SHARE: f64 = 0.25;

/// Warns of a washout with which the stable stiffness is smaller than without feed-forward at the wall's damping. The
/// washout's corner is then too close to the frequencies of the loop.
fn washout_warning(subject: &Subject, scene: &Scene<f64>, path: &TorquePath, contact: &Contact) -> Option<FileWarning> {
    let wall = scene.walls.get(contact.wall)?;
    if wall.feed_forward != FeedForward::Washout || wall.stiffness <= NEAR_SHARE * contact.stable_to {
        return None;
    }
    let prediction = Prediction::in_scene(subject, scene, Some(wall), path)?;
    let stable_to = |mode| Some(prediction.stiffness_at(&contact.q, &contact.normal, mode, wall.damping).ok()?.0);
    let without = stable_to(Mode::Off)?;
    if contact.stable_to >= COSTLY_RATIO * without {
        return None;
    }
    let is_free = |hz| Ok::<_, Infallible>(stable_to(Mode::Washout(hz)).is_some_and(|kp| kp >= COSTLY_RATIO * without));
    let Ok(free) = lower_corner(wall.washout_hz, is_free);
    let instead = free.map_or(String::new(), |hz| format!("a corner of {hz} Hz costs nothing; or "));
    let text = format!(
        "the washout of wall {}, {} Hz, costs more than it brings: {} is predicted stable with it and {} without the \
         feed-forward; {instead}set feed_forward = \"off\"",
        contact.wall,
        wall.washout_hz,
        with_unit(contact.stable_to, "N/m"),
        with_unit(without, "N/m")
    );
    Some(FileWarning::new(Key { table: "wall", index: Some(contact.wall), part: "", name: "washout_hz" }, text))
}

fn two_digits(ratio: f64) -> String {
    if ratio < 10.0 {
        return format!("{ratio:.1}");
    }
    let last = 10.0_f64.powi(ratio.log10() as i32 - 1);
    format!("{:.0}", (ratio / last).round() * last)
}

enum FirstTouch {
    /// The tip touches the surface at these joint angles (rad), where the surface has this normal.
    At(Vec<f64>, Vec<f64>),
    /// The tip stays outside the surface by at least this distance, m; `None` if the tip stays inside.
    Never(Option<f64>),
    /// The workspace has no grid.
    Unknown,
}

/// Finds the pose on a surface that is nearest to home.
fn first_touch(device: &Device<f64>, surface: &Surface<f64>) -> FirstTouch {
    let spec = device.mechanism.kind().spec();
    let per_joint = POSES_PER_JOINT[spec.joints - 1];
    let home = device.home.unwrap_or_default();
    let far = |q: &[f64]| q.iter().zip(home).map(|(q, home)| (q - home).powi(2)).sum::<f64>();
    let Ok(poses) = on_surface(device, surface, per_joint, 0.0) else { return FirstTouch::Unknown };
    if let Some(nearest) = poses.iter().min_by(|a, b| far(&a.q[..spec.joints]).total_cmp(&far(&b.q[..spec.joints]))) {
        return FirstTouch::At(nearest.q[..spec.joints].to_vec(), nearest.normal[..spec.task].to_vec());
    }
    let Some((low, high)) = tip_distances(device, surface) else { return FirstTouch::Unknown };
    match (low, high) {
        (low, _) if low > 0.0 && low.is_finite() => FirstTouch::Never(Some(low)),
        (_, high) if high < 0.0 && high.is_finite() => FirstTouch::Never(None),
        _ => FirstTouch::Unknown,
    }
}

/// Returns the smallest and largest distance of the tip from a surface, negative inside it, m.
fn tip_distances(device: &Device<f64>, surface: &Surface<f64>) -> Option<(f64, f64)> {
    let grid = Reachable::of(device, POSES_PER_JOINT[device.mechanism.kind().spec().joints - 1], None).ok()?;
    let distances = grid.indices().filter_map(|index| {
        let pose = TaskPose::of(&device.mechanism, &grid.angles(index)).ok()?;
        let tip = SVector::from(padded::<3>(&pose.position));
        Some(surface.contact::<Libm, 3>(&tip).distance)
    });
    Some(distances.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d))))
}

/// Warns of a wall that is so soft that its force needs more depth than the tip can move along the normal. The force is
/// [`GENTLE_FORCE`], or the motors' largest if that is smaller. A wall without stiffness gets no warning.
fn soft_wall_warning(device: &Device<f64>, wall: &Wall<f64>, contact: &Contact) -> Option<FileWarning> {
    let force = contact.force.unwrap_or(f64::INFINITY).min(GENTLE_FORCE.into());
    let depth = force / wall.stiffness;
    // Skips the search for the tip's range at depths that every device reaches.
    if !(wall.stiffness > 0.0 && depth > 0.01) {
        return None;
    }
    let (low, high) = tip_distances(device, &wall.surface).filter(|(low, high)| low < high)?;
    let text = format!(
        "wall {} is so soft that it pushes with {} only at a depth of {}, and the tip moves by at most {} along its normal: \
         stiffness is in N/m, and {} N/mm are {} N/m",
        contact.wall,
        with_unit(force, "N"),
        with_unit(depth, "m"),
        with_unit(high - low, "m"),
        digits(wall.stiffness),
        digits(1e3 * wall.stiffness),
    );
    let key = Key { table: "wall", index: Some(contact.wall), part: "", name: "stiffness" };
    (depth > high - low).then(|| FileWarning::new(key, text))
}

fn reach_warning(index: usize, surface: &Surface<f64>, nearest: Option<f64>) -> FileWarning {
    let (name, at) = place_of(&surface.spec(), Meaning::Point).unwrap_or(("shape", 0));
    let far = surface.values().iter().skip(at).take(Meaning::Point.width()).any(|p| p.abs() > 3.0);
    let metres = if far { ": points are in metres" } else { "" };
    let text = match nearest {
        Some(nearest) => {
            format!("wall {index} is out of reach: the tip comes no nearer than {}{metres}", with_unit(nearest, "m"))
        }
        None => format!("the whole workspace is inside wall {index}{metres}; does its normal point out of the solid?"),
    };
    FileWarning::new(Key { table: "wall", index: Some(index), part: "", name }, text)
}
