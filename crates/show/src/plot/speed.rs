//! The picture of cost over error: for each mechanism the ways to compute the control step that no other way beats.

use super::Picture;
use super::axes::{Axis, CurveName, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{INK, OFF_COLOUR};
use haptic_bridge::model::device::Device;
use haptic_predict::bench::report::Variant;

/// Number of panels in a row, and distance and size of the frames, pixels.
const COLUMNS: usize = 3;
const GAP: (f64, f64) = (62.0, 84.0);
const SIZE: (f64, f64) = (230.0, 150.0);
const TOP: f64 = 96.0;
/// Errors that the axes show, and the step to which their largest number of instructions is rounded up.
const ERRORS_N: (f64, f64) = (1e-5, 1e3);
const INSTRUCTIONS_STEP: f64 = 400.0;

/// Draws instructions over the error of the force at the tip: one panel for each mechanism, with its Pareto front as
/// steps.
pub fn draw(every: &[(Device<f64>, Vec<Variant>)]) -> Picture {
    let fronts = every.iter().map(|(device, variants)| {
        let mut front: Vec<(f64, f64, String)> = variants
            .iter()
            .filter(|variant| variant.pareto)
            .filter_map(|variant| {
                Some((variant.tip_force_error(), f64::from(variant.instructions?), short_name(&variant.name)))
            })
            .collect();
        front.sort_by(|a, b| a.0.total_cmp(&b.0));
        (device.mechanism.kind().spec().label, front)
    });
    let fronts: Vec<_> = fronts.filter(|(_, front)| !front.is_empty()).collect();
    let costs = fronts.iter().flat_map(|(_, front)| front).map(|(_, instructions, _)| *instructions);
    let most = (costs.fold(0.0, f64::max) / INSTRUCTIONS_STEP).ceil() * INSTRUCTIONS_STEP;
    let rows = fronts.len().div_ceil(COLUMNS) as f64;
    let mut canvas = Canvas::new(24.0 + COLUMNS as f64 * (SIZE.0 + GAP.0), TOP + rows * (SIZE.1 + GAP.1) - 20.0);
    let title = "Speed against error: the ways to compute the control step that no other way beats";
    canvas.text((GAP.0, 28.0), 15.0, Anchor::Start, false, title);
    let about = "Instructions on the Cortex-M4F, over the largest error of the force at the tip: the torque's, and 20 kN/m times the tip's.";
    canvas.text((GAP.0, 50.0), 12.0, Anchor::Start, false, about);
    for (index, (mechanism, front)) in fronts.iter().enumerate() {
        let (column, row) = ((index % COLUMNS) as f64, (index / COLUMNS) as f64);
        let frame = PlotArea {
            at: (GAP.0 + column * (SIZE.0 + GAP.0), TOP + row * (SIZE.1 + GAP.1)),
            size: SIZE,
            x: Axis::logarithmic("error", "N", ERRORS_N.0, ERRORS_N.1),
            y: Axis::new("instructions", "", 0.0, most),
        };
        // Nothing on the front is cheaper at less error: steps, not slopes.
        let mut steps = Vec::new();
        for (error, instructions, _) in front {
            steps.extend(steps.last().map(|(_, before)| (*error, *before)));
            steps.push((*error, *instructions));
        }
        frame.curve(&mut canvas, &steps, Stroke::solid(OFF_COLOUR, 1.2));
        let names = front.iter().map(|(error, instructions, name)| {
            frame.dot(&mut canvas, *error, *instructions, *instructions, *instructions, OFF_COLOUR);
            CurveName { curve: vec![(*error, *instructions)], colour: INK, name: name.clone() }
        });
        let names: Vec<CurveName<'_>> = names.collect();
        let drawn: Vec<_> = names.iter().map(|name| name.curve.clone()).chain([steps]).collect();
        frame.draw(&mut canvas, mechanism);
        frame.name_curves(&mut canvas, &drawn, &names);
    }
    canvas
        .finish(title, "Instructions of the best variants of each mechanism over their error of the force at the tip.")
}

/// Returns the terms of a variant, with its trigonometry if it is not the firmware's.
fn short_name(name: &str) -> String {
    let parts = name.split('/').skip(1).filter(|part| !["table", "exact"].contains(part));
    parts.map(|part| if part == "none" { "no terms" } else { part }).collect::<Vec<_>>().join(", ")
}
