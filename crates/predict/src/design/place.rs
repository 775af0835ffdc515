//! Best directions at a pose, and best places in the workspace.

use super::{StiffestWalls, angles_at, build_device, clearance, singular_pose, task_position, within_limits};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_host::error::{Choice, Failure};
use haptic_sim::Random;
use haptic_stability::analysis::map::{MapPoint, Reachable, effective_inertias, map_point_at};
use haptic_stability::analysis::pose::{LEAST_ANALYSED_SINE, Stance, TaskPose, unit_normal};
use haptic_stability::analysis::prediction::Prediction;
use haptic_stability::analysis::range::Range;
use haptic_stability::analysis::several::Member;
use haptic_stability::sweep::Sweep;
use nalgebra::DVector;
use serde::Serialize;

/// A wall at a pose, with its effective inertia.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WallPlace {
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// Position of the tip, m.
    pub position: Vec<f64>,
    /// Unit normal of the wall.
    pub normal: Vec<f64>,
    /// Effective inertia without the feed-forward, kg.
    pub w_eff: f64,
    /// Effective inertia with the feed-forward, kg.
    pub w_rr: f64,
    /// Sine of the nearest singular angle, on a patch the smallest.
    pub clearance: f64,
    /// The stiffest walls that are predicted stable at this place, or in the middle of a patch, if requested.
    #[serde(flatten)]
    pub walls: Option<StiffestWalls>,
}

/// The most notable directions at a pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Directions {
    /// The direction of the largest inertia, an axis of the tip's inertia, with the stiffest wall.
    pub stiffest: WallPlace,
    /// The direction of the smallest inertia, another axis of the tip's inertia, with the softest wall.
    pub softest: WallPlace,
    /// The direction in which the feed-forward increases the inertia by the largest factor.
    pub feed_forward_buys_most: WallPlace,
    /// The direction in which the feed-forward adds the most inertia, kg.
    pub couples_most: WallPlace,
}

/// The best places for walls.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Places {
    /// Number of poses that were searched.
    pub poses: usize,
    /// Place and direction of the stiffest wall.
    pub stiffest: WallPlace,
    /// Place with the largest Weff in its lightest direction, for surfaces of any direction.
    pub every_direction: WallPlace,
    /// Place at which the feed-forward increases the inertia by the largest factor.
    pub feed_forward_buys_most: WallPlace,
    /// Places for the requested normal; `None` if none was requested.
    pub along: Option<PatchPlaces>,
}

/// Places for a wall patch with one normal, rated by the smallest effective inertia on the patch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatchPlaces {
    /// Half the width of the patch, m.
    pub patch: f64,
    /// Middle of the best place without the feed-forward. Weff and Wrr are the smallest on the patch.
    pub off: WallPlace,
    /// Middle of the best place with the feed-forward. Weff and Wrr are the smallest on the patch.
    pub full: WallPlace,
    /// Middle of the worst place without the feed-forward.
    pub worst: WallPlace,
}

impl WallPlace {
    /// Predicts the stiffest walls at this place.
    pub fn predict(&mut self, prediction: &Prediction) -> Result<Range, Failure> {
        let range = prediction.range(&self.q, &[Member::new(self.normal.clone(), 1.0)], None, None)?;
        self.walls = Some(StiffestWalls { off: range.off.top, full: range.full.top });
        Ok(range)
    }
}

fn place_wall(pose: &TaskPose, q: &[f64], normal: &DVector<f64>) -> Option<WallPlace> {
    let (w_eff, w_rr) = effective_inertias(pose, normal)?;
    Some(WallPlace {
        q: q.to_vec(),
        position: pose.position.clone(),
        normal: normal.iter().take(pose.task).copied().collect(),
        w_eff,
        w_rr,
        clearance: clearance(pose),
        walls: None,
    })
}

/// Returns the most notable directions at a pose.
pub fn directions(description: &Description, q: &[f64], admissible: Admissible) -> Result<Directions, Failure> {
    let pose = TaskPose::at(description, q)?.regular()?.holding(admissible);
    let spec = description.kind.spec();
    let any = unit_normal(&[1.0, 0.0, 0.0][..spec.task], spec.task, spec.joints)?;
    let point = map_point_at(description, q, &any, admissible)?;
    let point: MapPoint = point.ok_or_else(singular_pose)?;
    let along = |normal: &[f64]| -> Result<WallPlace, Failure> {
        let normal = unit_normal(normal, spec.task, spec.joints)?;
        place_wall(&pose, q, &normal).ok_or_else(singular_pose)
    };
    let last = point.eigenvectors.len() - 1;
    Ok(Directions {
        stiffest: along(&point.eigenvectors[last])?,
        softest: along(&point.eigenvectors[0])?,
        feed_forward_buys_most: along(&point.worst_ratio.normal)?,
        couples_most: along(&point.worst_coupling.normal)?,
    })
}

/// Function that rates a pose and returns the rating with its wall. The search maximises the rating.
type PoseRating<'a> = &'a (dyn Fn(&[f64]) -> Option<(f64, WallPlace)> + Sync);

/// Smallest distance between the grid poses from which the search starts, rad.
const START_SPACING: f64 = 0.4;
/// Maximum number of grid poses from which the search starts. The rating is steep along the edge of the allowed poses,
/// so a pose with a poor rating on a coarse grid may be next to the best pose. With 6 starts a grid of 300 poses found
/// 1.67 kg on coupled-five-bar, and a grid of 1000 found 1.96 kg.
const MAX_STARTS: usize = 60;
/// Number of end poses of the coarse search from which the fine search starts.
const REFINED_ENDS: usize = 4;

/// Returns the poses with the highest ratings that are not near each other.
fn search_starts(poses: &[Vec<f64>], rating: PoseRating<'_>) -> Vec<Vec<f64>> {
    let mut valued: Vec<(f64, &Vec<f64>)> = poses.iter().filter_map(|q| Some((rating(q)?.0, q))).collect();
    // The sort is stable, so poses with equal ratings keep the order of the grid.
    valued.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut result: Vec<Vec<f64>> = Vec::new();
    for (_, q) in valued {
        let is_far = |other: &Vec<f64>| q.iter().zip(other).any(|(a, b)| (a - b).abs() > START_SPACING);
        if result.len() < MAX_STARTS && result.iter().all(is_far) {
            result.push(q.clone());
        }
    }
    result
}

/// Searches in coarse steps from all starts, then in fine steps from the best end poses. Returns the best result.
fn search_best(
    starts: &[Vec<f64>],
    allowed: &dyn Fn(&[f64]) -> bool,
    rating: PoseRating<'_>,
) -> Option<(f64, WallPlace)> {
    let mut ends: Vec<(f64, WallPlace)> =
        starts.iter().filter_map(|start| climb(start, COARSE_STEPS, allowed, rating)).collect();
    // The sort is stable, so results with equal ratings keep their order.
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    let result = ends.iter().take(REFINED_ENDS).filter_map(|(_, end)| climb(&end.q, FINE_STEPS, allowed, rating));
    result.reduce(|best, other| if other.0 > best.0 { other } else { best })
}

#[derive(Clone, Copy)]
struct Steps {
    /// First step, rad.
    first: f64,
    /// Last step, rad.
    last: f64,
    /// Number of random directions in addition to the compass directions, which do not follow the edge of the allowed
    /// poses, where the best pose often lies.
    random_directions: usize,
}

const COARSE_STEPS: Steps = Steps { first: 0.1, last: 0.01, random_directions: 30 };
/// With 120 random directions the search reaches the best rating within 1 % (tool/tests/deep/tune/design.rs).
const FINE_STEPS: Steps = Steps { first: 0.05, last: 1e-5, random_directions: 120 };

/// Climbs along compass and random directions with steps that halve.
fn climb(
    start: &[f64],
    steps: Steps,
    allowed: &dyn Fn(&[f64]) -> bool,
    rating: PoseRating<'_>,
) -> Option<(f64, WallPlace)> {
    let (mut value, mut result) = rating(start)?;
    let mut q = start.to_vec();
    let mut step = steps.first;
    // The seed is fixed so that results are reproducible.
    let mut random = Random::new(1);
    let compass = 3_usize.pow(q.len() as u32);
    while step > steps.last {
        let mut better = None;
        for direction in 0..compass + steps.random_directions {
            let mut towards = |joint: usize| match direction < compass {
                true => ((direction / 3_usize.pow(joint as u32)) % 3) as f64 - 1.0,
                false => random.between(-1.0, 1.0),
            };
            let next: Vec<f64> = q.iter().enumerate().map(|(joint, angle)| angle + step * towards(joint)).collect();
            if !allowed(&next) {
                continue;
            }
            if let Some((other, placed)) = rating(&next).filter(|(other, _)| *other > value) {
                (value, result, better) = (other, placed, Some(next));
            }
        }
        match better {
            Some(next) => q = next,
            None => step *= 0.5,
        }
    }
    Some((value, result))
}

/// Returns points on the edge of a wall patch, relative to its middle.
fn patch_edge(normal: &DVector<f64>, task: usize, patch: f64) -> Vec<DVector<f64>> {
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

/// Searches the poses whose singular sine is at least `min_sine`, from about `points` grid poses.
pub fn places(
    description: &Description,
    normal: Option<&[f64]>,
    patch: f64,
    min_sine: f64,
    points: usize,
    admissible: Admissible,
    sweep: &Sweep,
) -> Result<Places, Failure> {
    let spec = description.kind.spec();
    let device: Device<f64> = build_device(description)?;
    let per_joint = (points as f64).powf(1.0 / spec.joints as f64).round().max(2.0) as usize;
    let reachable = Reachable::of(&device, per_joint, None)?;
    let all: Vec<Vec<f64>> = reachable.indices().map(|index| reachable.angles(index)).collect();
    let least = min_sine.max(LEAST_ANALYSED_SINE);
    let is_clear = |q: &[f64]| {
        within_limits(&device, q) && Stance::of(&device.mechanism, q).is_ok_and(|stance| stance.is_clear(least))
    };
    let at = |q: &[f64]| -> Option<TaskPose> {
        if is_clear(q) { Some(TaskPose::of(&device.mechanism, q).ok()?.holding(admissible)) } else { None }
    };
    let allowed = |q: &[f64]| is_clear(q) && reachable.is_on_reached_side(q);
    let poses: Vec<Vec<f64>> = all.into_iter().filter(|q| is_clear(q)).collect();
    if poses.is_empty() {
        return Err(Failure::impossible(format!("every pose is nearer to a singularity than a sine of {min_sine}"))
            .remedy("choose a smaller sine")
            .choose(Choice::Clearance));
    }
    let point = |q: &[f64]| {
        let any = unit_normal(&[1.0, 0.0, 0.0][..spec.task], spec.task, spec.joints).ok()?;
        map_point_at(description, q, &any, admissible).ok().flatten()
    };
    let wall = |q: &[f64], normal: &[f64]| {
        let normal = unit_normal(normal, spec.task, spec.joints).ok()?;
        place_wall(&at(q)?, q, &normal)
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
    let multiplied = |q: &[f64]| {
        let point = point(q)?;
        Some((point.worst_ratio.value, wall(q, &point.worst_ratio.normal)?))
    };
    let along = normal.map(|normal| unit_normal(normal, spec.task, spec.joints)).transpose()?;
    let edge = along.as_ref().map_or(Vec::new(), |normal| patch_edge(normal, spec.task, patch));
    // Computes the smallest inertia on the patch; `None` if a part of the patch is out of reach.
    let least = |q: &[f64]| -> Option<WallPlace> {
        let normal = along.as_ref()?;
        let pose = at(q)?;
        let mut result = place_wall(&pose, q, normal)?;
        let middle = task_position(&pose, q);
        for aside in &edge {
            let there = angles_at(&device, q, &(&middle + aside))?;
            if !reachable.is_on_reached_side(&there) {
                return None;
            }
            let other = place_wall(&at(&there)?, &there, normal)?;
            result.w_eff = result.w_eff.min(other.w_eff);
            result.w_rr = result.w_rr.min(other.w_rr);
            result.clearance = result.clearance.min(other.clearance);
        }
        Some(result)
    };
    let off = |q: &[f64]| least(q).map(|result| (result.w_eff, result));
    let full = |q: &[f64]| least(q).map(|result| (result.w_rr, result));
    let worst = |q: &[f64]| least(q).map(|result| (-result.w_eff, result));

    let mut jobs: Vec<PoseRating<'_>> = vec![&heaviest, &lightest, &multiplied];
    if along.is_some() {
        jobs.extend([&off as PoseRating<'_>, &full, &worst]);
    }
    let indices: Vec<usize> = (0..jobs.len()).collect();
    // The sweep stores only the pose because the other numbers follow from it.
    let first = sweep.map("places", &indices, |job| {
        Ok(search_best(&search_starts(&poses, jobs[*job]), &allowed, jobs[*job]).map(|(_, placed)| placed.q))
    })?;
    // The end pose of another job may be a better start than this job's own.
    let ends: Vec<Vec<f64>> = first.into_iter().flatten().collect();
    let refined = sweep.map("places between grid poses", &indices, |job| {
        let rating = jobs[*job];
        let better = ends.iter().filter_map(|q| Some((rating(q)?.0, q)));
        let start = better.reduce(|best, other| if other.0 > best.0 { other } else { best });
        Ok(start.and_then(|(_, start)| climb(start, FINE_STEPS, &allowed, rating)).map(|(_, placed)| placed.q))
    })?;
    let final_place = |index: usize| -> Result<WallPlace, Failure> {
        let nowhere =
            || Failure::impossible("the wall fits nowhere").remedy("choose a smaller wall").choose(Choice::Patch);
        let q = refined[index].clone().ok_or_else(nowhere)?;
        jobs[index](&q).map(|(_, placed)| placed).ok_or_else(nowhere)
    };
    let along = match along {
        Some(_) => Some(PatchPlaces { patch, off: final_place(3)?, full: final_place(4)?, worst: final_place(5)? }),
        None => None,
    };
    Ok(Places {
        poses: poses.len(),
        stiffest: final_place(0)?,
        every_direction: final_place(1)?,
        feed_forward_buys_most: final_place(2)?,
        along,
    })
}
