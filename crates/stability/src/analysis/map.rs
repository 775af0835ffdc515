//! Inertia over the workspace: effective inertias along one normal, worst normals, and axes of Λ.
//!
//! The poses are those that the device reaches from home without crossing a singularity. The grid over the joints'
//! ranges is flooded from home through regular poses with the same orientation of J. Each tip position therefore
//! appears once, in the device's own working mode.
//!
//! With a full task (J square) both worst normals are closed forms in the eigenvalues of Λ (docs/model.md section 2).
//! The tip of a redundant arm has two different matrices, the block of Λ and the inverse of the block of the mobility.
//! Its worst normals are searched, and its axes are those of the tip's inertia (J M⁻¹ Jᵀ)⁻¹.

use super::pose::{PoseError, Stance, TaskPose, unit_normal};
use crate::model::Condition;
use crate::sweep::Sweep;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::{Device, Joint};
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_host::error::Failure;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Smallest sine of the singular angle at which flooding accepts a pose.
const WALKABLE_SINE: f64 = 0.08;
/// Longest step while flooding, rad. The excluded band around a singularity is wider ([`WALKABLE_SINE`] on either
/// side), so no step crosses one, even where two meet and J's determinant has the same sign behind both.
const MAX_FLOOD_STEP_RAD: f64 = 0.1;

/// A wall normal and the largest value that it causes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorstNormal {
    /// Unit normal in the task frame.
    pub normal: Vec<f64>,
    /// Wrr/Weff for the worst ratio, Wrr - Weff in kg for the worst coupling.
    pub value: f64,
}

/// A pose of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapPoint {
    /// Joint angles, rad.
    pub q: Vec<f64>,
    /// Position of the tip, m.
    pub position: Vec<f64>,
    /// Effective inertia along the normal, kg.
    pub w_eff: f64,
    /// Inertia along the normal with the feed-forward, kg.
    pub w_rr: f64,
    /// Wrr - Weff, kg.
    pub coupling: f64,
    /// Condition numbers of the tip Jacobian and of M.
    pub condition: Condition,
    /// Normal with the largest Wrr/Weff at this pose.
    pub worst_ratio: WorstNormal,
    /// Normal with the largest Wrr - Weff at this pose.
    pub worst_coupling: WorstNormal,
    /// Eigenvalues of the tip's operational-space inertia in ascending order, kg.
    pub eigenvalues: Vec<f64>,
    /// Unit eigenvectors in the order of the eigenvalues.
    pub eigenvectors: Vec<Vec<f64>>,
}

/// The joint or coordinate that stays fixed while the other joints sweep a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixedCoordinate {
    /// Joint with this index at this angle, rad.
    Joint(usize, f64),
    /// Orientation φ of the redundant arm, rad. Its last joint follows, so each tip position appears once.
    Orientation(f64),
}

/// A grid over the joints with the poses that the device can reach.
#[derive(Clone, Debug)]
pub struct Reachable {
    /// Grid angles of each joint, rad; one angle for a joint that does not sweep.
    pub axes: Vec<Vec<f64>>,
    /// True for joints whose grid closes on itself.
    pub wraps: Vec<bool>,
    /// True for reached poses, by flat index; joint 0 varies slowest.
    reached: Vec<bool>,
    held: Option<FixedCoordinate>,
    device: Device<f64>,
    /// Side of the singularities on which the reached poses lie; `None` if no pose was reached.
    side: Option<bool>,
}

/// Evaluates one pose of a device whose feed-forward holds `admissible`. Returns `None` if the pose is singular.
pub fn map_point_at(
    description: &Description,
    q: &[f64],
    normal: &DVector<f64>,
    admissible: Admissible,
) -> Result<Option<MapPoint>, PoseError> {
    Ok(evaluate(&TaskPose::at(description, q)?.holding(admissible), q, normal))
}

/// Returns Weff and Wrr (kg) along a normal of N entries, or `None` if a singularity makes them infinite.
pub fn effective_inertias(pose: &TaskPose, normal: &DVector<f64>) -> Option<(f64, f64)> {
    let force = pose.jacobian.tr_mul(normal);
    let w_eff = 1.0 / force.dot(&pose.mass.clone().cholesky()?.solve(&force));
    let w_rr = normal.dot(&(&pose.operational * normal));
    (w_eff.is_finite() && w_rr.is_finite()).then_some((w_eff, w_rr))
}

fn evaluate(pose: &TaskPose, q: &[f64], normal: &DVector<f64>) -> Option<MapPoint> {
    let d = pose.task;
    let mobility = &pose.jacobian * pose.mass.clone().cholesky()?.solve(&pose.jacobian.transpose());
    let held = pose.operational.view((0, 0), (d, d)).into_owned();
    let free = mobility.view((0, 0), (d, d)).into_owned();
    let quadratic = |m: &DMatrix<f64>, n: &DVector<f64>| n.dot(&(m * n));
    let (w_eff, w_rr) = effective_inertias(pose, normal)?;

    let axes = SymmetricEigen::new(free.clone().cholesky()?.inverse());
    let mut order: Vec<usize> = (0..d).collect();
    order.sort_by(|&a, &b| axes.eigenvalues[a].total_cmp(&axes.eigenvalues[b]));
    let eigenvalues: Vec<f64> = order.iter().map(|&k| axes.eigenvalues[k]).collect();
    let eigenvectors: Vec<DVector<f64>> = order.iter().map(|&k| axes.eigenvectors.column(k).into_owned()).collect();

    let redundant = pose.jacobian.nrows() > d;
    let (worst_ratio, worst_coupling) = if redundant {
        let ratio = |n: &DVector<f64>| quadratic(&held, n) * quadratic(&free, n);
        let coupling = |n: &DVector<f64>| quadratic(&held, n) - 1.0 / quadratic(&free, n);
        (search_worst(ratio), search_worst(coupling))
    } else {
        closed_form(&eigenvalues, &eigenvectors)
    };
    let condition = |m: &DMatrix<f64>| {
        let values = m.singular_values();
        values.max() / values.min()
    };
    let point = MapPoint {
        q: q.to_vec(),
        position: pose.position.clone(),
        w_eff,
        w_rr,
        // The difference is negative only by rounding.
        coupling: (w_rr - w_eff).max(0.0),
        condition: Condition {
            jacobian: condition(&pose.jacobian.rows(0, d).into_owned()),
            mass: condition(&pose.mass),
        },
        worst_ratio,
        worst_coupling,
        eigenvalues,
        eigenvectors: eigenvectors.iter().map(|v| v.iter().copied().collect()).collect(),
    };
    let numbers = [point.w_eff, point.w_rr, point.condition.jacobian, point.condition.mass];
    numbers.iter().all(|v| v.is_finite()).then_some(point)
}

/// Returns the normals of the largest ratio and of the largest coupling. Both lie in the plane of the eigenvectors of
/// the smallest and the largest eigenvalue (docs/model.md section 2).
fn closed_form(eigenvalues: &[f64], eigenvectors: &[DVector<f64>]) -> (WorstNormal, WorstNormal) {
    let (low, high) = (eigenvalues[0], eigenvalues[eigenvalues.len() - 1]);
    let (e_low, e_high) = (&eigenvectors[0], &eigenvectors[eigenvectors.len() - 1]);
    if eigenvalues.len() == 1 {
        let only = |value| WorstNormal { normal: e_low.iter().copied().collect(), value };
        return (only(1.0), only(0.0));
    }
    let mixed = |on_low: f64, value: f64| {
        let n = e_low * on_low.sqrt() + e_high * (1.0 - on_low).sqrt();
        WorstNormal { normal: n.iter().copied().collect(), value }
    };
    let (root_low, root_high) = (low.sqrt(), high.sqrt());
    (
        mixed(0.5, (high + low).powi(2) / (4.0 * high * low)),
        mixed(root_low / (root_high + root_low), (root_high - root_low).powi(2)),
    )
}

/// Searches the planar direction with the largest `value` by a scan and golden section.
fn search_worst(value: impl Fn(&DVector<f64>) -> f64) -> WorstNormal {
    let along = |angle: f64| DVector::from_vec(vec![angle.cos(), angle.sin()]);
    let steps = 180;
    let step = std::f64::consts::PI / f64::from(steps);
    let best = (0..steps)
        .map(|i| f64::from(i) * step)
        .max_by(|a, b| value(&along(*a)).total_cmp(&value(&along(*b))))
        .unwrap_or(0.0);
    let (mut low, mut high) = (best - step, best + step);
    for _ in 0..60 {
        let golden = 0.618_033_988_749_895 * (high - low);
        let (left, right) = (high - golden, low + golden);
        if value(&along(left)) > value(&along(right)) { high = right } else { low = left }
    }
    let normal = along((low + high) / 2.0);
    WorstNormal { value: value(&normal), normal: normal.iter().copied().collect() }
}

/// Returns the largest `value` on a way from `from` (rad) that crosses no singularity and no limit.
///
/// A compass search over all grid directions takes steps of at most `step` rad and halves them to 1e-5 rad. It stops at
/// the sine 1e-3 from a singularity, where an arm is stretched to within a millionth of its length.
pub fn climb(
    device: &Device<f64>,
    from: &[f64],
    step: f64,
    value: impl Fn(&TaskPose) -> f64,
) -> Result<f64, PoseError> {
    // The coordinates of a joint that does not repeat, such as a paddle's, end where the grid ends.
    let beyond = |(joint, angle): (usize, &f64)| !device.mechanism.repeats(joint) && angle.abs() > std::f64::consts::PI;
    let at = |q: &[f64]| -> Result<Option<(bool, f64)>, PoseError> {
        if q.iter().enumerate().any(beyond) {
            return Ok(None);
        }
        let Some(side) = side(device, q, 1e-3)? else { return Ok(None) };
        Ok(Some((side, value(&TaskPose::of(&device.mechanism, q)?))))
    };
    let mut q = from.to_vec();
    let Some((start, mut best)) = at(&q)? else { return Ok(value(&TaskPose::of(&device.mechanism, from)?)) };
    let mut step = step;
    while step > 1e-5 {
        let mut better = None;
        for direction in 0..3_usize.pow(q.len() as u32) {
            let towards = |joint: usize| ((direction / 3_usize.pow(joint as u32)) % 3) as f64 - 1.0;
            let next: Vec<f64> = q.iter().enumerate().map(|(joint, angle)| angle + step * towards(joint)).collect();
            match at(&next)? {
                Some((side, value)) if side == start && value > best => (best, better) = (value, Some(next)),
                _ => {}
            }
        }
        match better {
            Some(next) => q = next,
            None => step *= 0.5,
        }
    }
    Ok(best)
}

/// Returns the pose's side of the singularities, or `None` beyond a limit or within `sine` of a singularity.
fn side(device: &Device<f64>, q: &[f64], sine: f64) -> Result<Option<bool>, PoseError> {
    // Rounding may put a grid angle on a limit slightly beyond the limit.
    let allowed = |(angle, joint): (&f64, &Joint<f64>)| {
        joint.limits.is_none_or(|(low, high)| (low - 1e-9..=high + 1e-9).contains(angle))
    };
    if !q.iter().zip(&device.joints).all(allowed) {
        return Ok(None);
    }
    let stance = Stance::of(&device.mechanism, q)?;
    Ok(stance.is_clear(sine).then_some(stance.positive))
}

impl Reachable {
    /// Floods a grid of `per_joint` angles per joint from home, or from the most regular pose if the device has no
    /// home. `held` restricts the grid to a plane.
    pub fn from_home(
        description: &Description,
        per_joint: usize,
        held: Option<FixedCoordinate>,
    ) -> Result<Self, PoseError> {
        Self::of(&Device::new("", description)?, per_joint, held)
    }

    /// Like [`Reachable::from_home`], for a [`Device`].
    pub fn of(device: &Device<f64>, per_joint: usize, held: Option<FixedCoordinate>) -> Result<Self, PoseError> {
        let spec = device.mechanism.kind().spec();
        let mut axes = Vec::new();
        let mut wraps = Vec::new();
        for joint in 0..spec.joints {
            let repeats = device.mechanism.repeats(joint);
            match (held, device.joints[joint].limits) {
                (Some(FixedCoordinate::Joint(at, angle)), _) if at == joint => {
                    axes.push(vec![angle]);
                    wraps.push(false);
                }
                (Some(FixedCoordinate::Orientation(_)), _) if joint + 1 == spec.joints => {
                    axes.push(vec![0.0]);
                    wraps.push(false);
                }
                (_, Some((low, high))) if repeats && high - low > std::f64::consts::TAU => {
                    // Angles beyond a turn add no pose. With at least two turns the grid closes on itself.
                    let (pi, turn) = (std::f64::consts::PI, std::f64::consts::TAU);
                    let first = 0.0_f64.clamp(low + pi, high - pi) - pi;
                    let step = turn / per_joint as f64;
                    axes.push((0..per_joint).map(|i| first + (i as f64 + 0.5) * step).collect());
                    wraps.push(high - low >= 2.0 * turn && per_joint > 2);
                }
                (_, Some((low, high))) => {
                    let last = per_joint.max(2) - 1;
                    axes.push((0..=last).map(|i| low + (high - low) * i as f64 / last as f64).collect());
                    wraps.push(false);
                }
                (_, None) => {
                    // A full turn is divided into cells so that -π does not appear twice.
                    let step = std::f64::consts::TAU / per_joint as f64;
                    axes.push((0..per_joint).map(|i| -std::f64::consts::PI + (i as f64 + 0.5) * step).collect());
                    wraps.push(repeats && per_joint > 2);
                }
            }
        }
        let mut grid = Self { axes, wraps, reached: Vec::new(), held, device: device.clone(), side: None };
        grid.flood(device)?;
        Ok(grid)
    }

    /// Marks the points that paths from home reach without crossing a singularity.
    fn flood(&mut self, device: &Device<f64>) -> Result<(), PoseError> {
        let count: usize = self.axes.iter().map(Vec::len).product();
        let sides: Vec<Option<bool>> =
            (0..count).map(|i| side(device, &self.angles(i), WALKABLE_SINE)).collect::<Result<_, _>>()?;
        self.reached = vec![false; count];
        let home = device.home.unwrap_or_default();
        let far = |index: usize| -> f64 {
            self.angles(index)
                .iter()
                .zip(home)
                .map(|(q, h)| (q - h - std::f64::consts::TAU * ((q - h) / std::f64::consts::TAU).round()).powi(2))
                .sum()
        };
        let Some(start) = (0..count).filter(|&i| sides[i].is_some()).min_by(|&a, &b| far(a).total_cmp(&far(b))) else {
            return Ok(());
        };
        self.side = sides[start];
        let mut pending = vec![start];
        self.reached[start] = true;
        while let Some(index) = pending.pop() {
            for neighbour in self.neighbours(index) {
                if !self.reached[neighbour] && sides[neighbour] == sides[start] && self.is_connected(index, neighbour) {
                    self.reached[neighbour] = true;
                    pending.push(neighbour);
                }
            }
        }
        Ok(())
    }

    /// Returns the joint angles of a grid pose.
    pub fn angles(&self, mut index: usize) -> Vec<f64> {
        let mut q = vec![0.0; self.axes.len()];
        for joint in (0..self.axes.len()).rev() {
            q[joint] = self.axes[joint][index % self.axes[joint].len()];
            index /= self.axes[joint].len();
        }
        self.complete(&mut q);
        q
    }

    /// Computes the last angle of `q` if the orientation is held, plus or minus whole turns to lie within the limits.
    pub fn complete(&self, q: &mut [f64]) {
        let Some(FixedCoordinate::Orientation(phi)) = self.held else { return };
        let Some((last, others)) = q.split_last_mut() else { return };
        let turn = std::f64::consts::TAU;
        let angle = phi - others.iter().sum::<f64>();
        let low = self.device.joints[others.len()].limits.map_or(-std::f64::consts::PI, |limits| limits.0);
        *last = low + (angle - low).rem_euclid(turn);
    }

    /// Returns true if `q` (rad) is within the limits and on the reached side of the singularities.
    pub fn is_on_reached_side(&self, q: &[f64]) -> bool {
        self.side.is_some() && side(&self.device, q, WALKABLE_SINE).is_ok_and(|result| result == self.side)
    }

    /// Returns true if no singularity lies between two neighbouring grid poses.
    fn is_connected(&self, from: usize, to: usize) -> bool {
        let (from, to) = (self.angles(from), self.angles(to));
        let turn = std::f64::consts::TAU;
        let travel = |joint: usize| {
            let travel = to[joint] - from[joint];
            if self.wraps[joint] { travel - turn * (travel / turn).round() } else { travel }
        };
        let travels: Vec<f64> = (0..from.len()).map(travel).collect();
        let swept = travels.iter().zip(&self.axes).filter(|(_, axis)| axis.len() > 1);
        let steps = (swept.map(|(travel, _)| travel.abs()).fold(0.0, f64::max) / MAX_FLOOD_STEP_RAD).ceil() as usize;
        (1..steps).all(|i| {
            let mut q: Vec<f64> =
                from.iter().zip(&travels).map(|(from, travel)| from + travel * i as f64 / steps as f64).collect();
            self.complete(&mut q);
            self.is_on_reached_side(&q)
        })
    }

    /// Returns true if the pose with this flat index was reached.
    pub fn is_reached(&self, index: usize) -> bool {
        self.reached.get(index) == Some(&true)
    }

    /// Returns the flat indices of the reached poses.
    pub fn indices(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.reached.len()).filter(|&i| self.reached[i])
    }

    fn neighbours(&self, index: usize) -> Vec<usize> {
        let mut result = Vec::new();
        let mut stride = 1;
        for joint in (0..self.axes.len()).rev() {
            let length = self.axes[joint].len();
            let place = (index / stride) % length;
            let base = index - place * stride;
            if place + 1 < length {
                result.push(base + (place + 1) * stride);
            } else if self.wraps[joint] {
                result.push(base);
            }
            if place > 0 {
                result.push(base + (place - 1) * stride);
            } else if self.wraps[joint] {
                result.push(base + (length - 1) * stride);
            }
            stride *= length;
        }
        result
    }
}

/// Computes the map of a device over about `points` grid poses, for one normal (d entries, any length but zero).
pub fn map(description: &Description, normal: &[f64], points: usize) -> Result<Vec<MapPoint>, PoseError> {
    map_holding(description, normal, points, Admissible::default())
}

/// Like [`map`], for a redundant device whose feed-forward holds `admissible`.
pub fn map_holding(
    description: &Description,
    normal: &[f64],
    points: usize,
    admissible: Admissible,
) -> Result<Vec<MapPoint>, PoseError> {
    map_until(description, normal, points, admissible, &|| false)
}

/// Like [`map_holding`], but skips the remaining poses once `stop` returns true.
pub fn map_until(
    description: &Description,
    normal: &[f64],
    points: usize,
    admissible: Admissible,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<MapPoint>, PoseError> {
    evaluate_pieces(description, normal, points, admissible, |pieces, work| {
        let until = |piece: &Vec<Vec<f64>>| if stop() { Vec::new() } else { work(piece) };
        Ok(crate::cores::map(pieces, &|_, _| {}, until).into_iter().flatten().collect())
    })
}

const POSES_PER_ITEM: usize = 256;

/// Like [`map_holding`], as an interruptible sweep.
pub fn map_swept(
    description: &Description,
    normal: &[f64],
    points: usize,
    admissible: Admissible,
    sweep: &Sweep,
) -> Result<Vec<MapPoint>, Failure> {
    evaluate_pieces(description, normal, points, admissible, |pieces, work| {
        Ok(sweep.map("poses, in pieces", pieces, |piece| Ok(work(piece)))?.into_iter().flatten().collect())
    })
}

type PieceWork<'a> = &'a (dyn Fn(&Vec<Vec<f64>>) -> Vec<MapPoint> + Sync);

fn evaluate_pieces<E: From<PoseError>>(
    description: &Description,
    normal: &[f64],
    points: usize,
    admissible: Admissible,
    sweep: impl FnOnce(&[Vec<Vec<f64>>], PieceWork<'_>) -> Result<Vec<MapPoint>, E>,
) -> Result<Vec<MapPoint>, E> {
    let spec = description.kind.spec();
    let normal = unit_normal(normal, spec.task, spec.joints)?;
    let per_joint = (points as f64).powf(1.0 / spec.joints as f64).round().max(2.0) as usize;
    let reachable = Reachable::from_home(description, per_joint, None)?;
    let device = AnyMechanism::new(description).map_err(PoseError::from)?;
    let poses: Vec<Vec<f64>> = reachable.indices().map(|index| reachable.angles(index)).collect();
    let pieces: Vec<Vec<Vec<f64>>> = poses.chunks(POSES_PER_ITEM).map(<[Vec<f64>]>::to_vec).collect();
    sweep(&pieces, &|piece| {
        // The pose is valid because the device reached it.
        let at = |q: &Vec<f64>| evaluate(&TaskPose::of(&device, q).ok()?.holding(admissible), q, &normal);
        piece.iter().filter_map(at).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::device_file::DeviceFile;

    fn device(name: &str) -> Description {
        let path = format!("{}/../../devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        DeviceFile::load(path).unwrap().description
    }

    /// Returns Wrr/Weff and Wrr - Weff along a normal, computed from M and J alone.
    fn inertia_ratio_and_coupling(description: &Description, q: &[f64], normal: &[f64]) -> (f64, f64) {
        let device = super::super::plant::Linearised::at(description, q, normal).unwrap();
        let (held, free) = (device.w_rr(), device.w_eff().unwrap());
        (held / free, held - free)
    }

    #[test]
    fn worst_normals_exceed_all_other_normals() {
        for (name, q) in [
            ("coupled-five-bar", vec![2.6, 1.75]),
            ("phantom-premium-1.5", vec![0.3, 0.9, -0.3]),
            ("fictive-five-bar-turret", vec![0.3, 2.4, 1.1]),
            ("serial-3r", vec![0.6, 0.9, -0.7]),
        ] {
            let description = device(name);
            let task = description.kind.spec().task;
            let n = unit_normal(&vec![1.0; task], task, q.len()).unwrap();
            let point = map_point_at(&description, &q, &n, Admissible::default()).unwrap().unwrap();
            let (ratio, _) = inertia_ratio_and_coupling(&description, &q, &point.worst_ratio.normal);
            let (_, coupling) = inertia_ratio_and_coupling(&description, &q, &point.worst_coupling.normal);
            assert!((ratio / point.worst_ratio.value - 1.0).abs() < 1e-9, "{name}");
            assert!((coupling / point.worst_coupling.value - 1.0).abs() < 1e-7, "{name}");
            for i in 0..40 {
                for j in 0..if task == 3 { 40 } else { 1 } {
                    let (a, b) = (f64::from(i) * 0.0785, f64::from(j) * 0.157);
                    let normal = [a.cos(), a.sin() * b.cos(), a.sin() * b.sin()];
                    let (other_ratio, other_coupling) = inertia_ratio_and_coupling(&description, &q, &normal[..task]);
                    assert!(other_ratio <= ratio * (1.0 + 1e-9), "{name}");
                    assert!(other_coupling <= coupling * (1.0 + 1e-9), "{name}");
                }
            }
        }
    }

    #[test]
    fn the_map_stays_in_the_working_mode_of_home() {
        for name in ["haply-2diy", "phantom-premium-1.5", "serial-3r", "hapkit-paddle"] {
            let description = device(name);
            let home = &description.home.unwrap()[..description.kind.spec().joints];
            let sign = |q: &[f64]| TaskPose::at(&description, q).unwrap().jacobian.determinant() > 0.0;
            let task = description.kind.spec().task;
            let points = map(&description, &vec![1.0; task], 800).unwrap();
            assert!(points.len() > 30, "{name}: {}", points.len());
            assert!(points.iter().all(|p| sign(&p.q) == sign(home) && p.w_eff <= p.w_rr * (1.0 + 1e-9)), "{name}");
        }
    }
}
