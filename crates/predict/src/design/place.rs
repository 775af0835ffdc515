//! Directions at a pose, and places in the workspace.

use super::{Stiffest, clearance, lumped, reaching, singular, task_position, within_limits};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_host::error::{Choice, Failure};
use haptic_sim::Random;
use haptic_stability::analysis::map::{MapPoint, Reachable, along, at_holding};
use haptic_stability::analysis::pose::{LEAST_ANALYSED_SINE, Stance, TaskPose, unit_normal};
use haptic_stability::analysis::prediction::Prediction;
use haptic_stability::analysis::range::Range;
use haptic_stability::analysis::several::Member;
use haptic_stability::sweep::Sweep;
use nalgebra::DVector;
use serde::Serialize;

/// A wall somewhere: what it meets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Placed {
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// Tip, m.
    pub position: Vec<f64>,
    /// Unit normal.
    pub normal: Vec<f64>,
    /// Met without the feed-forward, kg.
    pub w_eff: f64,
    /// Met with it, kg.
    pub w_rr: f64,
    /// Sine of the nearest singular angle.
    pub clearance: f64,
    /// The stiffest walls that are predicted stable there, where they were asked for: of a patch in its middle.
    #[serde(flatten)]
    pub walls: Option<Stiffest>,
}

/// The directions that stand out at a pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Directions {
    /// The heaviest: the stiffest wall. It is an axis of the tip's inertia, so nothing couples but, on a redundant arm,
    /// what is held.
    pub stiffest: Placed,
    /// The lightest: the softest wall. It is an axis, too.
    pub softest: Placed,
    /// The place at which the feed-forward multiplies the inertia by most.
    pub feed_forward_buys_most: Placed,
    /// The place at which the feed-forward adds most inertia, kg.
    pub couples_most: Placed,
}

/// Best places for walls.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Places {
    /// Poses that were looked at.
    pub poses: usize,
    /// Whatever the direction: the stiffest wall there is.
    pub stiffest: Placed,
    /// The largest Weff in the lightest direction: the place for a surface that turns, without the feed-forward.
    pub every_direction: Placed,
    /// The place at which the feed-forward multiplies the inertia by most.
    pub feed_forward_buys_most: Placed,
    /// For the normal that was asked for, if any.
    pub along: Option<Along>,
}

/// The best places of a wall of a patch's size with one normal, judged by the inertia that it meets at its worst point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Along {
    /// Half the wall's width, m.
    pub patch: f64,
    /// The middle of the best place without the feed-forward; Weff and Wrr are the least of the patch.
    pub off: Placed,
    /// The same with it.
    pub full: Placed,
    /// The middle of the worst place without it.
    pub worst: Placed,
}

impl Placed {
    /// Predicts its stiffest walls.
    pub fn predict(&mut self, prediction: &Prediction) -> Result<Range, Failure> {
        let range = prediction.range(&self.q, &[Member::new(self.normal.clone(), 1.0)], None, None)?;
        self.walls = Some(Stiffest { off: range.off.top, full: range.full.top });
        Ok(range)
    }
}

fn placed(pose: &TaskPose, q: &[f64], normal: &DVector<f64>) -> Option<Placed> {
    let (w_eff, w_rr) = along(pose, normal)?;
    Some(Placed {
        q: q.to_vec(),
        position: pose.position.clone(),
        normal: normal.iter().take(pose.task).copied().collect(),
        w_eff,
        w_rr,
        clearance: clearance(pose),
        walls: None,
    })
}

/// The directions that stand out at one pose.
pub fn directions(description: &Description, q: &[f64], admissible: Admissible) -> Result<Directions, Failure> {
    let pose = TaskPose::at(description, q)?.regular()?.holding(admissible);
    let spec = description.kind.spec();
    let any = unit_normal(&[1.0, 0.0, 0.0][..spec.task], spec.task, spec.joints)?;
    let point = at_holding(description, q, &any, admissible)?;
    let point: MapPoint = point.ok_or_else(singular)?;
    let along = |normal: &[f64]| -> Result<Placed, Failure> {
        let normal = unit_normal(normal, spec.task, spec.joints)?;
        placed(&pose, q, &normal).ok_or_else(singular)
    };
    let last = point.eigenvectors.len() - 1;
    Ok(Directions {
        stiffest: along(&point.eigenvectors[last])?,
        softest: along(&point.eigenvectors[0])?,
        feed_forward_buys_most: along(&point.worst_ratio.normal)?,
        couples_most: along(&point.worst_coupling.normal)?,
    })
}

/// The value of a pose, which the search makes as large as it can, and the wall that has it.
type Sought<'a> = &'a (dyn Fn(&[f64]) -> Option<(f64, Placed)> + Sync);

/// The search goes on from at most so many poses of the grid, so far (rad) from each other. The value is steep along
/// the edge of what is allowed, so a pose that looks poor on a coarse grid may be next to the best one: with 6 of them
/// a grid of 300 poses found 1.67 kg on coupled-five-bar, and one of 1000 1.96 kg.
const APART: f64 = 0.4;
const STARTS: usize = 60;
/// So many of the places that its coarse steps end at are refined with fine steps.
const ENDS: usize = 4;

/// The best of some poses that are not near each other.
fn starts(poses: &[Vec<f64>], sought: Sought<'_>) -> Vec<Vec<f64>> {
    let mut valued: Vec<(f64, &Vec<f64>)> = poses.iter().filter_map(|q| Some((sought(q)?.0, q))).collect();
    // Stable: equals stay in the order of the grid.
    valued.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut found: Vec<Vec<f64>> = Vec::new();
    for (_, q) in valued {
        let far = |other: &Vec<f64>| q.iter().zip(other).any(|(a, b)| (a - b).abs() > APART);
        if found.len() < STARTS && found.iter().all(far) {
            found.push(q.clone());
        }
    }
    found
}

/// The best that is found from some poses on: in coarse steps from all of them, in fine ones from where those end best.
fn best(starts: &[Vec<f64>], allowed: &dyn Fn(&[f64]) -> bool, sought: Sought<'_>) -> Option<(f64, Placed)> {
    let mut ends: Vec<(f64, Placed)> =
        starts.iter().filter_map(|start| climbed(start, COARSE, allowed, sought)).collect();
    // Stable: equals stay in their order.
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    let found = ends.iter().take(ENDS).filter_map(|(_, end)| climbed(&end.q, FINE, allowed, sought));
    found.reduce(|best, other| if other.0 > best.0 { other } else { best })
}

/// The steps of a search between the poses of a grid.
#[derive(Clone, Copy)]
struct Steps {
    /// The first, rad, and the last.
    from: f64,
    to: f64,
    /// Directions that are tried besides those of the compass: the best often lies on the edge of what is allowed, and
    /// a compass does not slide along it.
    besides: usize,
}

const COARSE: Steps = Steps { from: 0.1, to: 0.01, besides: 30 };
/// With so many it comes within a hundredth of the best (tool/tests/deep/tune/design.rs).
const FINE: Steps = Steps { from: 0.05, to: 1e-5, besides: 120 };

/// A compass search whose steps halve.
fn climbed(start: &[f64], steps: Steps, allowed: &dyn Fn(&[f64]) -> bool, sought: Sought<'_>) -> Option<(f64, Placed)> {
    let (mut value, mut found) = sought(start)?;
    let mut q = start.to_vec();
    let mut step = steps.from;
    // The same numbers every time.
    let mut random = Random::new(1);
    let compass = 3_usize.pow(q.len() as u32);
    while step > steps.to {
        let mut better = None;
        for direction in 0..compass + steps.besides {
            let mut towards = |joint: usize| match direction < compass {
                true => ((direction / 3_usize.pow(joint as u32)) % 3) as f64 - 1.0,
                false => random.between(-1.0, 1.0),
            };
            let next: Vec<f64> = q.iter().enumerate().map(|(joint, angle)| angle + step * towards(joint)).collect();
            if !allowed(&next) {
                continue;
            }
            if let Some((other, placed)) = sought(&next).filter(|(other, _)| *other > value) {
                (value, found, better) = (other, placed, Some(next));
            }
        }
        match better {
            Some(next) => q = next,
            None => step *= 0.5,
        }
    }
    Some((value, found))
}

/// Points of a wall's patch beside its middle: at its edge, all around in space.
fn edge(normal: &DVector<f64>, task: usize, patch: f64) -> Vec<DVector<f64>> {
    if task < 2 || patch <= 0.0 {
        return Vec::new();
    }
    let across = crate::measure::complement(&normal.rows(0, task).into_owned());
    let around = if task == 2 { 2 } else { 8 };
    (0..around)
        .map(|i| {
            let (sine, cosine) = (std::f64::consts::TAU * f64::from(i) / f64::from(around)).sin_cos();
            let mut point = &across[0] * (patch * cosine);
            if let Some(second) = across.get(1) {
                point += second * (patch * sine);
            }
            point.resize_vertically(normal.len(), 0.0)
        })
        .collect()
}

/// Best places for walls in the workspace, at poses at least as clear of singularities as the sine `clear`. `points`
/// poses are looked at before the search goes on between them.
pub fn places(
    description: &Description,
    normal: Option<&[f64]>,
    patch: f64,
    clear: f64,
    points: usize,
    admissible: Admissible,
    sweep: &Sweep,
) -> Result<Places, Failure> {
    let spec = description.kind.spec();
    let device: Device<f64> = lumped(description)?;
    let per_joint = (points as f64).powf(1.0 / spec.joints as f64).round().max(2.0) as usize;
    let reachable = Reachable::of(&device, per_joint, None)?;
    let all: Vec<Vec<f64>> = reachable.indices().map(|index| reachable.angles(index)).collect();
    let least = clear.max(LEAST_ANALYSED_SINE);
    let is_clear = |q: &[f64]| {
        within_limits(&device, q) && Stance::of(&device.mechanism, q).is_ok_and(|stance| stance.is_clear(least))
    };
    let at = |q: &[f64]| -> Option<TaskPose> {
        if is_clear(q) { Some(TaskPose::of(&device.mechanism, q).ok()?.holding(admissible)) } else { None }
    };
    let allowed = |q: &[f64]| is_clear(q) && reachable.walkable(q);
    let poses: Vec<Vec<f64>> = all.into_iter().filter(|q| is_clear(q)).collect();
    if poses.is_empty() {
        return Err(Failure::impossible(format!("no pose is as clear of singularities as a sine of {clear}"))
            .remedy("ask for less")
            .choose(Choice::Clearance));
    }
    let point = |q: &[f64]| {
        let any = unit_normal(&[1.0, 0.0, 0.0][..spec.task], spec.task, spec.joints).ok()?;
        at_holding(description, q, &any, admissible).ok().flatten()
    };
    let wall = |q: &[f64], normal: &[f64]| {
        let normal = unit_normal(normal, spec.task, spec.joints).ok()?;
        placed(&at(q)?, q, &normal)
    };
    let heaviest = |q: &[f64]| {
        let point = point(q)?;
        let last = point.eigenvalues.len() - 1;
        Some((point.eigenvalues[last], wall(q, &point.eigenvectors[last])?))
    };
    let lightest = |q: &[f64]| {
        let point = point(q)?;
        Some((point.eigenvalues[0], wall(q, &point.eigenvectors[0])?))
    };
    let buys = |q: &[f64]| {
        let point = point(q)?;
        Some((point.worst_ratio.value, wall(q, &point.worst_ratio.normal)?))
    };
    let along = normal.map(|normal| unit_normal(normal, spec.task, spec.joints)).transpose()?;
    let edge = along.as_ref().map_or(Vec::new(), |normal| edge(normal, spec.task, patch));
    // The least that a wall meets on its patch; none where it is not all within reach.
    let least = |q: &[f64]| -> Option<Placed> {
        let normal = along.as_ref()?;
        let pose = at(q)?;
        let mut found = placed(&pose, q, normal)?;
        let middle = task_position(&pose, q);
        for aside in &edge {
            let there = reaching(&device, q, &(&middle + aside))?;
            if !reachable.walkable(&there) {
                return None;
            }
            let other = placed(&at(&there)?, &there, normal)?;
            found.w_eff = found.w_eff.min(other.w_eff);
            found.w_rr = found.w_rr.min(other.w_rr);
            found.clearance = found.clearance.min(other.clearance);
        }
        Some(found)
    };
    let off = |q: &[f64]| least(q).map(|found| (found.w_eff, found));
    let full = |q: &[f64]| least(q).map(|found| (found.w_rr, found));
    let worst = |q: &[f64]| least(q).map(|found| (-found.w_eff, found));

    let mut jobs: Vec<Sought<'_>> = vec![&heaviest, &lightest, &buys];
    if along.is_some() {
        jobs.extend([&off as Sought<'_>, &full, &worst]);
    }
    let indices: Vec<usize> = (0..jobs.len()).collect();
    // Only the pose is kept; the numbers come from it.
    let first = sweep.map("places", &indices, |job| {
        Ok(best(&starts(&poses, jobs[*job]), &allowed, jobs[*job]).map(|(_, placed)| placed.q))
    })?;
    // A search that begins where another one ended may find more than from its own start.
    let ends: Vec<Vec<f64>> = first.into_iter().flatten().collect();
    let found = sweep.map("between them", &indices, |job| {
        let sought = jobs[*job];
        let better = ends.iter().filter_map(|q| Some((sought(q)?.0, q)));
        let start = better.reduce(|best, other| if other.0 > best.0 { other } else { best });
        Ok(start.and_then(|(_, start)| climbed(start, FINE, &allowed, sought)).map(|(_, placed)| placed.q))
    })?;
    let again = |index: usize| -> Result<Placed, Failure> {
        let nowhere = || Failure::impossible("the wall fits nowhere").remedy("make it smaller").choose(Choice::Patch);
        let q = found[index].clone().ok_or_else(nowhere)?;
        jobs[index](&q).map(|(_, placed)| placed).ok_or_else(nowhere)
    };
    let along = match along {
        Some(_) => Some(Along { patch, off: again(3)?, full: again(4)?, worst: again(5)? }),
        None => None,
    };
    Ok(Places {
        poses: poses.len(),
        stiffest: again(0)?,
        every_direction: again(1)?,
        feed_forward_buys_most: again(2)?,
        along,
    })
}
