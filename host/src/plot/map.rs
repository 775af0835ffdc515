//! The picture of a map, after the paper's Fig. 1: coupling as colour over the plane of the linkage, with the ellipses
//! of the operational-space inertia Λ.
//!
//! The colour is the coupling's share of the rendered inertia, (Wrr - Weff)/Wrr: it lies between 0 and 1 everywhere,
//! where the coupling itself grows without bound towards singularities. Ellipse axes are square roots of Λ's
//! eigenvalues, for the same reason.
//!
//! A device that leaves the plane is cut at joint 0 = 0, where its plane is the task's x-y plane; the redundant arm is
//! cut at the home angle of its last joint.

use haptic_bridge::model::description::Description;

use super::Picture;
use super::axes::{Axis, Frame};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{INK, scale};
use crate::analysis::map::{MapPoint, Reachable, at};
use crate::analysis::pose::{PoseError, unit_normal};

/// Grid angles per joint of the drawn cut.
const FINE: usize = 90;

/// Corners of one drawn cell with their values.
struct Cell {
    corners: [(f64, f64); 4],
    value: f64,
}

/// Draws the map of a device for one normal.
pub fn draw(description: &Description, name: &str, normal: &[f64]) -> Result<Picture, PoseError> {
    let spec = description.kind.spec();
    let n = unit_normal(normal, spec.task, spec.joints)?;
    let home = description.home.unwrap_or_default();
    let held = match (spec.joints, spec.task) {
        (3, 3) => Some((0, 0.0)),
        (3, _) => Some((2, home[2])),
        _ => None,
    };
    let reachable = Reachable::from_home(description, FINE, held)?;
    let mut points: Vec<Option<MapPoint>> = vec![None; reachable.axes.iter().map(Vec::len).product()];
    for index in reachable.indices() {
        points[index] = at(description, &reachable.angles(index), &n)?;
    }
    if spec.joints == 1 {
        return Ok(line_picture(name, &points));
    }
    let swept: Vec<usize> = reachable.axes.iter().map(Vec::len).filter(|&length| length > 1).collect();
    let cells = cells(&points, swept.first().copied().unwrap_or(1), swept.get(1).copied().unwrap_or(1));
    Ok(plane_picture(name, normal, held, &points, &cells))
}

fn place(point: &MapPoint) -> (f64, f64) {
    (point.position[0], point.position.get(1).copied().unwrap_or(0.0))
}

/// Quadrilaterals between four reached neighbours; the grid may close on itself in both directions, which costs nothing
/// here.
fn cells(points: &[Option<MapPoint>], rows: usize, columns: usize) -> Vec<Cell> {
    let get = |i: usize, j: usize| points.get((i % rows) * columns + j % columns).and_then(Option::as_ref);
    let mut cells = Vec::new();
    for i in 0..rows {
        for j in 0..columns {
            let (Some(a), Some(b), Some(c), Some(d)) = (get(i, j), get(i + 1, j), get(i + 1, j + 1), get(i, j + 1))
            else {
                continue;
            };
            let corners = [place(a), place(b), place(c), place(d)];
            let value = [a, b, c, d].iter().map(|p| p.coupling / p.w_rr).sum::<f64>() / 4.0;
            cells.push(Cell { corners, value });
        }
    }
    cells
}

fn plane_picture(
    name: &str,
    normal: &[f64],
    held: Option<(usize, f64)>,
    points: &[Option<MapPoint>],
    cells: &[Cell],
) -> Picture {
    let all = || cells.iter().flat_map(|c| c.corners);
    let bounds = |pick: fn((f64, f64)) -> f64| {
        let (low, high) = all().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low < high { (low, high) } else { (-1.0, 1.0) }
    };
    let ((x0, x1), (y0, y1)) = (bounds(|p| p.0), bounds(|p| p.1));
    let span = (x1 - x0).max(y1 - y0) * 1.06;
    let side = 470.0;
    let centred = |low: f64, high: f64| ((low + high - span) / 2.0, (low + high + span) / 2.0);
    let (xs, ys) = (centred(x0, x1), centred(y0, y1));
    let mut canvas = Canvas::new(690.0, 610.0);
    let frame = Frame {
        at: (86.0, 76.0),
        size: (side, side),
        x: Axis { name: "x".into(), unit: "m".into(), low: xs.0, high: xs.1 },
        y: Axis { name: "y".into(), unit: "m".into(), low: ys.0, high: ys.1 },
    };
    let top = cells.iter().map(|c| c.value).fold(0.0_f64, f64::max).max(1e-3);
    frame.clipped(&mut canvas, |canvas| {
        for cell in cells {
            let corners: Vec<(f64, f64)> = cell.corners.iter().map(|&(x, y)| frame.pixel(x, y)).collect();
            canvas.cell(&corners, &scale(cell.value / top));
        }
        ellipses(canvas, &frame, points, span);
    });
    let title = format!("{name}: coupling and inertia ellipses");
    frame.draw(&mut canvas, "");
    canvas.text((86.0, 28.0), 15.0, Anchor::Start, false, &title);
    let cut = match held {
        Some((joint, angle)) => format!(", cut at joint {joint} = {angle:.3} rad"),
        None => String::new(),
    };
    let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
    let n = normal.iter().map(|v| format!("{:.3}", v / length)).collect::<Vec<_>>().join(", ");
    canvas.text((86.0, 50.0), 12.0, Anchor::Start, false, &format!("n = ({n}){cut}; ellipse axes ∝ √eigenvalues of Λ"));
    arrow(&mut canvas, &frame, normal);
    colour_bar(&mut canvas, &frame, top);
    canvas.finish(&title, "Coupling between rendered and admissible motion over the reachable workspace.")
}

/// Ellipses at poses that keep clear of one another, all to one scale.
fn ellipses(canvas: &mut Canvas, frame: &Frame, points: &[Option<MapPoint>], span: f64) {
    let spacing = span / 9.0;
    let mut sizes: Vec<f64> = points.iter().flatten().filter_map(|p| p.eigenvalues.last().copied()).collect();
    sizes.sort_by(f64::total_cmp);
    let Some(&typical) = sizes.get(sizes.len() / 2) else { return };
    let mut chosen: Vec<&MapPoint> = Vec::new();
    // Towards a singularity an ellipse is a needle that hides its neighbours.
    for point in points.iter().flatten().filter(|p| p.eigenvalues.last().is_some_and(|&l| l < 3.0 * typical)) {
        let (x, y) = place(point);
        if chosen.iter().all(|other| (place(other).0 - x).hypot(place(other).1 - y) >= spacing) {
            chosen.push(point);
        }
    }
    for point in chosen {
        let (x, y) = place(point);
        let outline: Vec<(f64, f64)> = (0..=48)
            .map(|i| {
                let angle = f64::from(i) * std::f64::consts::TAU / 48.0;
                // Projected onto the plane: the ellipsoid's outline for devices in space is drawn by its in-plane axes.
                let unit = [angle.cos(), angle.sin()];
                let mut offset = (0.0, 0.0);
                for (value, vector) in point.eigenvalues.iter().zip(&point.eigenvectors) {
                    let along = unit[0] * vector[0] + unit[1] * vector.get(1).copied().unwrap_or(0.0);
                    let reach = 0.36 * spacing * (value / typical).sqrt() * along;
                    offset.0 += reach * vector[0];
                    offset.1 += reach * vector.get(1).copied().unwrap_or(0.0);
                }
                frame.pixel(x + offset.0, y + offset.1)
            })
            .collect();
        canvas.polyline(&outline, Stroke::solid("white", 2.4));
        canvas.polyline(&outline, Stroke::solid(INK, 1.0));
    }
}

/// The wall's normal, in the frame's corner.
fn arrow(canvas: &mut Canvas, frame: &Frame, normal: &[f64]) {
    let (nx, ny) = (normal[0], normal.get(1).copied().unwrap_or(0.0));
    let length = nx.hypot(ny);
    if length < 1e-9 {
        return;
    }
    let (ux, uy) = (nx / length, -ny / length);
    let from = (frame.at.0 + 40.0 - 17.0 * ux, frame.at.1 + 40.0 - 17.0 * uy);
    let to = (from.0 + 34.0 * ux, from.1 + 34.0 * uy);
    canvas.line(from, to, Stroke::solid(INK, 1.8));
    for side in [-1.0, 1.0] {
        let back = (to.0 - 9.0 * ux + side * 5.0 * uy, to.1 - 9.0 * uy - side * 5.0 * ux);
        canvas.line(to, back, Stroke::solid(INK, 1.8));
    }
    canvas.text((to.0 + 8.0 * ux + 8.0 * uy.abs(), to.1 + 8.0 * uy + 4.0), 13.0, Anchor::Middle, false, "n");
}

fn colour_bar(canvas: &mut Canvas, frame: &Frame, top: f64) {
    let left = frame.at.0 + frame.size.0 + 22.0;
    let height = frame.size.1;
    let steps = 120;
    for i in 0..steps {
        let share = f64::from(i) / f64::from(steps - 1);
        let y = frame.at.1 + height * (1.0 - f64::from(i + 1) / f64::from(steps));
        let fill = scale(share);
        canvas.rectangle((left, y), (16.0, height / f64::from(steps) + 0.6), &fill, Stroke::solid(&fill, 0.0));
    }
    canvas.rectangle((left, frame.at.1), (16.0, height), "none", Stroke::solid(INK, 1.0));
    for i in 0..=4 {
        let share = f64::from(i) / 4.0;
        let y = frame.at.1 + height * (1.0 - share);
        canvas.line((left + 16.0, y), (left + 20.0, y), Stroke::solid(INK, 1.0));
        canvas.text((left + 24.0, y + 4.0), 11.5, Anchor::Start, false, &format!("{:.1} %", 100.0 * top * share));
    }
    let middle = frame.at.1 + height / 2.0;
    canvas.text((left + 84.0, middle), 12.5, Anchor::Middle, true, "coupling (Wrr - Weff)/Wrr");
}

/// A paddle has one coordinate: its inertia over it.
fn line_picture(name: &str, points: &[Option<MapPoint>]) -> Picture {
    let curve: Vec<(f64, f64)> = points.iter().flatten().map(|p| (p.position[0], p.w_eff)).collect();
    let ends = |pick: fn(&(f64, f64)) -> f64| {
        curve.iter().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
    };
    let (x0, x1) = ends(|p| p.0);
    let (_, top) = ends(|p| p.1);
    let mut canvas = Canvas::new(620.0, 360.0);
    let frame = Frame {
        at: (86.0, 50.0),
        size: (500.0, 240.0),
        x: Axis { name: "position x".into(), unit: "m".into(), low: x0, high: x1 },
        y: Axis { name: "inertia Weff = Wrr".into(), unit: "kg".into(), low: 0.0, high: top * 1.2 },
    };
    frame.draw(&mut canvas, "");
    frame.curve(&mut canvas, &curve, Stroke::solid(INK, 2.0));
    let title = format!("{name}: one direction, nothing to couple");
    canvas.text((86.0, 28.0), 15.0, Anchor::Start, false, &title);
    canvas.finish(&title, "Inertia over the position of a device with one joint.")
}
