//! The paper's Fig. 1 for any device and pose: the tip's motion after a push along a normal, and the inertia and its
//! coupling in every direction, with the axes of the tip's inertia.
//!
//! In the plane the coupling is drawn as a curve over directions, in space as a surface. With as many joints as task
//! directions the coupling vanishes along the axes and is largest between the first and the last axis.

use super::axes::{Axis, CurveName, PlotArea};
use super::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use super::colour::{BOUND_COLOUR, FAINT_GREY, FULL_COLOUR, INK, OFF_COLOUR, WASHOUT_COLOUR, scale};
use super::paper::{EDGE_MARGIN, Paper};
use super::{Picture, linkage};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_host::vectors::padded_to;
use haptic_host::words::{joint_units, with_unit};
use haptic_stability::analysis::map::{MapPoint, effective_inertias, map_point_at};
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::{PoseError, TaskPose, unit_normal};
use haptic_stability::skeleton::{Point, Skeleton, skeleton};
use nalgebra::{DVector, Vector3};

/// Width of both drawings with the room around them on a screen, pixels.
const SCREEN_WIDTH: f64 = 790.0;
/// Distance by which the push moves the tip without the feed-forward, as a share of the drawing.
const MOTION_SHARE: f64 = 0.3;
/// Number of dots on a path, and time between two dots, ms.
const DOTS: usize = 6;
const DOT_MS: usize = 5;
/// Number of directions in which a surface is sampled, around a half turn and around a full turn.
const SURFACE_DIRECTIONS: (usize, usize) = (24, 48);
/// Viewing direction of a surface: turned about its vertical and then tilted, rad.
const VIEW_ANGLES: (f64, f64) = (-0.6, 0.45);

/// Draws a device at `q` (rad) with its motion along `normal`; `None` if its linkage does not close or the pose is
/// singular.
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
    let title = format!("{name}: a push along n, and the inertia in every direction");
    let list = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    let unit = joint_units(&description.units(), |joint| joint.travel);
    let pose_line = format!("q = ({}) {unit}, n = ({})", list(q), list(&n.as_slice()[..spec.task]));
    let page = paper.page(SCREEN_WIDTH, EDGE_MARGIN);
    let heading = page.heading(&title, &[pose_line]);
    let side = (page.wide - 3.0 * EDGE_MARGIN) / 2.0;
    let top = 66.0 + heading.extra_height(1);
    let [first, second] = [EDGE_MARGIN, 2.0 * EDGE_MARGIN + side].map(|left| Square { at: (left, top), side });
    let lines = [
        format!(
            "Left: the tip after a push along n, a dot every {DOT_MS} ms. Right: inertia that a wall meets, by its normal."
        ),
        format!(
            "Along n a wall meets Weff = {:.4} kg without the feed-forward and Wrr = {:.4} kg with it: {:.3} times as much.",
            point.w_eff,
            point.w_rr,
            point.w_rr / point.w_eff
        ),
        match spec.task {
            1 => "One task direction: there is no coupling.".into(),
            _ => format!(
                "Maximum at n = ({}): {:.3} times. Axes of the tip's inertia: {} kg.",
                list(&point.worst_ratio.normal),
                point.worst_ratio.value,
                point.eigenvalues.iter().map(|v| format!("{v:.4}")).collect::<Vec<_>>().join(", ")
            ),
        },
    ];
    let notes = page.notes(lines.iter().map(String::as_str));
    let bottom = top + side + if paper.is_printed() { 6.0 } else { 26.0 };
    let mut canvas = page.canvas(bottom + notes.height());
    heading.draw(&mut canvas);
    draw_motion(&mut canvas, description, q, &here, &device, first);
    match spec.task {
        1 => {}
        2 => draw_mass_curves(&mut canvas, second, &pose, &point, &n),
        _ => draw_surface(&mut canvas, second, &pose, &point, &n),
    }
    notes.draw(&mut canvas, bottom);
    Ok(Some(canvas.finish(&title, "The tip's motion after a push, and the coupling Wrr - Weff by direction.")))
}

/// The square of a drawing: its upper left corner, and its side, pixels.
#[derive(Clone, Copy)]
struct Square {
    at: Point,
    side: f64,
}

impl Square {
    /// Returns a frame for values at most `half` from `middle`, in this unit.
    fn plot_area_around(self, middle: Point, half: f64, unit: &str) -> PlotArea {
        let axis = |middle: f64| Axis::new("", unit, middle - half, middle + half);
        PlotArea { at: self.at, size: (self.side, self.side), x: axis(middle.0), y: axis(middle.1) }
    }
}

/// Returns the tip's displacement for a small joint motion, per unit of motion.
fn tip_displacement(description: &Description, q: &[f64], here: &Skeleton, motion: &DVector<f64>) -> Option<Point> {
    let size = 1e-5 / motion.amax().max(1e-12);
    let moved: Vec<f64> = q.iter().zip(motion.iter()).map(|(q, m)| q + size * m).collect();
    let there = skeleton(description, &moved)?;
    Some(((there.tip.0 - here.tip.0) / size, (there.tip.1 - here.tip.1) / size))
}

/// Draws the device, and the tip's paths after a push along n: without the feed-forward and with it.
fn draw_motion(
    canvas: &mut Canvas,
    description: &Description,
    q: &[f64],
    here: &Skeleton,
    device: &Linearised,
    place: Square,
) {
    let points = here.bars.iter().flat_map(|bar| [bar.from, bar.to]).chain(here.base.iter().copied());
    let (low, high) = linkage::bounding_box(points);
    let middle = ((low.0 + high.0) / 2.0, (low.1 + high.1) / 2.0);
    let half = 0.68 * (high.0 - low.0).max(high.1 - low.1);
    let frame = place.plot_area_around(middle, half, "m");
    linkage::draw_linkage(canvas, &frame, here);
    // Joint motion per metre of the tip along n: constrained, and free, which is the motion that Jᵀ causes.
    let held = device.unit_motion.clone();
    let (w_rr, w_eff) = (device.w_rr(), device.w_eff().unwrap_or_else(|| device.w_rr()));
    let free =
        device.mass.clone().cholesky().map(|mass| w_eff * mass.solve(&device.row)).unwrap_or_else(|| held.clone());
    let mut names = Vec::new();
    for (motion, inertia, colour, name) in
        [(&free, w_eff, OFF_COLOUR, "without"), (&held, w_rr, FULL_COLOUR, "with feed-forward")]
    {
        let Some(along) = tip_displacement(description, q, here, motion) else { continue };
        // The distance grows with the square of time, and with the reciprocal of the inertia.
        let at = |dot: usize| {
            let far = 2.0 * half * MOTION_SHARE * (w_eff / inertia) * (dot as f64 / DOTS as f64).powi(2);
            (here.tip.0 + far * along.0, here.tip.1 + far * along.1)
        };
        let path: Vec<Point> = (0..=DOTS).map(at).collect();
        frame.curve(canvas, &path, Stroke::solid(colour, 1.2));
        for dot in &path[1..] {
            canvas.circle(frame.pixel(dot.0, dot.1), 2.0, colour, Stroke::solid(colour, 0.0));
        }
        names.push(CurveName { curve: path, colour, name: name.into() });
    }
    let bars = here.bars.iter().map(|bar| vec![bar.from, bar.to]);
    let drawn: Vec<Vec<Point>> = bars.chain(names.iter().map(|name| name.curve.clone())).collect();
    frame.name_curves(canvas, &drawn, &names);
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
fn draw_mass_curves(canvas: &mut Canvas, place: Square, pose: &TaskPose, point: &MapPoint, n: &DVector<f64>) {
    let joints = pose.jacobian.nrows();
    let around = |i: i32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 180.0).sin_cos();
        let mut direction = DVector::zeros(joints);
        (direction[0], direction[1]) = (cos, sin);
        effective_inertias(pose, &direction).map(|(w_eff, w_rr)| ((cos, sin), w_eff, w_rr))
    };
    let samples: Vec<(Point, f64, f64)> = (0..=180).filter_map(around).collect();
    let largest = samples.iter().map(|(_, _, w_rr)| *w_rr).fold(0.0, f64::max);
    let frame = place.plot_area_around((0.0, 0.0), 1.25 * largest, "kg");
    let polar = |value: fn(&(Point, f64, f64)) -> f64| -> Vec<Point> {
        samples.iter().map(|sample| (value(sample) * sample.0.0, value(sample) * sample.0.1)).collect()
    };
    let ring = round_mass(largest / 2.0);
    let curves = [
        (polar(|(_, w_eff, w_rr)| (w_rr - w_eff).max(0.0)), WASHOUT_COLOUR, "coupling".to_string()),
        (polar(|sample| sample.1), OFF_COLOUR, "Weff".into()),
        (polar(|sample| sample.2), FULL_COLOUR, "Wrr".into()),
        (samples.iter().map(|(at, ..)| (ring * at.0, ring * at.1)).collect(), FAINT_GREY, with_unit(ring, "kg")),
    ];
    let pixel = |v: &[f64]| frame.pixel(v[0], v[1]);
    draw_axes(canvas, &pixel, point, 1.08 * largest);
    draw_axis_names(canvas, &pixel, point, 1.16 * largest);
    for (points, colour, _) in &curves {
        let draw_linkage: Vec<Point> = points.iter().map(|p| frame.pixel(p.0, p.1)).collect();
        canvas.polygon(&draw_linkage, colour, if *colour == FAINT_GREY { 0.0 } else { 0.18 });
        frame.curve(canvas, points, Stroke::solid(colour, if *colour == FAINT_GREY { 0.7 } else { 1.6 }));
    }
    let tip = pixel(&[largest * n[0], largest * n[1]]);
    draw_arrow(canvas, frame.pixel(0.0, 0.0), tip, BOUND_COLOUR);
    canvas.coloured_text((tip.0 + 5.0, tip.1 + 12.0), 12.5, Anchor::Start, BOUND_COLOUR, "n");
    let names = curves.map(|(curve, colour, name)| CurveName { curve, colour, name });
    let ends = [[0.0, 0.0], [largest * n[0], largest * n[1]]].map(|end| (end[0], end[1]));
    let drawn: Vec<Vec<Point>> = names.iter().map(|name| name.curve.clone()).chain([ends.to_vec()]).collect();
    frame.name_curves(canvas, &drawn, &names);
}

/// Returns the largest of 1, 2, 5 times a power of ten that is at most `most`.
fn round_mass(most: f64) -> f64 {
    let power = 10f64.powf(most.log10().floor());
    [5.0, 2.0, 1.0].map(|step| step * power).into_iter().find(|mass| *mass <= most * (1.0 + 1e-9)).unwrap_or(most)
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
        canvas.coloured_text((end.0, end.1 + 4.0), 12.5, Anchor::Middle, INK, &format!("e{}", k + 1));
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
    canvas.text(
        (middle.0, at.1 + side),
        SMALL_TEXT,
        Anchor::Middle,
        false,
        &format!("coupling, up to {}", with_unit(largest, "kg")),
    );
}
