//! The crossing as a picture: position, force and duty over time, without and with the feed-forward.

use super::Demo;
use super::crossing::{Crossing, Moment};
use crate::plot::Picture;
use crate::plot::axes::{Axis, Frame, Mark};
use crate::plot::canvas::{Anchor, Canvas, Stroke};
use crate::plot::colour::{FAINT, OFF, WASHOUT};

const WIDTH: f64 = 920.0;
const LEFT: f64 = 92.0;
const RIGHT: f64 = 28.0;
const TOP: f64 = 112.0;
const PANEL: f64 = 178.0;
const GAP: f64 = 74.0;

/// What one panel shows.
struct Panel {
    title: &'static str,
    axis: &'static str,
    unit: &'static str,
    value: fn(&Moment) -> f64,
    low: f64,
    high: f64,
}

/// Draws both crossings.
pub fn draw(demo: &Demo, without: &Crossing, with: &Crossing) -> Picture {
    let both = || without.moments.iter().chain(&with.moments);
    let top = |value: fn(&Moment) -> f64| both().map(value).fold(0.0, f64::max);
    let depth = both().map(|moment| moment.distance).fold(0.0, f64::min);
    let panels = [
        Panel {
            title: "Position: distance of the tip from the wall (shaded: inside)",
            axis: "distance",
            unit: "m",
            value: |moment| moment.distance,
            low: 1.6 * depth,
            high: (-4.0 * depth).max(2.1e-3),
        },
        Panel {
            title: "Force of the wall",
            axis: "force",
            unit: "N",
            value: |moment| moment.force,
            low: 0.0,
            high: 1.08 * top(|moment| moment.force),
        },
        Panel {
            title: "Duty of the harder working motor",
            axis: "duty",
            unit: "",
            value: |moment| moment.duty,
            low: 0.0,
            high: 1.08 * top(|moment| moment.duty),
        },
    ];
    let height = TOP + 3.0 * PANEL + 2.0 * GAP + 62.0;
    let mut canvas = Canvas::new(WIDTH, height);
    canvas.text((LEFT, 34.0), 19.0, Anchor::Start, false, "A hand presses onto a wall and slides along it");
    let about = format!(
        "wall of {:.0} kN/m and {:.0} N s/m, control at {:.0} kHz, the same hand and tremor twice",
        demo.stiffness / 1000.0,
        demo.damping,
        demo.rate_hz / 1000.0
    );
    canvas.text((LEFT, 58.0), 12.5, Anchor::Start, false, &about);
    let entries = [
        (Mark::Line(Stroke::solid(OFF, 1.6)), "without feed-forward".to_string()),
        (Mark::Line(Stroke::solid(WASHOUT, 1.6)), format!("with feed-forward (washout {} Hz)", demo.washout_hz)),
    ];
    Frame::legend(&mut canvas, WIDTH - RIGHT, 22.0, &entries);

    let end = both().map(|moment| moment.time).fold(0.1, f64::max);
    for (index, panel) in panels.iter().enumerate() {
        let axis = |name: &str, unit: &str, low, high| Axis { name: name.into(), unit: unit.into(), low, high };
        let frame = Frame {
            at: (LEFT, TOP + index as f64 * (PANEL + GAP)),
            size: (WIDTH - LEFT - RIGHT, PANEL),
            x: axis("time", "s", 0.0, end),
            y: axis(panel.axis, panel.unit, panel.low, panel.high),
        };
        if panel.low < 0.0 {
            let inside = [(0.0, panel.low), (end, panel.low), (end, 0.0), (0.0, 0.0)];
            let corners = inside.map(|(x, y)| frame.pixel(x, y));
            canvas.polygon(&corners, FAINT, 0.22);
        }
        frame.clipped(&mut canvas, |canvas| {
            for (crossing, colour) in [(without, OFF), (with, WASHOUT)] {
                let points: Vec<(f64, f64)> =
                    crossing.moments.iter().map(|moment| (moment.time, (panel.value)(moment))).collect();
                frame.curve(canvas, &points, Stroke::solid(colour, 1.1));
            }
        });
        frame.draw(&mut canvas, panel.title);
    }
    let description = format!(
        "Penetration {:.2} mm without and {:.2} mm with feed-forward; ripple of the force {:.2} N and {:.2} N rms.",
        1e3 * without.penetration,
        1e3 * with.penetration,
        without.ripple,
        with.ripple
    );
    canvas
        .finish("Position, force and duty while a hand crosses a wall, without and with the feed-forward", &description)
}
