//! Draws a device's links and joints in a frame.

use super::axes::PlotArea;
use super::canvas::{Canvas, Stroke};
use super::colour::INK;
use haptic_stability::skeleton::{Point, Skeleton, Slide};

/// Draws the linkage as thin bars that stay readable on any background, with square base pivots and a round tip. Rails
/// are dashed.
pub fn draw_linkage(canvas: &mut Canvas, frame: &PlotArea, skeleton: &Skeleton) {
    for rail in skeleton.slides.iter().map(Slide::rail) {
        let ends = rail.map(|p| frame.pixel(p.0, p.1));
        canvas.polyline(&ends, Stroke { colour: INK, width: 1.2, dash: "4 3" });
    }
    for (colour, width) in [("white", 4.6), (INK, 1.8)] {
        for bar in &skeleton.bars {
            let ends = [bar.from, bar.to].map(|p| frame.pixel(p.0, p.1));
            canvas.polyline(&ends, Stroke::solid(colour, width));
        }
    }
    for bar in &skeleton.bars {
        canvas.circle(frame.pixel(bar.from.0, bar.from.1), 2.6, "white", Stroke::solid(INK, 1.4));
    }
    for base in &skeleton.base {
        draw_base_pivot(canvas, frame.pixel(base.0, base.1));
    }
    draw_tip(canvas, frame.pixel(skeleton.tip.0, skeleton.tip.1));
}

/// Draws the mark of a pivot that is fixed to the base, at a pixel.
pub fn draw_base_pivot(canvas: &mut Canvas, at: (f64, f64)) {
    canvas.rectangle((at.0 - 4.5, at.1 - 4.5), (9.0, 9.0), INK, Stroke::solid("white", 1.2));
}

/// Draws the mark of the tip, at a pixel.
pub fn draw_tip(canvas: &mut Canvas, at: (f64, f64)) {
    canvas.circle(at, 4.6, "white", Stroke::solid(INK, 1.8));
    canvas.circle(at, 1.6, INK, Stroke::solid(INK, 0.0));
}

/// Returns the lower and the upper corner of a box around points, with a margin of 5 %.
pub fn bounding_box(points: impl Iterator<Item = Point>) -> (Point, Point) {
    let empty = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    let (low, high) = points.fold(empty, |(l, h), p| ((l.0.min(p.0), l.1.min(p.1)), (h.0.max(p.0), h.1.max(p.1))));
    let margin = 0.05 * (high.0 - low.0).max(high.1 - low.1);
    if !margin.is_finite() || margin <= 0.0 {
        return ((-1.0, -1.0), (1.0, 1.0));
    }
    ((low.0 - margin, low.1 - margin), (high.0 + margin, high.1 + margin))
}
