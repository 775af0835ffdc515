//! Effect on one wall if one number of the device becomes a tenth larger or smaller at the same tip position.

use super::{angles_at, singular_pose, task_position};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{Description, Joint};
use haptic_host::error::Failure;
use haptic_stability::analysis::control_loop::{Loop, Mode};
use haptic_stability::analysis::map::effective_inertias;
use haptic_stability::analysis::pose::{TaskPose, unit_normal};
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::boundary_of;
use serde::Serialize;

/// Relative change of each number, up and down.
pub const CHANGE: f64 = 0.1;

/// Properties of a changed device at the wall, relative to the properties of the unchanged device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Weff, the inertia without the feed-forward and in free motion.
    pub w_eff: f64,
    /// Wrr, the inertia with the feed-forward.
    pub w_rr: f64,
    /// Largest stiffness that is predicted stable without the feed-forward.
    pub off: f64,
    /// Largest stiffness that is predicted stable with the feed-forward.
    pub full: f64,
    /// Largest force of the motors along the normal; `None` without motors.
    pub force: Option<f64>,
    /// Tip motion per encoder count; `None` without encoders.
    pub count: Option<f64>,
    /// Largest joint torque that holds the device's weight, N m; this value is absolute.
    pub weight: f64,
}

/// One number of the device with its effects.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Description of the number.
    pub part: String,
    /// Effect of a tenth more, or of adding a counterweight; `None` if the tip cannot reach the same position.
    pub more: Option<Effect>,
    /// Effect of a tenth less; `None` for a counterweight, or if the tip cannot reach the same position.
    pub less: Option<Effect>,
}

/// Function that changes a device by a factor.
type Change = Box<dyn Fn(&mut Description, f64)>;

/// Returns the links that scale with an entry of a mechanism's geometry.
fn links_of(kind: Kind, entry: usize) -> &'static [usize] {
    let of_each: &[&[usize]] = match kind {
        // A chain's links do not scale with its tip.
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => &[],
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => &[&[0], &[1], &[2]],
        Kind::FiveBar | Kind::FiveBarTurret => &[&[], &[0], &[1], &[2], &[3]],
        // The coupler has the length of the upper arm.
        Kind::Parallelogram => &[&[0, 3], &[1], &[2]],
        Kind::Serial3r => &[&[0], &[1], &[2]],
        Kind::Delta => &[&[], &[], &[0]],
    };
    of_each.get(entry).copied().unwrap_or_default()
}

/// Adds a counterweight of a tenth of the link's mass, as far behind the joint as the centre of mass is in front.
fn add_counterweight(description: &mut Description, link: usize) {
    let link = &mut description.links[link];
    let (added, place) = (CHANGE * link.mass, -link.com);
    let mass = link.mass + added;
    let com = (link.mass * link.com + added * place) / mass;
    let moved = link.mass * (link.com - com).powi(2) + added * (place - com).powi(2);
    link.inertia += moved;
    link.inertia_transverse += moved;
    (link.mass, link.com) = (mass, com);
}

/// Scales the motor's inertia: `motor_inertia` of the transmission, or else the joint's complete inertia.
fn scale_motor(joint: &mut Joint, factor: f64) {
    let motor = joint.transmission.map_or(joint.inertia, |transmission| transmission.motor_inertia);
    joint.inertia += (factor - 1.0) * motor;
    if let Some(transmission) = &mut joint.transmission {
        transmission.motor_inertia *= factor;
    }
}

/// Returns all changes: name, function, and true if the change applies in both directions.
fn changes(description: &Description) -> Vec<(String, Change, bool)> {
    let spec = description.kind.spec();
    let mut all: Vec<(String, Change, bool)> = Vec::new();
    let mut entry = 0;
    for (key, count) in spec.geometry {
        for i in 0..*count {
            let at = entry + i;
            if !["assembly", "azimuth", "task"].contains(key) {
                let name = if *count > 1 { format!("{key}[{i}]") } else { (*key).to_string() };
                let kind = description.kind;
                let stretched = links_of(kind, at);
                let what = if stretched.is_empty() { String::new() } else { ", its link stretched with it".into() };
                all.push((
                    format!("length {name}{what}"),
                    Box::new(move |d, factor| {
                        d.geometry[at] *= factor;
                        for link in links_of(kind, at) {
                            d.links[*link].com *= factor;
                            d.links[*link].inertia *= factor * factor;
                            d.links[*link].inertia_transverse *= factor * factor;
                        }
                    }),
                    true,
                ));
            }
        }
        entry += count;
    }
    for (i, name) in spec.links.iter().enumerate() {
        let link = description.links[i];
        let mut add = |what: &str, there: bool, change: Change| {
            if there {
                all.push((format!("{what} of {name}"), change, true));
            }
        };
        add("mass", link.mass > 0.0, Box::new(move |d, factor| d.links[i].mass *= factor));
        let is_offset = link.com_vector() != [0.0; 3];
        add(
            "centre of mass",
            link.mass > 0.0 && is_offset,
            Box::new(move |d, factor| {
                d.links[i].com *= factor;
                d.links[i].com_across = d.links[i].com_across.map(|across| across * factor);
            }),
        );
        add(
            "inertia",
            link.inertia > 0.0,
            Box::new(move |d, factor| {
                d.links[i].inertia *= factor;
                d.links[i].inertia_axial *= factor;
                d.links[i].inertia_transverse *= factor;
                d.links[i].inertia_products = d.links[i].inertia_products.map(|product| product * factor);
            }),
        );
        if link.mass > 0.0 && link.com != 0.0 {
            all.push((format!("counterweight on {name}"), Box::new(move |d, _| add_counterweight(d, i)), false));
        }
    }
    for joint in 0..spec.joints {
        if description.joints[joint].inertia > 0.0 {
            all.push((
                format!("rotor of joint {joint}"),
                Box::new(move |d, factor| scale_motor(&mut d.joints[joint], factor)),
                true,
            ));
        }
        all.push((
            format!("gear ratio of joint {joint}"),
            Box::new(move |d, factor| {
                let joint = &mut d.joints[joint];
                scale_motor(joint, factor * factor);
                joint.viscous *= factor * factor;
                joint.coulomb *= factor;
                if let Some(friction) = &mut joint.friction {
                    friction.rest *= factor;
                }
                if let Some(motor) = &mut joint.motor {
                    motor.torque_constant *= factor;
                    motor.back_emf *= factor;
                }
                if let Some(encoder) = &mut joint.encoder {
                    encoder.counts_per_turn *= factor;
                }
            }),
            true,
        ));
    }
    if description.handle_mass > 0.0 {
        all.push(("mass of the handle".into(), Box::new(|d, factor| d.handle_mass *= factor), true));
    }
    all
}

/// Number of dampings on a boundary, evenly spaced shares of the largest damping, before and after a change.
const DAMPING_COUNT: usize = 40;

/// Computes the absolute properties of a device at a pose.
fn results_at(prediction: &Prediction, q: &[f64], normal: &[f64]) -> Option<Effect> {
    let (device, admissible) = (&prediction.subject.device, prediction.admissible);
    let linearised = prediction.linearise(q, normal).ok()?;
    let stiffest = |mode| {
        let shares = |end: f64| (0..DAMPING_COUNT).map(|i| end * (i as f64 + 0.5) / DAMPING_COUNT as f64).collect();
        let boundary = boundary_of(&linearised, &linearised, &prediction.around, mode, shares).ok()?;
        Some(boundary.iter().map(|point| point.kp).fold(0.0, f64::max))
    };
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?.holding(admissible);
    let n = unit_normal(normal, pose.task, q.len()).ok()?;
    let (w_eff, w_rr) = effective_inertias(&pose, &n)?;
    let steps = pose.jacobian.tr_mul(&n);
    let count = steps.iter().zip(&device.joints).map(|(lever, joint)| (lever * joint.radians_per_count).abs());
    let count = count.fold(0.0, f64::max);
    let weight =
        crate::plausible::device::weight(device, q).iter().fold(0.0_f64, |most, torque| most.max(torque.abs()));
    Some(Effect {
        w_eff,
        w_rr,
        off: stiffest(Mode::Off)?,
        full: stiffest(Mode::Full)?,
        force: crate::boards::force_along(device, &pose, normal),
        count: (count > 0.0).then_some(count),
        weight,
    })
}

fn ratios_of(after: Effect, before: Effect) -> Effect {
    let ratio = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a / b);
    Effect {
        w_eff: after.w_eff / before.w_eff,
        w_rr: after.w_rr / before.w_rr,
        off: after.off / before.off,
        full: after.full / before.full,
        force: ratio(after.force, before.force),
        count: ratio(after.count, before.count),
        weight: after.weight,
    }
}

/// Returns the effects on a wall along `normal` at `q` (rad), in descending order of effect on its stiffness.
pub fn sensitivities(
    description: &Description,
    q: &[f64],
    normal: &[f64],
    admissible: Admissible,
    around: &Loop,
) -> Result<Vec<Sensitivity>, Failure> {
    let predicted = |description: &Description| -> Result<Prediction, Failure> {
        let subject = Subject::new(description).map_err(Failure::wrong)?;
        Ok(Prediction { admissible, ..Prediction::new(subject, around.clone()) })
    };
    let unchanged = predicted(description)?;
    let before = results_at(&unchanged, q, normal).ok_or_else(singular_pose)?;
    let place = task_position(&TaskPose::of(&unchanged.subject.device.mechanism, q)?, q);
    let changed = |change: &Change, factor: f64| -> Option<Effect> {
        let mut other = *description;
        change(&mut other, factor);
        let prediction = predicted(&other).ok()?;
        let there = angles_at(&prediction.subject.device, q, &place)?;
        Some(ratios_of(results_at(&prediction, &there, normal)?, before))
    };
    let mut results: Vec<Sensitivity> = changes(description)
        .into_iter()
        .map(|(part, change, both)| Sensitivity {
            part,
            more: changed(&change, 1.0 + CHANGE),
            less: if both { changed(&change, 1.0 - CHANGE) } else { None },
        })
        .collect();
    let most = |one: &Sensitivity| {
        let sides = [one.more, one.less].into_iter().flatten();
        sides.map(|effect| effect.full.ln().abs().max(effect.off.ln().abs())).fold(0.0, f64::max)
    };
    results.sort_by(|a, b| most(b).total_cmp(&most(a)));
    Ok(results)
}

/// A change that improves a quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BestChange {
    /// Name of the changed number.
    pub part: String,
    /// True if the number is made larger, false if smaller.
    pub more: bool,
    /// Effect of the change.
    pub effect: Effect,
}

/// Smallest improvement that is reported, as a ratio.
const WORTHWHILE_RATIO: f64 = 1.01;

/// Returns the change that improves a quantity most, or `None` if no change improves it by 1 %.
#[must_use]
pub fn buys_most(all: &[Sensitivity], of: impl Fn(&Effect) -> f64) -> Option<BestChange> {
    let sides = all.iter().flat_map(|one| {
        let side = |more: bool, effect: Option<Effect>| {
            effect.map(|effect| BestChange { part: one.part.clone(), more, effect })
        };
        [side(true, one.more), side(false, one.less)].into_iter().flatten()
    });
    let most = sides.reduce(|best, other| if of(&other.effect) > of(&best.effect) { other } else { best });
    most.filter(|most| of(&most.effect) >= WORTHWHILE_RATIO)
}
