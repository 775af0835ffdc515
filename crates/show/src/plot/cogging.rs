//! The picture of a motor's cogging: torque over the joint's angle, measured and after compensation.

use super::Picture;
use super::axes::{Axis, PlotArea};
use super::canvas::{Anchor, SMALL_TEXT, Stroke};
use super::colour::{FULL_COLOUR, OFF_COLOUR};
use super::paper::Paper;
use haptic_bridge::model::units::JointUnits;
use haptic_predict::cogging::Learnt;

/// Width of the page, left edge, height of a frame and distance of frames, pixels.
const WIDTH: f64 = 760.0;
const LEFT: f64 = 84.0;
const HEIGHT: f64 = 190.0;
const GAP: f64 = 84.0;

/// Draws the joints, each with its number and units.
pub fn draw(title: &str, joints: &[(usize, &JointUnits, &Learnt)], paper: Paper) -> Picture {
    let page = paper.page(WIDTH, LEFT);
    let under = ["torque that cancels the magnets', and what the compensation is expected to leave".to_string()];
    let heading = page.heading(title, &under);
    let top = 92.0 + heading.extra_height(1);
    let high = if paper.is_printed() { 0.5 * HEIGHT } else { HEIGHT };
    let mut canvas = page.canvas(top + joints.len() as f64 * (high + GAP) - 24.0);
    heading.draw(&mut canvas);
    for (place, (joint, units, learnt)) in joints.iter().enumerate() {
        let most = learnt.points.iter().fold(f64::MIN_POSITIVE, |most, (_, torque, _)| most.max(torque.abs()));
        let ends = (learnt.points.first(), learnt.points.last());
        let (Some((low, ..)), Some((last, ..))) = ends else { continue };
        let frame = PlotArea {
            at: (page.left, top + place as f64 * (high + GAP)),
            size: (page.wide - page.left - 24.0, high),
            x: Axis::new("joint angle", units.travel, *low, *last),
            y: Axis::new("torque", units.torque, -1.1 * most, 1.1 * most),
        };
        let curve = |value: fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
            learnt.points.iter().map(|(q, measured, fitted)| (*q, value(*measured, *fitted))).collect()
        };
        let curves = [
            (curve(|measured, _| measured), OFF_COLOUR, "measured"),
            (curve(|measured, fitted| measured - fitted), FULL_COLOUR, "after compensation"),
        ];
        frame.draw(&mut canvas, &format!("joint {joint}"));
        frame.draw_clipped(&mut canvas, |canvas| {
            curves.iter().for_each(|(curve, colour, _)| frame.curve(canvas, curve, Stroke::solid(colour, 1.2)));
        });
        let (mut x, y) = (frame.at.0 + frame.size.0, frame.at.1 - 10.0);
        for (_, colour, name) in curves.iter().rev() {
            canvas.coloured_text((x, y), SMALL_TEXT, Anchor::End, colour, name);
            x -= 0.62 * SMALL_TEXT * name.len() as f64 + 16.0;
        }
    }
    canvas.finish(title, "Cogging torque over the joint's angle, before and after compensation.")
}
