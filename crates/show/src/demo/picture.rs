//! The picture of the crossing: distance and force over time, without and with the feed-forward.

use super::Demo;
use super::comparison::Comparison;
use super::crossing::{Crossing, Moment};
use crate::plot::Picture;
use crate::plot::axes::{Axis, PlotArea};
use crate::plot::canvas::{Anchor, Canvas, Stroke};
use crate::plot::colour::{FAINT_GREY, INK, OFF_COLOUR, WASHOUT_COLOUR};
use crate::plot::linkage;
use haptic_stability::skeleton::skeleton;

const PICTURE_WIDTH: f64 = 1000.0;
const LEFT_MARGIN: f64 = 80.0;
const RIGHT_MARGIN: f64 = 24.0;
const TOP_MARGIN: f64 = 176.0;
const PANEL_HEIGHT: f64 = 170.0;
const PANEL_GAP: f64 = 74.0;
/// Distance between the two columns, with room for the right column's scale.
const COLUMN_GAP: f64 = 84.0;

/// Time interval that the last row shows enlarged, s.
const ENLARGED_INTERVAL: std::ops::Range<f64> = 0.5..0.6;
/// Centre of the device's drawing above the panels, pixels.
const DEVICE_CENTRE: (f64, f64) = (862.0, 74.0);
/// Scale of the device's drawing, pixels per metre.
const DEVICE_SCALE: f64 = 500.0;

/// Contents of one row of panels; both panels of the row have the same scale.
struct PanelRow {
    title: &'static str,
    axis: &'static str,
    unit: &'static str,
    value: fn(&Moment) -> f64,
    low: f64,
    high: f64,
}

/// Background of the enlarged interval.
const ENLARGED_BACKGROUND: &str = "#e8e8e8";

/// Draws the device at its pose, with the wall and the path of the hand.
fn draw_device(canvas: &mut Canvas, demo: &Demo) {
    let Some(skeleton) = skeleton(&demo.file.description, demo.q()) else { return };
    let (low, high) = linkage::bounding_box(skeleton.bars.iter().flat_map(|bar| [bar.from, bar.to]));
    let middle = ((low.0 + high.0) / 2.0, (low.1 + high.1) / 2.0);
    let pixel = |x: f64, y: f64| {
        (DEVICE_CENTRE.0 + DEVICE_SCALE * (x - middle.0), DEVICE_CENTRE.1 - DEVICE_SCALE * (y - middle.1))
    };
    let ([nx, ny], (x, y)) = (demo.normal, skeleton.tip);
    // Coordinates along the wall (the slide) and into its solid side.
    let at = |along: f64, depth: f64| pixel(x - along * ny - depth * nx, y + along * nx - depth * ny);
    canvas.polygon(&[at(-0.09, 0.0), at(0.09, 0.0), at(0.09, 0.02), at(-0.09, 0.02)], FAINT_GREY, 0.3);
    canvas.line(at(-0.09, 0.0), at(0.09, 0.0), Stroke::solid(FAINT_GREY, 1.6));
    for bar in &skeleton.bars {
        canvas.line(pixel(bar.from.0, bar.from.1), pixel(bar.to.0, bar.to.1), Stroke::solid(INK, 2.0));
        canvas.circle(pixel(bar.from.0, bar.from.1), 2.6, "white", Stroke::solid(INK, 1.4));
    }
    for base in &skeleton.base {
        linkage::draw_base_pivot(canvas, pixel(base.0, base.1));
    }
    linkage::draw_tip(canvas, pixel(x, y));
    let words = at(-0.095, 0.016);
    canvas.text((words.0, words.1), 11.5, Anchor::Start, false, "wall");
}

/// Draws the crossings without and with the feed-forward side by side.
pub fn draw(demo: &Demo, without: &Crossing, with: &Crossing) -> Picture {
    let both = || without.moments.iter().chain(&with.moments);
    let top = |value: fn(&Moment) -> f64| both().map(value).fold(0.0, f64::max);
    let depth = both().map(|moment| moment.distance).fold(0.0, f64::min);
    let rows = [
        PanelRow {
            title: "distance of the tip from the wall (shaded: inside)",
            axis: "distance",
            unit: "m",
            value: |moment| moment.distance,
            low: 1.6 * depth,
            high: (-4.0 * depth).max(2.1e-3),
        },
        PanelRow {
            title: "force of the wall",
            axis: "force",
            unit: "N",
            value: |moment| moment.force,
            low: 0.0,
            high: 1.08 * top(|moment| moment.force),
        },
        PanelRow {
            title: "the same force under the resting hand, for a tenth of a second",
            axis: "force",
            unit: "N",
            value: |moment| moment.force,
            low: 0.0,
            high: 1.08 * top(|moment| if ENLARGED_INTERVAL.contains(&moment.time) { moment.force } else { 0.0 }),
        },
    ];
    let height = TOP_MARGIN + 3.0 * PANEL_HEIGHT + 2.0 * PANEL_GAP + 62.0;
    let mut canvas = Canvas::new(PICTURE_WIDTH, height);
    canvas.text((LEFT_MARGIN, 34.0), 19.0, Anchor::Start, false, "A hand presses onto a wall and slides along it");
    let conditions = format!(
        "wall of {:.0} kN/m and {:.0} N s/m, control at {:.0} kHz, the same hand and tremor twice",
        demo.stiffness / 1000.0,
        demo.damping,
        demo.rate_hz / 1000.0
    );
    canvas.text((LEFT_MARGIN, 58.0), 12.5, Anchor::Start, false, &conditions);
    for (line, sentence) in Comparison::of(without, with).sentences().iter().enumerate() {
        canvas.text((LEFT_MARGIN, 80.0 + 19.0 * line as f64), 12.5, Anchor::Start, false, sentence);
    }
    let end = both().map(|moment| moment.time).fold(0.1, f64::max);
    let width = (PICTURE_WIDTH - LEFT_MARGIN - RIGHT_MARGIN - COLUMN_GAP) / 2.0;
    let columns = [
        (without, OFF_COLOUR, "without feed-forward".to_string()),
        (with, WASHOUT_COLOUR, format!("with feed-forward (washout {} Hz)", demo.washout_hz)),
    ];
    let mut letters = 'a'..;
    for (index, row) in rows.iter().enumerate() {
        let top = TOP_MARGIN + index as f64 * (PANEL_HEIGHT + PANEL_GAP);
        for (column, (crossing, colour, name)) in columns.iter().enumerate() {
            let axis = |name: &str, unit: &str, low, high| Axis { name: name.into(), unit: unit.into(), low, high };
            let left = LEFT_MARGIN + column as f64 * (width + COLUMN_GAP);
            let frame = PlotArea {
                at: (left, top),
                size: (width, PANEL_HEIGHT),
                x: if index + 1 == rows.len() {
                    axis("time", "s", ENLARGED_INTERVAL.start, ENLARGED_INTERVAL.end)
                } else {
                    axis("time", "s", 0.0, end)
                },
                y: axis(row.axis, row.unit, row.low, row.high),
            };
            if index == 0 {
                canvas.line((left, top - 34.0), (left + 26.0, top - 34.0), Stroke::solid(colour, 2.4));
                canvas.text((left + 34.0, top - 29.5), 14.0, Anchor::Start, false, name);
            }
            if row.low < 0.0 {
                let inside = [(0.0, row.low), (end, row.low), (end, 0.0), (0.0, 0.0)];
                let corners = inside.map(|(x, y)| frame.pixel(x, y));
                canvas.polygon(&corners, FAINT_GREY, 0.22);
            }
            if index + 2 == rows.len() {
                let corners = [ENLARGED_INTERVAL.start, ENLARGED_INTERVAL.end].map(|time| frame.pixel(time, row.high));
                canvas.rectangle(
                    corners[0],
                    (corners[1].0 - corners[0].0, PANEL_HEIGHT),
                    ENLARGED_BACKGROUND,
                    Stroke::solid(FAINT_GREY, 0.0),
                );
            }
            frame.draw_clipped(&mut canvas, |canvas| {
                let points: Vec<(f64, f64)> =
                    crossing.moments.iter().map(|moment| (moment.time, (row.value)(moment))).collect();
                frame.curve(canvas, &points, Stroke::solid(colour, 1.0));
            });
            let letter = letters.next().unwrap_or(' ');
            frame.draw(&mut canvas, &format!("({letter}) {}", row.title));
        }
    }
    draw_device(&mut canvas, demo);
    let description = format!(
        "Penetration {:.3} mm without and {:.3} mm with feed-forward; peak force {:.2} N and {:.2} N; ripple of the force \
         {:.2} N and {:.2} N rms.",
        1e3 * without.penetration,
        1e3 * with.penetration,
        without.peak_force,
        with.peak_force,
        without.ripple,
        with.ripple
    );
    canvas.finish("Distance and force while a hand crosses a wall, without and with the feed-forward", &description)
}
