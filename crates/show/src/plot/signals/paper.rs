//! Draws the panels of a recording, one below the other, at the width of a screen or of a column of a paper.

use super::{Analysis, Panel, Quantity, View, smooth_panel};
use crate::plot::Picture;
use crate::plot::axes::{Axis, CurveName, PlotArea};
use crate::plot::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use crate::plot::colour::{BOUND_COLOUR, FAINT_GREY, FULL_COLOUR, INK, OFF_COLOUR, WASHOUT_COLOUR};
use crate::plot::paper::{EDGE_MARGIN, Paper, wrap};

/// Width and height of a panel's frame, drawing units (pixels on a screen).
const FRAME_SIZE: (f64, f64) = (600.0, 190.0);
const LEFT_MARGIN: f64 = 96.0;
const RIGHT_MARGIN: f64 = 24.0;
const HEADING_HEIGHT: f64 = 86.0;
const PANEL_FOOT_HEIGHT: f64 = 84.0;
/// Number of points above which force and phase curves are drawn thin.
const MANY_POINTS: usize = 1000;
const CURVE_COLOURS: [&str; 4] = [FULL_COLOUR, OFF_COLOUR, WASHOUT_COLOUR, BOUND_COLOUR];

/// Draws the panels, one below the other.
pub fn draw(title: &str, subtitle: &[String], analysis: &Analysis, paper: Paper) -> Picture {
    let page = paper.page(LEFT_MARGIN + FRAME_SIZE.0 + RIGHT_MARGIN, LEFT_MARGIN);
    let heading = page.heading(title, subtitle);
    let (head, foot) = if paper.is_printed() {
        (-PANEL_FOOT_HEIGHT + EDGE_MARGIN, 50.0)
    } else {
        (HEADING_HEIGHT - PANEL_FOOT_HEIGHT + heading.extra_height(1), PANEL_FOOT_HEIGHT)
    };
    // On paper the panels share the height of a column, if that leaves each enough.
    let high = match paper.is_printed() {
        true => ((page.most_high() - EDGE_MARGIN) / analysis.panels.len() as f64 - foot).max(84.0),
        false => FRAME_SIZE.1,
    };
    let mut canvas = page.canvas(head + PANEL_FOOT_HEIGHT);
    heading.draw(&mut canvas);
    for panel in &analysis.panels {
        let smooth = match panel.view {
            View::Phase if analysis.rows_per_point > 2 => Some(smooth_panel(panel, analysis.rows_per_point)),
            _ => None,
        };
        let panel = smooth.as_ref().unwrap_or(panel);
        let notes = if paper.is_printed() {
            Vec::new()
        } else {
            wrap(&panel.note, page.wide - RIGHT_MARGIN - EDGE_MARGIN, SMALL_TEXT)
        };
        // One line of notes has room between two frames.
        let noted = 14.0 * notes.len().saturating_sub(1) as f64;
        let top = canvas.lengthen(noted + high + foot) + noted;
        draw_panel(&mut canvas, (page.left, top), (page.wide - page.left - RIGHT_MARGIN, high), panel);
        for (line, note) in notes.iter().rev().enumerate() {
            canvas.text(
                (page.wide - RIGHT_MARGIN, top - 6.0 - 14.0 * line as f64),
                SMALL_TEXT,
                Anchor::End,
                false,
                note,
            );
        }
        canvas.caption(paper.is_printed().then_some(panel.note.as_str()));
    }
    let views: Vec<&str> = analysis.panels.iter().map(|panel| panel.y.name.as_str()).collect();
    canvas.finish(title, &format!("A recording: {}.", views.join("; ")))
}

/// Draws a panel with the upper left corner of its frame at this place.
fn draw_panel(canvas: &mut Canvas, at: (f64, f64), size: (f64, f64), panel: &Panel) {
    let colours = CURVE_COLOURS.into_iter().cycle();
    let points = || panel.curves.iter().flat_map(|curve| curve.pieces.iter().flatten()).filter(|p| is_finite(p));
    let ends = |pick: fn(&(f64, f64)) -> f64| {
        let (low, high) =
            points().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high { (0.0, 1.0) } else { (low, high) }
    };
    let axis = |quantity: &Quantity, (low, high): (f64, f64), room: f64| {
        // Centres the axis on the value of a constant curve.
        let span =
            if high - low > 1e-12 * high.abs().max(low.abs()) { high - low } else { 1e-3_f64.max(0.2 * high.abs()) };
        Axis::new(&quantity.name, &quantity.unit, low - room * span, high + room * span)
    };
    let y = axis(&panel.y, ends(|p| p.1), 0.06);
    let frame = PlotArea { at, size, x: axis(&panel.x, ends(|p| p.0), 0.0), y };
    let mut names: Vec<CurveName<'_>> = Vec::new();
    frame.draw_clipped(canvas, |canvas| {
        for (from, to) in &panel.contact {
            let corners = [(*from, frame.y.low), (*from, frame.y.high), (*to, frame.y.high), (*to, frame.y.low)];
            canvas.polygon(&corners.map(|(x, y)| frame.pixel(x, y)), FAINT_GREY, 0.22);
        }
        for (curve, colour) in panel.curves.iter().zip(colours) {
            let mut whole = Vec::new();
            for piece in &curve.pieces {
                let points = match panel.view {
                    View::Time | View::Spectrum => thin_to_envelope(&frame, piece),
                    View::Force | View::Phase => thin_out(&frame, piece),
                };
                // A line that crosses itself many times would become an area.
                let crossed = matches!(panel.view, View::Force | View::Phase) && points.len() > MANY_POINTS;
                frame.curve(canvas, &points, Stroke::solid(colour, if crossed { 0.4 } else { 1.1 }));
                whole.extend(points);
            }
            names.push(CurveName { curve: whole, colour, name: curve.name.clone() });
        }
        if frame.y.low < 0.0 && frame.y.high > 0.0 {
            frame.curve(
                canvas,
                &[(frame.x.low, 0.0), (frame.x.high, 0.0)],
                Stroke { colour: INK, width: 0.5, dash: "2 3" },
            );
        }
        if let Some(line) = &panel.line {
            frame.curve(canvas, line, Stroke { colour: INK, width: 1.4, dash: "7 4" });
        }
    });
    frame.draw(canvas, "");
    if names.len() > 1 {
        let drawn: Vec<Vec<(f64, f64)>> = names.iter().map(|name| name.curve.clone()).collect();
        frame.name_curves(canvas, &drawn, &names);
    }
    if !panel.contact.is_empty() {
        canvas.coloured_text((at.0 + size.0, at.1 + size.1 + 34.0), SMALL_TEXT, Anchor::End, INK, "shaded: contact");
    }
}

fn is_finite(point: &(f64, f64)) -> bool {
    point.0.is_finite() && point.1.is_finite()
}

/// Keeps the first, lowest, highest and last point of each half pixel, so that no peak is lost.
fn thin_to_envelope(frame: &PlotArea, piece: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    let place = |point: &(f64, f64)| (2.0 * frame.pixel(point.0, point.1).0).floor();
    for column in piece.chunk_by(|a, b| place(a) == place(b)) {
        if column.len() <= 4 {
            kept.extend(column.iter().filter(|p| is_finite(p)));
            continue;
        }
        let (mut low, mut high) = (0, 0);
        for (i, point) in column.iter().enumerate() {
            if point.1 < column[low].1 {
                low = i;
            }
            if point.1 > column[high].1 {
                high = i;
            }
        }
        let mut picked = vec![0, low, high, column.len() - 1];
        picked.sort_unstable();
        picked.dedup();
        kept.extend(picked.into_iter().map(|i| column[i]).filter(is_finite));
    }
    kept
}

/// Removes points that are within a quarter of a pixel of the previous one.
fn thin_out(frame: &PlotArea, piece: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    let mut last = (f64::INFINITY, f64::INFINITY);
    for point in piece.iter().filter(|p| is_finite(p)) {
        let pixel = frame.pixel(point.0, point.1);
        if (pixel.0 - last.0).hypot(pixel.1 - last.1) > 0.25 || last.0.is_infinite() {
            kept.push(*point);
            last = pixel;
        }
    }
    kept
}
