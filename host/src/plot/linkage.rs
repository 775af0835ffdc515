//! A device's links and joints in a frame.

use super::axes::Frame;
use super::canvas::{Canvas, Stroke};
use super::colour::INK;
use crate::skeleton::Skeleton;

/// Draws the linkage as thin bars that stay readable on any ground: base pivots square, tip round.
pub fn outline(canvas: &mut Canvas, frame: &Frame, skeleton: &Skeleton) {
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
        base_pivot(canvas, frame.pixel(base.0, base.1));
    }
    tip(canvas, frame.pixel(skeleton.tip.0, skeleton.tip.1));
}

/// The mark of a pivot that is fixed to the base, at a pixel.
pub fn base_pivot(canvas: &mut Canvas, at: (f64, f64)) {
    canvas.rectangle((at.0 - 4.5, at.1 - 4.5), (9.0, 9.0), INK, Stroke::solid("white", 1.2));
}

/// The mark of the tip, at a pixel.
pub fn tip(canvas: &mut Canvas, at: (f64, f64)) {
    canvas.circle(at, 4.6, "white", Stroke::solid(INK, 1.8));
    canvas.circle(at, 1.6, INK, Stroke::solid(INK, 0.0));
}
