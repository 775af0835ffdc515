//! The plane of the workspace that a map shows, divided into tiles with the quantities of [`super::map`].
//!
//! The angles of two joints span the plane. The angles start at home and end at joint limits and singularities, as in
//! the map's grid. Every corner of a tile is an evaluated pose; values are not interpolated.
//!
//! A device on a turret is cut at joint 0 = 0, or at its home angle if its limits exclude 0, and is drawn in the plane
//! of its linkage. Other devices in space keep joint 0 at home. The redundant arm keeps the orientation that it has at
//! home.

use super::map::{FixedCoordinate, MapPoint, Reachable, effective_inertias, map_point_at};
use super::pose::{PoseError, TaskPose, unit_normal};
use crate::skeleton::{Point, Turret, View};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use nalgebra::DVector;

/// Number of grid angles per swept joint before tiles are divided.
const GRID_ANGLES: usize = 64;
/// Maximum number of halvings of a tile inside the workspace.
const MAX_HALVINGS: usize = 4;
/// Maximum number of halvings of an edge tile. Two leave 1.4° of a turn, where the edge is nearly straight.
const MAX_EDGE_HALVINGS: usize = 2;

/// A pose in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Angles of the two swept joints, rad.
    pub swept: [f64; 2],
    /// Position of the tip in the plane of the linkage, m.
    pub place: Point,
    /// Share of the coupling in the rendered inertia, (Wrr - Weff)/Wrr.
    pub share: f64,
}

/// A piece of the plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Outline, m.
    pub outline: Vec<Point>,
    /// Mean of the corners' shares.
    pub share: f64,
}

impl Tile {
    /// Returns the area, m².
    pub fn area(&self) -> f64 {
        let next = self.outline.iter().cycle().skip(1);
        let twice: f64 = self.outline.iter().zip(next).map(|(a, b)| a.0 * b.1 - b.0 * a.1).sum();
        twice.abs() / 2.0
    }
}

/// Fineness of the division into tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// Largest side of a tile, m.
    pub side: f64,
    /// Side below which a tile is not divided further, even if its shares differ, m.
    pub least: f64,
    /// Largest allowed difference of the share between a tile's corners, for shares below `top`.
    pub step: f64,
    /// Share above which all shares count as equal.
    pub top: f64,
}

/// The drawn plane of one device and normal.
#[derive(Clone, Debug)]
pub struct Cut {
    description: Description,
    device: Device<f64>,
    reachable: Reachable,
    swept: [usize; 2],
    /// Direction from which the plane is seen.
    pub view: View,
    /// Text that names the held coordinate and its value; empty if no coordinate is held.
    pub caption: String,
    normal: DVector<f64>,
    admissible: Admissible,
    /// Unit vectors of the plane's x and y in the task's frame.
    axes: [[f64; 3]; 2],
}

impl Cut {
    /// Prepares the plane of a device with at least two joints for the wall normal `normal` (d entries).
    pub fn new(description: &Description, normal: &[f64], admissible: Admissible) -> Result<Self, PoseError> {
        let spec = description.kind.spec();
        let device = Device::new("", description)?;
        let home = description.home.unwrap_or_default();
        let (held, swept, caption) = match (spec.joints, spec.task) {
            (3, 3) => {
                let allowed = |angle: &f64| device.joints[0].limits.is_none_or(|(l, h)| (l..=h).contains(angle));
                let middle = device.joints[0].limits.map_or(0.0, |(l, h)| (l + h) / 2.0);
                let neutral = if Turret::of(description.kind).is_some() { 0.0 } else { home[0] };
                let angle = [neutral, home[0]].into_iter().find(allowed).unwrap_or(middle);
                (
                    Some(FixedCoordinate::Joint(0, angle)),
                    [1, 2],
                    format!("joint 0 at {angle:.3} {}", description.units()[0].travel),
                )
            }
            (3, _) => {
                let phi: f64 = home.iter().sum();
                let caption = match admissible {
                    Admissible::Orientation => format!("orientation held at {phi:.3} rad, as at home"),
                    other => format!("{} held; shown where the orientation is {phi:.3} rad, as at home", other.name()),
                };
                (Some(FixedCoordinate::Orientation(phi)), [0, 1], caption)
            }
            _ => (None, [0, 1], String::new()),
        };
        let turned = if let Some(FixedCoordinate::Joint(_, angle)) = held { angle } else { 0.0 };
        let (sin, cos) = turned.sin_cos();
        let view = match spec.task {
            3 => View::of_drawing(description)[0],
            _ => View::of_task(description),
        };
        let axes = match Turret::of(description.kind) {
            Some(Turret::AboutX) => [[1.0, 0.0, 0.0], [0.0, cos, sin]],
            Some(Turret::AboutY) => [[cos, 0.0, -sin], [0.0, 1.0, 0.0]],
            None => view.in_task(description),
        };
        let reachable = Reachable::of(&device, GRID_ANGLES, held)?;
        let normal = unit_normal(normal, spec.task, spec.joints)?;
        Ok(Self { description: *description, device, reachable, swept, view, caption, normal, admissible, axes })
    }

    /// Projects a task vector onto the plane.
    pub fn project(&self, vector: &[f64]) -> Point {
        let on = |axis: &[f64; 3]| vector.iter().zip(axis).map(|(v, a)| v * a).sum();
        (on(&self.axes[0]), on(&self.axes[1]))
    }

    /// Returns all joint angles for two swept angles, rad.
    pub fn q(&self, swept: [f64; 2]) -> Vec<f64> {
        let mut q: Vec<f64> = self.reachable.axes.iter().map(|axis| axis[0]).collect();
        q[self.swept[0]] = swept[0];
        q[self.swept[1]] = swept[1];
        self.reachable.complete(&mut q);
        q
    }

    /// Returns the pose at two swept angles, or `None` if the device cannot reach it.
    pub fn node(&self, swept: [f64; 2]) -> Option<Node> {
        let q = self.q(swept);
        self.reachable.is_on_reached_side(&q).then(|| self.evaluate(&q, swept)).flatten()
    }

    fn evaluate(&self, q: &[f64], swept: [f64; 2]) -> Option<Node> {
        let pose = TaskPose::of(&self.device.mechanism, q).ok()?.holding(self.admissible);
        let (w_eff, w_rr) = effective_inertias(&pose, &self.normal)?;
        Some(Node { swept, place: self.project(&pose.position), share: ((w_rr - w_eff) / w_rr).max(0.0) })
    }

    /// Evaluates the reachable grid poses whose tip position is `wanted`.
    pub fn points(&self, wanted: impl Fn(Point) -> bool) -> Result<Vec<MapPoint>, PoseError> {
        let angles = self.reachable.indices().map(|index| self.reachable.angles(index));
        let is_wanted = |q: &Vec<f64>| {
            TaskPose::of(&self.device.mechanism, q).is_ok_and(|pose| wanted(self.project(&pose.position)))
        };
        angles
            .filter(is_wanted)
            .filter_map(|q| map_point_at(&self.description, &q, &self.normal, self.admissible).transpose())
            .collect()
    }

    /// Divides the plane into tiles.
    pub fn tiles(&self, fineness: Fineness) -> Vec<Tile> {
        let mut tiles = Vec::new();
        for corners in self.cells() {
            self.divide(corners, &fineness, 0, &mut tiles);
        }
        tiles
    }

    /// Returns the cells of the grid with at least one reached corner.
    fn cells(&self) -> Vec<[Corner; 4]> {
        let [first, second] = self.swept.map(|joint| &self.reachable.axes[joint]);
        let ends =
            |axis: &Vec<f64>, joint: usize| if self.reachable.wraps[joint] { axis.len() } else { axis.len() - 1 };
        let angle = |axis: &Vec<f64>, i: usize| match axis.get(i) {
            Some(angle) => *angle,
            // A full turn ends at the first angle plus 2π.
            None => axis[0] + std::f64::consts::TAU,
        };
        let corner = |i: usize, j: usize| {
            let swept = [angle(first, i), angle(second, j)];
            let index = (i % first.len()) * second.len() + j % second.len();
            let node = self.reachable.is_reached(index).then(|| self.evaluate(&self.q(swept), swept)).flatten();
            Corner { swept, node }
        };
        let mut cells = Vec::new();
        for i in 0..ends(first, self.swept[0]) {
            for j in 0..ends(second, self.swept[1]) {
                let corners = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                if corners.iter().any(|c| c.node.is_some()) {
                    cells.push(corners);
                }
            }
        }
        cells
    }

    fn divide(&self, corners: [Corner; 4], fineness: &Fineness, depth: usize, tiles: &mut Vec<Tile>) {
        let nodes: Vec<Node> = corners.iter().filter_map(|c| c.node).collect();
        if nodes.is_empty() {
            return;
        }
        let whole = nodes.len() == 4;
        if depth < if whole { MAX_HALVINGS } else { MAX_EDGE_HALVINGS } && (!whole || too_coarse(&nodes, fineness)) {
            let [a, b, c, d] = corners;
            let between = |a: &Corner, b: &Corner| {
                let swept = [(a.swept[0] + b.swept[0]) / 2.0, (a.swept[1] + b.swept[1]) / 2.0];
                Corner { swept, node: self.node(swept) }
            };
            let (ab, bc, cd, da, middle) =
                (between(&a, &b), between(&b, &c), between(&c, &d), between(&d, &a), between(&a, &c));
            for part in [[a, ab, middle, da], [ab, b, bc, middle], [middle, bc, c, cd], [da, middle, cd, d]] {
                self.divide(part, fineness, depth + 1, tiles);
            }
            return;
        }
        let mut outline = Vec::with_capacity(6);
        for (corner, next) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            match (corner.node, next.node) {
                (Some(here), None) => outline.extend([Some(here), self.last_reachable(here, next.swept)]),
                (None, Some(reached)) => outline.push(self.last_reachable(reached, corner.swept)),
                (here, _) => outline.push(here),
            }
        }
        let outline: Vec<Node> = outline.into_iter().flatten().collect();
        let share = outline.iter().map(|n| n.share.min(2.0 * fineness.top)).sum::<f64>() / outline.len() as f64;
        tiles.push(Tile { outline: outline.iter().map(|n| n.place).collect(), share });
    }

    /// Returns the last reachable pose on the way from `inside` to the unreachable angles `outside`.
    fn last_reachable(&self, inside: Node, outside: [f64; 2]) -> Option<Node> {
        let mut last = inside;
        let mut beyond = outside;
        for _ in 0..12 {
            let middle = [(last.swept[0] + beyond[0]) / 2.0, (last.swept[1] + beyond[1]) / 2.0];
            match self.node(middle) {
                Some(node) => last = node,
                None => beyond = middle,
            }
        }
        Some(last)
    }
}

/// A corner of a cell: its swept angles, and its pose if reachable.
#[derive(Clone, Copy, Debug)]
struct Corner {
    swept: [f64; 2],
    node: Option<Node>,
}

fn too_coarse(nodes: &[Node], fineness: &Fineness) -> bool {
    let spread = |values: [f64; 4]| {
        values.iter().copied().fold(f64::MIN, f64::max) - values.iter().copied().fold(f64::MAX, f64::min)
    };
    let of = |pick: fn(&Node) -> f64| spread(std::array::from_fn(|i| pick(&nodes[i])));
    let shares: [f64; 4] = std::array::from_fn(|i| nodes[i].share.min(fineness.top + fineness.step));
    let side = of(|n| n.place.0).max(of(|n| n.place.1));
    side > fineness.side || (side > fineness.least && spread(shares) > fineness.step)
}
