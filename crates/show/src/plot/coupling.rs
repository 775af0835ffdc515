//! The paper's Fig. 1 for any device and pose: the linkage with its motion along a normal, and the coupling of the
//! inertia in every direction, with the axes of the tip's inertia.
//!
//! In the plane the coupling is drawn as a curve over directions, in space as a surface. With as many joints as task
//! directions the coupling vanishes along the axes and is largest between the first and the last axis.

use super::axes::{Axis, Mark, PlotArea};
use super::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use super::colour::{BOUND_COLOUR, FAINT_GREY, FULL_COLOUR, INK, OFF_COLOUR, WASHOUT_COLOUR, scale};
use super::paper::{EDGE_MARGIN, Paper, wrap};
use super::{Picture, linkage};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_host::vectors::padded_to;
use haptic_stability::analysis::map::{MapPoint, effective_inertias, map_point_at};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::{PoseError, TaskPose, unit_normal};
use haptic_stability::skeleton::{Point, Skeleton, skeleton};
use nalgebra::{DVector, Vector3};

/// Side of each drawing on a screen, pixels.
const DRAWING_SIDE: f64 = 380.0;
/// Page width on a screen, with two drawings side by side, pixels.
const SCREEN_WIDTH: f64 = 2.0 * DRAWING_SIDE + 190.0;
/// Height of the axis labels and the legend below a drawing, pixels.
const LEGEND_HEIGHT: f64 = 165.0;
/// Distance by which the drawn motion moves the tip, as a share of the side of the drawing.
const MOTION_SHARE: f64 = 0.1;
/// Number of directions in which a surface is sampled: around a half turn, and around a full turn.
const SURFACE_DIRECTIONS: (usize, usize) = (24, 48);
/// Angles of the view of a surface, rad: the turn about its vertical, then the tilt.
const VIEW_ANGLES: (f64, f64) = (-0.6, 0.45);

const MOVED_LINKAGE_STROKE: Stroke<'static> = Stroke { colour: FAINT_GREY, width: 1.2, dash: "4 3" };

/// Draws a device at `q` (rad) and its motion along `normal`; `None` if it cannot close or the pose is singular.
pub fn draw(
    description: &Description,
    name: &str,
    q: &[f64],
    normal: &[f64],
    admissible: Admissible,
    paper: Paper,
) -> Result<Option<Picture>, PoseError> {
    let spec = description.kind.spec();
    let Some(here) = skeleton(description, q) else { return Ok(None) };
    let pose = TaskPose::at(description, q)?.regular()?.holding(admissible);
    let n = unit_normal(normal, spec.task, spec.joints)?;
    let Some(point) = map_point_at(description, q, &n, admissible)? else { return Ok(None) };
    let device = Linearised::holding(description, q, normal, admissible)?;
    let title = format!("{name}: motion along n, and coupling over all directions");
    let list = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    let pose_line = format!("q = ({}) rad, n = ({})", list(q), list(&n.as_slice()[..spec.task]));
    let mut page = paper.page(SCREEN_WIDTH, 75.0);
    page.begin = page.begin.min(30.0);
    let heading = page.heading(&title, &[pose_line]);
    // The drawings are side by side, or on a narrow page one below the other.
    let side = match (page.is_narrow(), paper.is_printed()) {
        (true, _) => page.wide - page.left - 24.0,
        (_, true) => (page.wide - (SCREEN_WIDTH - 2.0 * DRAWING_SIDE)) / 2.0,
        _ => DRAWING_SIDE,
    };
    let top = 70.0 + heading.extra_height(1);
    let under = side + LEGEND_HEIGHT;
    let second = if page.is_narrow() { (page.left, top + under) } else { (page.left + side + 65.0, top) };
    let lines = [
        format!(
            "Along n a wall meets Weff = {:.4} kg without the feed-forward and Wrr = {:.4} kg with it: {:.3} times as much.",
            point.w_eff,
            point.w_rr,
            point.w_rr / point.w_eff
        ),
        match spec.task {
            1 => String::new(),
            _ => format!(
                "Maximum at n = ({}): {:.3} times. Axes of the tip's inertia: {} kg.",
                list(&point.worst_ratio.normal),
                point.worst_ratio.value,
                point.eigenvalues.iter().map(|v| format!("{v:.4}")).collect::<Vec<_>>().join(", ")
            ),
        },
    ];
    let lines = page.notes(lines.iter().map(String::as_str));
    let bottom = second.1 + under;
    let mut canvas = page.canvas(bottom + 4.0 + 18.0 * lines.len() as f64);
    heading.draw(&mut canvas);
    draw_motion(&mut canvas, description, q, &here, &device, Square { at: (page.left, top), side });
    let place = Square { at: second, side };
    match spec.task {
        1 => {
            let at = (second.0, second.1 + 40.0);
            canvas.text(at, 12.0, Anchor::Start, false, "One task direction: there is no coupling.");
        }
        2 => draw_curve(&mut canvas, place, &pose, &point, &n),
        _ => draw_surface(&mut canvas, place, &pose, &point, &n),
    }
    for (i, line) in lines.iter().enumerate() {
        canvas.text((page.begin, bottom + 18.0 * i as f64), SMALL_TEXT, Anchor::Start, false, line);
    }
    Ok(Some(canvas.finish(&title, "The linkage moved along the normal, and the coupling Wrr - Weff by direction.")))
}

/// The square of a drawing: its upper left corner, and its side, pixels.
#[derive(Clone, Copy)]
struct Square {
    at: Point,
    side: f64,
}

/// Returns the tip's displacement for a small joint motion, per unit of motion.
fn tip_displacement(description: &Description, q: &[f64], here: &Skeleton, motion: &DVector<f64>) -> Option<Point> {
    let size = 1e-5 / motion.amax().max(1e-12);
    let moved: Vec<f64> = q.iter().zip(motion.iter()).map(|(q, m)| q + size * m).collect();
    let there = skeleton(description, &moved)?;
    Some(((there.tip.0 - here.tip.0) / size, (there.tip.1 - here.tip.1) / size))
}

/// Draws the device, and its motions under a push along n with and without the feed-forward.
fn draw_motion(
    canvas: &mut Canvas,
    description: &Description,
    q: &[f64],
    here: &Skeleton,
    device: &Linearised,
    Square { at, side }: Square,
) {
    let points = here.bars.iter().flat_map(|bar| [bar.from, bar.to]).chain(here.base.iter().copied());
    let (low, high) = super::linkage::bounding_box(points);
    let middle = ((low.0 + high.0) / 2.0, (low.1 + high.1) / 2.0);
    let half = 0.68 * (high.0 - low.0).max(high.1 - low.1);
    let axis =
        |name: &str, middle: f64| Axis { name: name.into(), unit: "m".into(), low: middle - half, high: middle + half };
    let frame = PlotArea { at, size: (side, side), x: axis("x", middle.0), y: axis("y", middle.1) };
    // Joint motions per metre of the tip along n: constrained to n (`held`), and as torques Jᵀn alone cause (`free`).
    let held = device.unit_motion.clone();
    let free = device.mass.clone().cholesky().map(|mass| mass.solve(&device.row));
    let free = free.and_then(|push| Some(push * device.w_eff()?)).unwrap_or_else(|| held.clone());
    let far = 2.0 * half * MOTION_SHARE;
    frame.draw_clipped(canvas, |canvas| {
        for share in [-1.0, 1.0] {
            let moved: Vec<f64> = q.iter().zip(held.iter()).map(|(q, m)| q + share * far * m).collect();
            let Some(ghost) = skeleton(description, &moved) else { continue };
            for bar in &ghost.bars {
                let ends = [bar.from, bar.to].map(|p| frame.pixel(p.0, p.1));
                canvas.polyline(&ends, MOVED_LINKAGE_STROKE);
            }
        }
        linkage::draw_linkage(canvas, &frame, here);
        for (motion, colour) in [(&free, OFF_COLOUR), (&held, FULL_COLOUR)] {
            let Some(along) = tip_displacement(description, q, here, motion) else { continue };
            let end = (here.tip.0 + 2.0 * far * along.0, here.tip.1 + 2.0 * far * along.1);
            draw_arrow(canvas, frame.pixel(here.tip.0, here.tip.1), frame.pixel(end.0, end.1), colour);
        }
    });
    frame.draw(canvas, "");
    let entries = [
        (Mark::Line(Stroke::solid(FULL_COLOUR, 2.0)), "along n, with the feed-forward".to_string()),
        (Mark::Line(Stroke::solid(OFF_COLOUR, 2.0)), "push along n, without the feed-forward".to_string()),
        (Mark::Line(MOVED_LINKAGE_STROKE), "the linkage moved along n, with feed-forward".to_string()),
    ];
    draw_legend(canvas, Square { at, side }, &entries);
}

/// Draws a legend below a drawing, right-aligned with it, or at the page's left edge if it is too wide.
fn draw_legend(canvas: &mut Canvas, Square { at, side }: Square, entries: &[(Mark<'_>, String)]) {
    let width = PlotArea::legend_size(entries).0;
    PlotArea::legend(canvas, (at.0 + side).max(EDGE_MARGIN + width), at.1 + side + 52.0, entries);
}

fn draw_arrow(canvas: &mut Canvas, from: Point, to: Point, colour: &str) {
    canvas.line(from, to, Stroke::solid(colour, 2.0));
    let (x, y) = (to.0 - from.0, to.1 - from.1);
    let length = x.hypot(y).max(1e-9);
    let (x, y) = (x / length, y / length);
    let side = |turn: f64| (to.0 - 9.0 * x + turn * 4.0 * y, to.1 - 9.0 * y - turn * 4.0 * x);
    canvas.polygon(&[to, side(1.0), side(-1.0)], colour, 1.0);
}

/// Draws Weff, Wrr and their difference around a full turn.
fn draw_curve(canvas: &mut Canvas, Square { at, side }: Square, pose: &TaskPose, point: &MapPoint, n: &DVector<f64>) {
    let joints = pose.jacobian.nrows();
    let samples: Vec<(f64, f64, f64)> = (0..=180)
        .filter_map(|i| {
            let angle = std::f64::consts::TAU * f64::from(i) / 180.0;
            let mut direction = DVector::zeros(joints);
            (direction[0], direction[1]) = (angle.cos(), angle.sin());
            effective_inertias(pose, &direction).map(|(w_eff, w_rr)| (angle, w_eff, w_rr))
        })
        .collect();
    let largest = samples.iter().map(|(_, _, w_rr)| *w_rr).fold(0.0, f64::max) * 1.12;
    let axis = |name: &str| Axis { name: name.into(), unit: "kg".into(), low: -largest, high: largest };
    let frame = PlotArea { at, size: (side, side), x: axis("along x"), y: axis("along y") };
    let polar = |value: fn(&(f64, f64, f64)) -> f64| -> Vec<(f64, f64)> {
        samples.iter().map(|sample| (value(sample) * sample.0.cos(), value(sample) * sample.0.sin())).collect()
    };
    frame.draw_clipped(canvas, |canvas| {
        let (pixel, length) = (|v: &[f64]| frame.pixel(v[0], v[1]), 0.98 * largest);
        draw_axes(canvas, &pixel, point, length);
        draw_axis_names(canvas, &pixel, point, length);
        let coupling = polar(|(_, w_eff, w_rr)| (w_rr - w_eff).max(0.0));
        let area: Vec<Point> = coupling.iter().map(|p| frame.pixel(p.0, p.1)).collect();
        canvas.polygon(&area, WASHOUT_COLOUR, 0.35);
        frame.curve(canvas, &coupling, Stroke::solid(WASHOUT_COLOUR, 1.6));
        frame.curve(canvas, &polar(|sample| sample.1), Stroke::solid(OFF_COLOUR, 1.8));
        frame.curve(canvas, &polar(|sample| sample.2), Stroke::solid(FULL_COLOUR, 1.8));
        draw_arrow(canvas, frame.pixel(0.0, 0.0), frame.pixel(largest * n[0], largest * n[1]), BOUND_COLOUR);
    });
    frame.draw(canvas, "");
    let entries = [
        (Mark::Line(Stroke::solid(OFF_COLOUR, 1.8)), "Weff".to_string()),
        (Mark::Line(Stroke::solid(FULL_COLOUR, 1.8)), "Wrr".to_string()),
        (Mark::Area(WASHOUT_COLOUR), "coupling Wrr - Weff".to_string()),
        (Mark::Line(Stroke::solid(BOUND_COLOUR, 2.0)), "n".to_string()),
    ];
    draw_legend(canvas, Square { at, side }, &entries);
}

/// Draws the axes of the tip's inertia, as lines through the middle.
fn draw_axes(canvas: &mut Canvas, pixel: &dyn Fn(&[f64]) -> Point, point: &MapPoint, length: f64) {
    for axis in &point.eigenvectors {
        let ends = [-length, length].map(|reach| pixel(&axis.iter().map(|v| reach * v).collect::<Vec<_>>()));
        canvas.line(ends[0], ends[1], Stroke { colour: FAINT_GREY, width: 1.0, dash: "5 4" });
    }
}

fn draw_axis_names(canvas: &mut Canvas, pixel: &dyn Fn(&[f64]) -> Point, point: &MapPoint, length: f64) {
    for (k, axis) in point.eigenvectors.iter().enumerate() {
        let end = pixel(&axis.iter().map(|v| length * v).collect::<Vec<_>>());
        canvas.coloured_text((end.0 + 3.0, end.1 - 3.0), 12.5, Anchor::Start, INK, &format!("e{}", k + 1));
    }
}

/// Draws the coupling as a surface over all directions of space; the distance from the middle is the coupling.
fn draw_surface(canvas: &mut Canvas, Square { at, side }: Square, pose: &TaskPose, point: &MapPoint, n: &DVector<f64>) {
    let joints = pose.jacobian.nrows();
    let (halves, wholes) = SURFACE_DIRECTIONS;
    let reach = |i: usize, j: usize| -> (Vector3<f64>, f64) {
        let down = std::f64::consts::PI * i as f64 / halves as f64;
        let turn = std::f64::consts::TAU * j as f64 / wholes as f64;
        let direction = Vector3::new(down.sin() * turn.cos(), down.cos(), down.sin() * turn.sin());
        let padded = padded_to(joints, direction.as_slice());
        let coupling = effective_inertias(pose, &padded).map_or(0.0, |(w_eff, w_rr)| (w_rr - w_eff).max(0.0));
        (direction * coupling, coupling)
    };
    let grid: Vec<Vec<(Vector3<f64>, f64)>> =
        (0..=halves).map(|i| (0..=wholes).map(|j| reach(i, j)).collect()).collect();
    let largest = grid.iter().flatten().map(|(_, coupling)| *coupling).fold(1e-12, f64::max);
    let ((turn_sine, turn_cosine), (tilt_sine, tilt_cosine)) = (VIEW_ANGLES.0.sin_cos(), VIEW_ANGLES.1.sin_cos());
    // Returns the coordinates to the right, up, and towards the reader.
    let viewed = |v: &Vector3<f64>| {
        let (x, z) = (turn_cosine * v.x + turn_sine * v.z, turn_cosine * v.z - turn_sine * v.x);
        Vector3::new(x, tilt_cosine * v.y - tilt_sine * z, tilt_sine * v.y + tilt_cosine * z)
    };
    let middle = (at.0 + side / 2.0, at.1 + side / 2.0);
    let pixels = 0.42 * side / largest;
    let pixel = |v: &Vector3<f64>| {
        let v = viewed(v);
        (middle.0 + pixels * v.x, middle.1 - pixels * v.y)
    };
    let end = |v: &[f64]| pixel(&Vector3::new(v[0], v[1], v[2]));
    draw_axes(canvas, &end, point, 1.12 * largest);
    let mut tiles = Vec::new();
    for i in 0..halves {
        for j in 0..wholes {
            let corners = [&grid[i][j], &grid[i + 1][j], &grid[i + 1][j + 1], &grid[i][j + 1]];
            let depth: f64 = corners.iter().map(|(v, _)| viewed(v).z).sum();
            let coupling = corners.iter().map(|(_, coupling)| coupling).sum::<f64>() / 4.0;
            tiles.push((depth, corners.map(|(v, _)| pixel(v)), coupling / largest));
        }
    }
    tiles.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, corners, share) in &tiles {
        canvas.polygon(corners, &scale(*share), 0.92);
        canvas.polyline(&[corners[0], corners[1], corners[2]], Stroke::solid("white", 0.3));
    }
    // Draws the names last, because the surface may hide the end of an axis but not its name.
    draw_axis_names(canvas, &end, point, 1.12 * largest);
    let n = Vector3::new(n[0], n[1], n[2]);
    draw_arrow(canvas, pixel(&Vector3::zeros()), pixel(&(n * (1.1 * largest))), BOUND_COLOUR);
    let label = format!("coupling Wrr - Weff, up to {largest:.4} kg; n in purple");
    for (line, text) in wrap(&label, side, SMALL_TEXT).iter().enumerate() {
        let at = (middle.0, at.1 + side + 20.0 + 16.0 * line as f64);
        canvas.text(at, SMALL_TEXT, Anchor::Middle, false, text);
    }
}
