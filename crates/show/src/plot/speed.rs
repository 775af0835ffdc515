//! The picture of speed against error: instructions of each variant of the control step, over its error.

use super::Picture;
use super::axes::{Axis, Mark, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::INK;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::device::Device;
use haptic_predict::bench::report::Variant;

fn colour_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Paddle => "#7f7f7f",
        Kind::FiveBar => "#0072b2",
        Kind::FiveBarTurret => "#d55e00",
        Kind::Parallelogram => "#009e73",
        Kind::Serial3r => "#cc79a7",
    }
}

/// Draws instructions over the error of the force at the tip, with each mechanism's Pareto front as a line.
pub fn draw(every: &[(Device<f64>, Vec<Variant>)]) -> Picture {
    let (low, high) = (-6.0, 4.0);
    let decades = |variant: &Variant| variant.tip_force_error().max(1.0e-12).log10().clamp(low, high);
    let mut canvas = Canvas::new(760.0, 540.0);
    let frame = PlotArea {
        at: (80.0, 110.0),
        size: (660.0, 370.0),
        x: Axis { name: "largest error of the force at the tip, without the fade".into(), unit: "N".into(), low, high },
        y: Axis { name: "instructions".into(), unit: String::new(), low: 0.0, high: 2100.0 },
    };
    let (mut entries, mut drawn) = (Vec::new(), Vec::new());
    frame.draw_clipped(&mut canvas, |canvas| {
        for (device, variants) in every {
            let colour = colour_of(device.mechanism.kind());
            let all: Vec<&Variant> = variants.iter().filter(|variant| variant.instructions.is_some()).collect();
            let mut front: Vec<(f64, f64)> = all
                .iter()
                .filter(|variant| variant.pareto)
                .map(|variant| (decades(variant), f64::from(variant.instructions.unwrap_or(0))))
                .collect();
            front.sort_by(|a, b| a.0.total_cmp(&b.0));
            let stroke = Stroke { colour, width: 1.8, dash: "" };
            frame.curve(canvas, &front, stroke);
            drawn.push(front);
            // A mechanism without a point in the frame gets no legend entry.
            if !all.is_empty() {
                entries.push((Mark::Line(stroke), device.mechanism.kind().spec().name.to_string()));
            }
            for variant in all {
                let y = f64::from(variant.instructions.unwrap_or(0));
                frame.dot(canvas, decades(variant), y, y, y, colour);
                drawn.push(vec![(decades(variant), y)]);
            }
        }
    });
    entries.push((Mark::Circle(INK), "a variant".into()));
    entries.push((Mark::Line(Stroke::solid(INK, 1.8)), "the fastest for their error".into()));
    frame.draw_decades(&mut canvas);
    let title = "Speed against error: every variant of the control step, fronts as lines";
    canvas.text((frame.at.0, 28.0), 15.0, Anchor::Start, false, title);
    for (line, text) in [
        "Instructions on the Cortex-M4F. Error: torque as a force at the tip, plus the tip's error times 20 kN/m;",
        "errors below 10⁻⁶ N are drawn at 10⁻⁶ N. The fading of velocity terms is the same in all, and left out.",
    ]
    .into_iter()
    .enumerate()
    {
        canvas.text((frame.at.0, 48.0 + 16.0 * line as f64), 12.0, Anchor::Start, false, text);
    }
    frame.place_legend(&mut canvas, &drawn, &entries);
    canvas.finish(title, "Instructions of each variant over its largest error of the force at the tip.")
}
