//! Marks of joints: zero, angle or travel with an arrow, limits.

use super::{HALF_LINK_WIDTH, JOINT_COLOURS, LINK_COLOUR};
use crate::plot::axes::PlotArea;
use crate::plot::canvas::{Canvas, Stroke};
use crate::plot::colour::INK;
use haptic_bridge::model::description::Description;
use haptic_stability::skeleton::{Angle, Axis, Point, Skeleton, Slide};
use std::f64::consts::TAU;

/// Largest and smallest radius of an angle's arc, pixels.
const MAX_ARC_RADIUS: f64 = 46.0;
const MIN_ARC_RADIUS: f64 = 14.0;
/// Distance of the arrow of a travel from its rail, pixels.
const TRAVEL_DISTANCE: f64 = 16.0;
/// Distance of the line of the limits from the arrow, pixels.
const LIMITS_DISTANCE: f64 = 7.0;
/// Part of the dashed line beyond the arrow, pixels.
const ZERO_BEYOND: f64 = 16.0;
/// Length of a path below which it has no arrowhead, pixels.
const SHORT_PATH: f64 = 3.0;
const STEPS: i32 = 40;

/// The mark of a joint, in pixels.
pub struct Mark {
    /// The joint's name and its angle or travel.
    pub text: String,
    /// The joint.
    pub at: Point,
    /// Radius of the mark about the joint.
    pub radius: f64,
    /// Colour of the joint.
    pub colour: &'static str,
    /// Dashed line of zero; arrow from zero; line between the limits, empty without limits.
    lines: [Vec<Point>; 3],
}

/// Returns the marks of the joints that a drawing shows.
pub fn joint_marks(frame: &PlotArea, skeleton: &Skeleton, pixels: f64, description: &Description) -> Vec<Mark> {
    let separation = match skeleton.base.as_slice() {
        [a, b] if a != b => 0.46 * pixels * (a.0 - b.0).hypot(a.1 - b.1),
        _ => MAX_ARC_RADIUS,
    };
    let limits = |joint: usize| description.joints[joint].limits;
    let angles = skeleton.angles.iter().map(|angle| {
        let radius = (0.42 * pixels * angle.arm).min(MAX_ARC_RADIUS).min(separation.max(24.0)).max(MIN_ARC_RADIUS);
        angle_mark(frame.pixel(angle.at.0, angle.at.1), radius, angle, limits(angle.joint))
    });
    let slides = skeleton.slides.iter().map(|slide| slide_mark(frame, slide, limits(slide.joint)));
    angles.chain(slides).collect()
}

fn angle_mark(centre: Point, radius: f64, angle: &Angle, limits: Option<(f64, f64)>) -> Mark {
    let on = |radius: f64, q: f64| {
        let direction = angle.zero + angle.sense * q;
        (centre.0 + radius * direction.cos(), centre.1 - radius * direction.sin())
    };
    let along = |from: f64, to: f64, radius: f64| -> Vec<Point> {
        (0..=STEPS).map(|i| on(radius, from + (to - from) * f64::from(i) / f64::from(STEPS))).collect()
    };
    let drawn = angle.angle.rem_euclid(TAU) - if angle.angle < 0.0 { TAU } else { 0.0 };
    let limits = limits.filter(|(low, high)| high - low < TAU);
    Mark {
        text: format!("joint {}: {:.1}°", angle.joint, angle.angle.to_degrees()),
        at: centre,
        radius: radius + LIMITS_DISTANCE + 2.0,
        colour: JOINT_COLOURS[angle.joint % JOINT_COLOURS.len()],
        lines: [
            vec![centre, on(radius + ZERO_BEYOND, 0.0)],
            along(0.0, drawn, radius),
            limits.map_or(Vec::new(), |(low, high)| along(low, high, radius + LIMITS_DISTANCE)),
        ],
    }
}

fn slide_mark(frame: &PlotArea, slide: &Slide, limits: Option<(f64, f64)>) -> Mark {
    let (ux, uy) = slide.along;
    let on = |travel: f64, beside: f64| {
        let (x, y) = slide.place(travel);
        let (x, y) = frame.pixel(x, y);
        (x + beside * uy, y + beside * ux)
    };
    let far = TRAVEL_DISTANCE + LIMITS_DISTANCE;
    Mark {
        text: format!("joint {}: {:.1} mm", slide.joint, 1e3 * slide.travel),
        at: on(slide.travel, 0.0),
        radius: far + 2.0,
        colour: JOINT_COLOURS[slide.joint % JOINT_COLOURS.len()],
        lines: [
            vec![on(0.0, 0.0), on(0.0, far + ZERO_BEYOND)],
            vec![on(0.0, TRAVEL_DISTANCE), on(slide.travel, TRAVEL_DISTANCE)],
            limits.map_or(Vec::new(), |(low, high)| vec![on(low, far), on(high, far)]),
        ],
    }
}

impl Mark {
    /// Returns the mark's lines.
    pub fn lines(&self) -> impl Iterator<Item = &Vec<Point>> {
        self.lines.iter().filter(|line| line.len() > 1)
    }

    pub fn draw(&self, canvas: &mut Canvas) {
        let [zero, path, limits] = &self.lines;
        let colour = self.colour;
        canvas.polyline(zero, Stroke { colour, width: 1.2, dash: "4 3" });
        canvas.polyline(path, Stroke::solid(colour, 1.8));
        for barb in arrowhead(path) {
            canvas.line(barb[0], barb[1], Stroke::solid(colour, 1.8));
        }
        if !limits.is_empty() {
            canvas.polyline(limits, Stroke { colour, width: 1.2, dash: "1.5 2.5" });
        }
    }
}

/// Returns the two lines of an arrowhead at the end of a path; none for a short path.
fn arrowhead(path: &[Point]) -> Vec<[Point; 2]> {
    let length: f64 = path.windows(2).map(|ends| (ends[1].0 - ends[0].0).hypot(ends[1].1 - ends[0].1)).sum();
    let Some(&end) = path.last().filter(|_| length > SHORT_PATH) else { return Vec::new() };
    let head = (0.6 * length).min(9.0);
    let distance = |from: &Point| (end.0 - from.0).hypot(end.1 - from.1);
    let Some(from) = path.iter().rev().find(|from| distance(from) >= head.min(0.5 * length)) else { return Vec::new() };
    let far = distance(from);
    let (ux, uy) = ((end.0 - from.0) / far, (end.1 - from.1) / far);
    let barb = |side: f64| (end.0 - head * ux + side * head * uy, end.1 - head * uy - side * head * ux);
    [-0.45, 0.45].map(|side| [end, barb(side)]).to_vec()
}

/// Returns the line of an axis across the frame.
pub fn axis_line(frame: &PlotArea, axis: &Axis) -> [Point; 2] {
    let at = frame.pixel(axis.at.0, axis.at.1);
    let (ux, uy) = (axis.along.0, -axis.along.1);
    // Distances along the axis at which it enters and leaves the frame.
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for (at, unit, edge, size) in [(at.0, ux, frame.at.0, frame.size.0), (at.1, uy, frame.at.1, frame.size.1)] {
        if unit.abs() > 1e-9 {
            let ends = [(edge - at) / unit, (edge + size - at) / unit];
            low = low.max(ends[0].min(ends[1]));
            high = high.min(ends[0].max(ends[1]));
        }
    }
    [low, high].map(|far| (at.0 + far * ux, at.1 + far * uy))
}

/// Draws the carriage of a prismatic joint on its rail.
pub fn draw_carriage(canvas: &mut Canvas, frame: &PlotArea, slide: &Slide) {
    let (x, y) = slide.place(slide.travel);
    let (x, y) = frame.pixel(x, y);
    let (ux, uy) = (slide.along.0, -slide.along.1);
    for (half, width, colour) in [(9.0, 4.0 * HALF_LINK_WIDTH, INK), (8.0, 4.0 * HALF_LINK_WIDTH - 2.0, LINK_COLOUR)] {
        let ends = [(x - half * ux, y - half * uy), (x + half * ux, y + half * uy)];
        canvas.polyline(&ends, Stroke::solid(colour, width));
    }
}
