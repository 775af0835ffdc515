//! The effect of each number of a device on one wall: the same tip position, with one of them a tenth larger or
//! smaller.

use super::{reaching, singular, task_position};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::{Description, Joint};
use haptic_host::error::Failure;
use haptic_stability::analysis::control_loop::{Loop, Mode};
use haptic_stability::analysis::map::along;
use haptic_stability::analysis::pose::{TaskPose, unit_normal};
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::boundary_of;
use serde::Serialize;

/// The share by which a number is made larger and smaller.
pub const CHANGE: f64 = 0.1;

/// The ratios of a changed device's results for the wall to those of the original.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Weff, which is also what is felt in free motion.
    pub w_eff: f64,
    /// Wrr.
    pub w_rr: f64,
    /// The stiffest wall that is predicted stable without the feed-forward.
    pub off: f64,
    /// The stiffest wall with it.
    pub full: f64,
    /// The force of the motors along the normal; none without motors.
    pub force: Option<f64>,
    /// The motion of the tip in one encoder count; `None` without encoders.
    pub count: Option<f64>,
    /// The largest joint torque that holds the device's weight, N m.
    pub weight: f64,
}

/// One number of the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Which, in words.
    pub part: String,
    /// With a tenth more of it (of a counterweight: with one); none where the tip does not get to the same place.
    pub more: Option<Effect>,
    /// With a tenth less of it; `None` also for a counterweight, which the device does not have yet.
    pub less: Option<Effect>,
}

/// A change of a device.
type Change = Box<dyn Fn(&mut Description, f64)>;

/// The links that a length of a mechanism's geometry belongs to, by its place there.
fn links_of(kind: Kind, entry: usize) -> &'static [usize] {
    let of_each: &[&[usize]] = match kind {
        Kind::Paddle => &[],
        Kind::FiveBar | Kind::FiveBarTurret => &[&[], &[0], &[1], &[2], &[3]],
        // The coupler is as long as the upper arm.
        Kind::Parallelogram => &[&[0, 3], &[1], &[2]],
        Kind::Serial3r => &[&[0], &[1], &[2]],
    };
    of_each.get(entry).copied().unwrap_or_default()
}

/// A counterweight of a tenth of the link's mass, as far behind its joint as the centre of mass is before it.
fn counterweight(description: &mut Description, link: usize) {
    let link = &mut description.links[link];
    let (added, place) = (CHANGE * link.mass, -link.com);
    let mass = link.mass + added;
    let com = (link.mass * link.com + added * place) / mass;
    let moved = link.mass * (link.com - com).powi(2) + added * (place - com).powi(2);
    link.inertia += moved;
    link.inertia_transverse += moved;
    (link.mass, link.com) = (mass, com);
}

/// Scales the inertia on the motor's side: all of the joint's, where its transmission does not say less.
fn scale_motor(joint: &mut Joint, factor: f64) {
    let motor = joint.transmission.map_or(joint.inertia, |transmission| transmission.motor_inertia);
    joint.inertia += (factor - 1.0) * motor;
    if let Some(transmission) = &mut joint.transmission {
        transmission.motor_inertia *= factor;
    }
}

/// Everything that is changed, one after the other.
fn changes(description: &Description) -> Vec<(String, Change, bool)> {
    let spec = description.kind.spec();
    let mut all: Vec<(String, Change, bool)> = Vec::new();
    let mut entry = 0;
    for (key, count) in spec.geometry {
        for i in 0..*count {
            let at = entry + i;
            if *key != "assembly" {
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
        add("centre of mass", link.mass > 0.0 && link.com != 0.0, Box::new(move |d, factor| d.links[i].com *= factor));
        add(
            "inertia",
            link.inertia > 0.0,
            Box::new(move |d, factor| {
                d.links[i].inertia *= factor;
                d.links[i].inertia_axial *= factor;
                d.links[i].inertia_transverse *= factor;
            }),
        );
        if link.mass > 0.0 && link.com != 0.0 {
            all.push((format!("counterweight on {name}"), Box::new(move |d, _| counterweight(d, i)), false));
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

/// Dampings at which the boundary is looked at, at even shares of where it ends: the same shares before and after a
/// change.
const DAMPINGS: usize = 40;

/// The quantities that matter at a pose of a device.
fn worth(prediction: &Prediction, q: &[f64], normal: &[f64]) -> Option<Effect> {
    let (device, admissible) = (&prediction.subject.device, prediction.admissible);
    let seen = prediction.seen(q, normal).ok()?;
    let stiffest = |mode| {
        let shares = |end: f64| (0..DAMPINGS).map(|i| end * (i as f64 + 0.5) / DAMPINGS as f64).collect();
        let boundary = boundary_of(&seen, &seen, &prediction.around, mode, shares).ok()?;
        Some(boundary.iter().map(|point| point.kp).fold(0.0, f64::max))
    };
    let pose = TaskPose::of(&device.mechanism, q).ok()?.regular().ok()?.holding(admissible);
    let n = unit_normal(normal, pose.task, q.len()).ok()?;
    let (w_eff, w_rr) = along(&pose, &n)?;
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

fn over(found: Effect, before: Effect) -> Effect {
    let ratio = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a / b);
    Effect {
        w_eff: found.w_eff / before.w_eff,
        w_rr: found.w_rr / before.w_rr,
        off: found.off / before.off,
        full: found.full / before.full,
        force: ratio(found.force, before.force),
        count: ratio(found.count, before.count),
        weight: found.weight,
    }
}

/// The effect of every number on a wall along `normal` where the tip is at `q` (rad), in this loop; those of most effect
/// on the stiffest wall first.
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
    let as_it_is = predicted(description)?;
    let before = worth(&as_it_is, q, normal).ok_or_else(singular)?;
    let place = task_position(&TaskPose::of(&as_it_is.subject.device.mechanism, q)?, q);
    let changed = |change: &Change, factor: f64| -> Option<Effect> {
        let mut other = *description;
        change(&mut other, factor);
        let prediction = predicted(&other).ok()?;
        let there = reaching(&prediction.subject.device, q, &place)?;
        Some(over(worth(&prediction, &there, normal)?, before))
    };
    let mut found: Vec<Sensitivity> = changes(description)
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
    found.sort_by(|a, b| most(b).total_cmp(&most(a)));
    Ok(found)
}

/// A change that buys something.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Buys {
    /// Which number.
    pub part: String,
    /// True if the number is made larger, false if smaller.
    pub more: bool,
    /// The effect of the change.
    pub effect: Effect,
}

/// The smallest gain by a change that is reported.
const WORTHWHILE_RATIO: f64 = 1.01;

/// The change that buys most of something, and a hundredth of it at least.
#[must_use]
pub fn buys_most(all: &[Sensitivity], of: impl Fn(&Effect) -> f64) -> Option<Buys> {
    let sides = all.iter().flat_map(|one| {
        let side =
            |more: bool, effect: Option<Effect>| effect.map(|effect| Buys { part: one.part.clone(), more, effect });
        [side(true, one.more), side(false, one.less)].into_iter().flatten()
    });
    let most = sides.reduce(|best, other| if of(&other.effect) > of(&best.effect) { other } else { best });
    most.filter(|most| of(&most.effect) >= WORTHWHILE_RATIO)
}
