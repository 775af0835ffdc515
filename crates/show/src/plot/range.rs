//! The picture of stable stiffness over damping, with passivity bounds and measured dots where available.

use super::Picture;
use super::axes::{Axis, CurveName, PlotArea};
use super::canvas::Stroke;
use super::colour::{BOUND_COLOUR, FULL_COLOUR, HOST_COLOUR, OFF_COLOUR, WASHOUT_COLOUR};
use super::paper::Paper;
use haptic_host::words::with_unit;
use haptic_stability::analysis::passivity::Passivity;
use haptic_stability::analysis::range::{Domain, Range};

/// Highest over lowest value of the logarithmic axes that also show a computer's walls.
const HOST_DECADES: f64 = 1e3;

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
    /// Offset of the drawn dot to the right of its damping, pixels.
    pub beside: f64,
}

/// Contents of the picture.
#[derive(Clone, Debug)]
pub struct Contents<'a> {
    /// Title, such as the device.
    pub title: String,
    /// Subtitle lines: the pose, and the control loop.
    pub subtitle: [String; 2],
    /// The predicted domain.
    pub range: &'a Range,
    /// Passivity bounds to draw as well.
    pub passivity: Option<&'a Passivity>,
    /// Frequency of the feed-forward's washout, Hz.
    pub washout_hz: Option<f64>,
    /// Legend text of the measured dots.
    pub measured: String,
    /// Measured dots without feed-forward.
    pub measured_off: &'a [MeasuredPoint],
    /// Measured dots with feed-forward.
    pub measured_full: &'a [MeasuredPoint],
    /// Note below the axes that explains differences between dots and curves.
    pub note: Option<String>,
    /// Width of the picture.
    pub paper: Paper,
}

/// Draws the picture.
pub fn draw(contents: &Contents<'_>) -> Picture {
    let range = contents.range;
    let domains = || [Some(&range.off), Some(&range.full), range.washout.as_ref()].into_iter().flatten();
    let measured = || contents.measured_off.iter().chain(contents.measured_full);
    let islands = || domains().flat_map(|d| &d.islands);
    let ends = domains().map(|d| d.kd_max).chain(measured().map(|m| m.kd));
    let widest = match ends.fold(0.0_f64, f64::max) {
        0.0 => islands().map(|i| i.kd).fold(0.0, f64::max),
        widest => widest,
    };
    let tallest = domains()
        .flat_map(|d| d.boundary.iter().map(|p| p.kp))
        .chain(measured().map(|m| m.high))
        .chain(islands().map(|i| i.kp_high))
        .fold(0.0_f64, f64::max);
    let above = |value: f64| if value > 0.0 { value * 1.08 } else { 1.0 };

    let page = contents.paper.page(720.0, 86.0);
    let heading = page.heading(&contents.title, &contents.subtitle);
    // The walls of a computer are so much softer that only a logarithmic scale shows both.
    let axis = |name: &str, unit: &str, high: f64| match range.host {
        Some(_) => Axis::logarithmic(name, unit, high / HOST_DECADES, high),
        None => Axis::new(name, unit, 0.0, high),
    };
    let frame = PlotArea {
        at: (page.left, 82.0 + heading.extra_height(2)),
        size: (page.wide - page.left - 24.0, if page.is_narrow() { 190.0 } else { 340.0 }),
        x: axis("wall damping kd", "N s/m", above(widest)),
        y: axis("wall stiffness kp", "N/m", above(tallest)),
    };
    let bounds = contents.passivity.map(|passivity| passivity_bounds(passivity, &frame)).unwrap_or_default();
    let symbols = contents.passivity.map(|passivity| symbols(passivity, &bounds)).unwrap_or_default();
    let inertia = format!(
        "the wall meets Weff = {} without the feed-forward, Wrr = {} with it",
        format_mass(range.w_eff),
        format_mass(range.w_rr)
    );
    let host = range.host.as_ref().map(|host| {
        let late = 1e3 * host.delay_s;
        format!("computer, {:.0} Hz, {late:.1} ms late: the wall as a program renders it over the board", host.rate_hz)
    });
    let dots = measured().next().map(|_| format!("dots: {}", contents.measured));
    let notes =
        [Some(inertia), host, contents.note.clone(), dots].into_iter().flatten().chain(symbols).collect::<Vec<_>>();
    let notes = page.notes(notes.iter().map(String::as_str));
    let below = frame.at.1 + frame.size.1 + if page.is_narrow() { 48.0 } else { 64.0 };
    let mut canvas = page.canvas(below + notes.height());
    heading.draw(&mut canvas);
    let points = |d: &Domain| d.boundary.iter().map(|p| (p.kd, p.kp)).collect::<Vec<_>>();
    let mut names = Vec::new();
    let mut name = |curve: Vec<(f64, f64)>, colour, name: String| names.push(CurveName { curve, colour, name });
    name(points(&range.full), FULL_COLOUR, "with feed-forward".into());
    name(points(&range.off), OFF_COLOUR, "without".into());
    if let Some(washout) = &range.washout {
        let corner = contents.washout_hz.map_or(String::new(), |hz| format!(" {hz} Hz"));
        name(points(washout), WASHOUT_COLOUR, format!("washout{corner}"));
    }
    if let Some(host) = &range.host {
        name(points(&host.domain), HOST_COLOUR, format!("computer, {:.0} Hz", host.rate_hz));
    }
    for bound in bounds.iter().filter(|bound| bound.hidden.is_none()) {
        name(bound.line.clone(), BOUND_COLOUR, bound.name.into());
    }
    let mut drawn: Vec<_> = names.iter().map(|name| name.curve.clone()).collect();
    frame.draw_clipped(&mut canvas, |canvas| {
        frame.area_under(canvas, &points(&range.full), FULL_COLOUR, 0.10);
        frame.area_under(canvas, &points(&range.off), OFF_COLOUR, 0.16);
        for (domain, colour) in
            [(Some(&range.off), OFF_COLOUR), (Some(&range.full), FULL_COLOUR), (range.washout.as_ref(), WASHOUT_COLOUR)]
        {
            for island in domain.map_or(&[][..], |d| &d.islands) {
                let ends = [(island.kd, island.kp_low), (island.kd, island.kp_high)];
                frame.curve(canvas, &ends, Stroke { colour, width: 1.0, dash: "2 2" });
                drawn.push(ends.to_vec());
            }
        }
        for CurveName { curve, colour, .. } in &names {
            let dash = bounds.iter().find(|bound| bound.line == *curve).map(|bound| bound.dash);
            let dash = dash.unwrap_or(if *colour == WASHOUT_COLOUR { "7 3" } else { "" });
            frame.curve(canvas, curve, Stroke { colour, width: if *colour == BOUND_COLOUR { 1.6 } else { 2.0 }, dash });
        }
        for (dots, colour) in [(contents.measured_full, FULL_COLOUR), (contents.measured_off, OFF_COLOUR)] {
            for dot in dots {
                let kd = dot.kd + dot.beside * frame.x.high / frame.size.0;
                frame.dot(canvas, kd, dot.kp, dot.low, dot.high, colour);
                drawn.push(vec![(kd, dot.low), (kd, dot.high)]);
            }
        }
    });
    frame.draw(&mut canvas, "");
    notes.draw(&mut canvas, below);
    frame.name_curves(&mut canvas, &drawn, &names);
    canvas
        .finish(&contents.title, "Stable stiffness over damping of a virtual wall, without and with the feed-forward.")
}

struct PassivityBound {
    name: &'static str,
    dash: &'static str,
    line: Vec<(f64, f64)>,
    /// Description of the bound if it is too small to see; `None` if it is drawn.
    hidden: Option<String>,
}

/// Returns the bounds, with a description of each bound that is too small to see in this frame.
fn passivity_bounds(passivity: &Passivity, frame: &PlotArea) -> Vec<PassivityBound> {
    // Smallest visible distance from an axis, pixels.
    const MIN_VISIBLE_DISTANCE: f64 = 2.0;
    /// Straight pieces of the Colgate and Schenkel curve.
    const CURVE_PIECES: usize = 40;
    let (max_stiffness, end) = (passivity.largest_stiffness(0.0), passivity.largest_damping());
    let (right, top) = frame.pixel(end, max_stiffness);
    let bottom = frame.at.1 + frame.size.1;
    let small = right - frame.at.0 < MIN_VISIBLE_DISTANCE || bottom - top < MIN_VISIBLE_DISTANCE;
    let at = |i: usize| end * i as f64 / CURVE_PIECES as f64;
    let mut bounds = vec![PassivityBound {
        name: "passive",
        dash: "5 3",
        line: (0..=CURVE_PIECES).map(|i| (at(i), passivity.largest_stiffness(at(i)))).collect(),
        hidden: small.then(|| format!("kp < {}, kd < {}", with_unit(max_stiffness, "N/m"), with_unit(end, "N s/m"))),
    }];
    if let Some(limit) = passivity.largest_undamped_stiffness() {
        let (_, y) = frame.pixel(0.0, limit);
        let is_hidden = bottom - y < MIN_VISIBLE_DISTANCE || y < frame.at.1;
        bounds.push(PassivityBound {
            name: "2 fc/Δ",
            dash: "1.5 2.5",
            line: vec![(0.0, limit), (0.04 * frame.x.high, limit)],
            hidden: is_hidden.then(|| format!("with encoder steps and friction kp ≤ {}", with_unit(limit, "N/m"))),
        });
    }
    bounds
}

/// Explains the legend's symbols with their values, and lists the bounds that cannot be seen.
fn symbols(passivity: &Passivity, bounds: &[PassivityBound]) -> Vec<String> {
    let mut lines = vec![
        "passive (Colgate and Schenkel), and at kd = 0 kp ≤ 2 fc/Δ: stable in any hand, without feed-forward".into(),
    ];
    let drawn = |index: usize| bounds.get(index).is_some_and(|bound| bound.hidden.is_none());
    if drawn(0) {
        lines.push(format!(
            "b = {:.3} N s/m: smallest viscous damping along n; passive with delay, drive and filter for kd < {:.3} N s/m",
            passivity.damping,
            passivity.largest_damping()
        ));
    }
    if let Some(quantum) = passivity.quantum.filter(|_| drawn(1)) {
        let friction = passivity.coulomb;
        lines.push(format!(
            "fc = {friction:.3} N: smallest Coulomb friction along n; Δ = {:.3} µm: step of the encoders along n",
            1e6 * quantum
        ));
    }
    let hidden: Vec<&str> = bounds.iter().filter_map(|bound| bound.hidden.as_deref()).collect();
    if !hidden.is_empty() {
        lines.push(format!("passive, too small to draw here: {}", hidden.join("; ")));
    }
    lines
}

/// Formats a mass with three to four significant digits.
fn format_mass(kg: f64) -> String {
    match kg {
        kg if kg < 0.01 => format!("{:.3} g", kg * 1e3),
        kg if kg < 1.0 => format!("{:.1} g", kg * 1e3),
        kg => format!("{kg:.3} kg"),
    }
}
