//! The picture of a stable domain: stiffness over damping, without and with the feed-forward, with the passivity bounds
//! and, when there are any, measured dots.

use super::Picture;
use super::axes::{Axis, Mark, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{BOUND, FAINT, FULL, HOST, OFF, WASHOUT};
use crate::analysis::passivity::Passivity;
use crate::analysis::range::{Domain, Range};

/// Distance of the lines below the axes, pixels.
const LINE: f64 = 17.0;

/// A measured point of the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPoint {
    /// Damping, N s/m.
    pub kd: f64,
    /// Median of the measured boundary, N/m.
    pub kp: f64,
    /// Lowest repeat, N/m.
    pub low: f64,
    /// Highest repeat, N/m.
    pub high: f64,
}

/// What goes into the picture.
#[derive(Clone, Debug)]
pub struct Contents<'a> {
    /// Heading, such as the device and the loop.
    pub title: String,
    /// Smaller lines under the heading: the pose, the loop.
    pub subtitle: [String; 2],
    /// The predicted domain.
    pub range: &'a Range,
    /// Bounds drawn beside it.
    pub passivity: Option<&'a Passivity>,
    /// Frequency of the feed-forward's washout, Hz.
    pub washout_hz: Option<f64>,
    /// Measured dots without feed-forward.
    pub measured_off: &'a [MeasuredPoint],
    /// Measured dots with feed-forward.
    pub measured_full: &'a [MeasuredPoint],
}

/// Draws it.
pub fn draw(contents: &Contents<'_>) -> Picture {
    let range = contents.range;
    let domains = || [Some(&range.off), Some(&range.full), range.washout.as_ref()].into_iter().flatten();
    let measured = || contents.measured_off.iter().chain(contents.measured_full);
    let widest = domains().map(|d| d.kd_max).chain(measured().map(|m| m.kd)).fold(0.0_f64, f64::max);
    let islands = domains().flat_map(|d| &d.islands);
    let tallest = domains()
        .flat_map(|d| d.boundary.iter().map(|p| p.kp))
        .chain(measured().map(|m| m.high))
        .chain(islands.map(|i| i.kp_high))
        .fold(0.0_f64, f64::max);
    let above = |value: f64| if value > 0.0 { value * 1.08 } else { 1.0 };

    let symbols = contents.passivity.map(symbols).unwrap_or_default();
    let mut canvas = Canvas::new(720.0, 486.0 + LINE * symbols.len() as f64);
    let frame = PlotArea {
        at: (86.0, 82.0),
        size: (610.0, 340.0),
        x: Axis { name: "wall damping kd".into(), unit: "N s/m".into(), low: 0.0, high: above(widest) },
        y: Axis { name: "wall stiffness kp".into(), unit: "N/m".into(), low: 0.0, high: above(tallest) },
    };
    let points = |d: &Domain| d.boundary.iter().map(|p| (p.kd, p.kp)).collect::<Vec<_>>();
    let (off, full) = (points(&range.off), points(&range.full));
    let mut entries = Vec::new();
    frame.clipped(&mut canvas, |canvas| {
        frame.area_under(canvas, &full, FULL, 0.10);
        frame.area_under(canvas, &off, OFF, 0.16);
        for (domain, colour) in [(Some(&range.off), OFF), (Some(&range.full), FULL), (range.washout.as_ref(), WASHOUT)]
        {
            for island in domain.map_or(&[][..], |d| &d.islands) {
                let ends = [(island.kd, island.kp_low), (island.kd, island.kp_high)];
                frame.curve(canvas, &ends, Stroke { colour, width: 1.0, dash: "2 2" });
            }
        }
        let line = |colour, dash| Stroke { colour, width: 2.0, dash };
        frame.curve(canvas, &full, line(FULL, ""));
        entries.push((Mark::Line(line(FULL, "")), format!("feed-forward (4), Wrr = {}", mass(range.w_rr))));
        if let Some(washout) = &range.washout {
            frame.curve(canvas, &points(washout), line(WASHOUT, "7 3"));
            let washed = match contents.washout_hz {
                Some(hz) => format!("feed-forward, washout {hz} Hz"),
                None => "feed-forward with washout".into(),
            };
            entries.push((Mark::Line(line(WASHOUT, "7 3")), washed));
        }
        frame.curve(canvas, &off, line(OFF, ""));
        entries.push((Mark::Line(line(OFF, "")), format!("no feed-forward, Weff = {}", mass(range.w_eff))));
        if let Some(host) = &range.host {
            frame.area_under(canvas, &points(&host.domain), HOST, 0.5);
            frame.curve(canvas, &points(&host.domain), line(HOST, ""));
            let late = format!("{:.1}", 1e3 * host.delay_s);
            let name = format!("rendered by a computer at {:.0} Hz, {late} ms late", host.rate_hz);
            entries.push((Mark::Line(line(HOST, "")), name));
        }
        if let Some(passivity) = contents.passivity {
            let sampled = [(0.0, passivity.sampled(0.0)), (passivity.damping, 0.0)];
            let colgate = Stroke { colour: BOUND, width: 1.6, dash: "5 3" };
            frame.curve(canvas, &sampled, colgate);
            entries.push((Mark::Line(colgate), "passive: b > kp T (1/2 + d) + |kd|".into()));
            if let Some(limit) = passivity.quantised() {
                let abbott = Stroke { colour: BOUND, width: 1.6, dash: "1.5 2.5" };
                frame.curve(canvas, &[(0.0, limit), (0.04 * frame.x.high, limit)], abbott);
                entries.push((Mark::Line(abbott), "passive: kp ≤ 2 fc/Δ".into()));
            }
        }
        for (dots, colour) in [(contents.measured_full, FULL), (contents.measured_off, OFF)] {
            for dot in dots {
                frame.dot(canvas, dot.kd, dot.kp, dot.low, dot.high, colour);
            }
        }
    });
    if measured().next().is_some() {
        entries.push((Mark::Dot(FAINT), "measured: median, all repeats".into()));
    }
    frame.draw(&mut canvas, "");
    canvas.text((frame.at.0, 28.0), 15.0, Anchor::Start, false, &contents.title);
    for (line, text) in contents.subtitle.iter().enumerate() {
        canvas.text((frame.at.0, 48.0 + 18.0 * line as f64), 12.0, Anchor::Start, false, text);
    }
    for (line, text) in symbols.iter().enumerate() {
        canvas.text((frame.at.0, 486.0 + LINE * line as f64), 11.5, Anchor::Start, false, text);
    }
    PlotArea::legend(&mut canvas, frame.at.0 + frame.size.0 - 10.0, frame.at.1 + 10.0, &entries);
    canvas
        .finish(&contents.title, "Stable stiffness over damping of a virtual wall, without and with the feed-forward.")
}

/// What the legend's symbols stand for, with the values that they have here.
fn symbols(passivity: &Passivity) -> Vec<String> {
    let mut lines = vec![
        "Weff, Wrr: the inertia that the wall meets; passive: no hand makes it oscillate, without feed-forward".into(),
        format!(
            "b = {:.3} N s/m: smallest viscous damping along n; T: control period; d: delay in samples",
            passivity.damping
        ),
    ];
    if let Some(quantum) = passivity.quantum {
        let friction = passivity.coulomb;
        lines.push(format!(
            "fc = {friction:.3} N: smallest Coulomb friction along n; Δ = {:.3} µm: step of the encoders along n",
            1e6 * quantum
        ));
    }
    lines
}

/// A mass with three to four significant digits.
fn mass(kg: f64) -> String {
    match kg {
        kg if kg < 0.01 => format!("{:.3} g", kg * 1e3),
        kg if kg < 1.0 => format!("{:.1} g", kg * 1e3),
        kg => format!("{kg:.3} kg"),
    }
}
