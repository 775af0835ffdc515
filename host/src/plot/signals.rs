//! Pictures of a recording: signals over time, force over penetration, spectrum, phase.
//!
//! What is drawn is worked out first, as points in SI units ([`panels`]), and then put on paper ([`draw`]). A row that
//! was lost is a gap: no line leads over it.

use super::Picture;
use super::axes::{Axis, Mark, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{BOUND, FULL, INK, OFF, WASHOUT};
use crate::analysis::amplitudes::{SpectralLine, spectrum};
use crate::error::{Choice, Failure};
use crate::link::columns;
use crate::recorder::Recording;
use crate::words::{counted, with_unit};
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use serde::Serialize;

/// What can be drawn of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// Signals over time.
    Time,
    /// Force over penetration.
    Force,
    /// Amplitude over frequency.
    Spectrum,
    /// Velocity over position.
    Phase,
}

impl View {
    /// Every view with its name.
    pub const ALL: [(&'static str, Self); 4] =
        [("time", Self::Time), ("force", Self::Force), ("spectrum", Self::Spectrum), ("phase", Self::Phase)];
}

/// What is asked of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// Which views; none: those that the recording has the columns for.
    pub views: Vec<View>,
    /// Columns over time and as a spectrum; none: the rendered force.
    pub signals: Vec<String>,
    /// From and to when, s.
    pub from: Option<f64>,
    /// To when, s.
    pub to: Option<f64>,
    /// Highest frequency shown, Hz.
    pub most_hz: Option<f64>,
}

/// A quantity along an axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// What it is.
    pub name: String,
    /// SI unit.
    pub unit: String,
}

/// A line of a panel, in pieces where rows are missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// What it shows.
    pub name: String,
    /// Points in SI units.
    pub pieces: Vec<Vec<(f64, f64)>>,
}

/// One coordinate system.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Panel {
    /// What it shows.
    pub view: View,
    /// Along the horizontal axis.
    pub x: Quantity,
    /// Along the vertical axis.
    pub y: Quantity,
    /// Its lines.
    pub curves: Vec<Curve>,
    /// What a reader has to know, above the frame.
    pub note: String,
}

/// What a recording says in numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// Rows that are drawn, the seconds that they cover, and rows that are missing between them.
    pub rows: usize,
    /// s
    pub seconds: f64,
    /// Rows.
    pub missing: u64,
    /// The strongest sine of the first signal from 10 Hz on.
    pub strongest: Option<SpectralLine>,
    /// Stiffness of the line through force over penetration in contact, N/m.
    pub stiffness: Option<f64>,
    /// What is drawn.
    pub panels: Vec<Panel>,
}

/// The part of a recording that is drawn.
struct Rows<'a> {
    recording: &'a Recording,
    rows: &'a [Vec<f64>],
    time: usize,
    /// Rows a second.
    rate_hz: f64,
    /// Index of the first row of each stretch without a gap, and behind the last.
    stretches: Vec<usize>,
    missing: u64,
}

impl<'a> Rows<'a> {
    fn of(recording: &'a Recording, request: &Request) -> Result<Self, Failure> {
        let none = |name: &str| {
            Failure::wrong(format!("the recording has no column {name}")).remedy("record it with haptic record")
        };
        let (step, time) = (recording.column("step"), recording.column("time_s"));
        let (step, time) = (step.ok_or_else(|| none("step"))?, time.ok_or_else(|| none("time_s"))?);
        let begin = request.from.map_or(0, |from| recording.rows.partition_point(|row| row[time] < from));
        let end = request.to.map_or(recording.rows.len(), |to| recording.rows.partition_point(|row| row[time] <= to));
        let rows = recording.rows.get(begin..end).unwrap_or_default();
        if rows.len() < 2 {
            let span = recording.rows.first().zip(recording.rows.last());
            let span = span.map_or("no rows".into(), |(a, b)| format!("rows from {} to {} s", a[time], b[time]));
            return Err(Failure::wrong(format!("{} to draw; the recording has {span}", counted(rows.len(), "row")))
                .remedy("draw a longer time, or record more"));
        }
        // A restarted board counts from 0 again; what lies between is not known.
        let apart = |i: usize| rows[i + 1][step] - rows[i][step];
        let every = (0..rows.len() - 1).map(apart).filter(|apart| *apart > 0.0).fold(f64::INFINITY, f64::min);
        let mut stretches = vec![0];
        let mut missing = 0;
        for i in 0..rows.len() - 1 {
            if apart(i) != every {
                stretches.push(i + 1);
                missing += (apart(i) / every - 1.0).max(0.0) as u64;
            }
        }
        stretches.push(rows.len());
        let between = (0..rows.len() - 1).find(|i| apart(*i) == every).map(|i| rows[i + 1][time] - rows[i][time]);
        let rate_hz = recording.rate_hz().map(|rate| rate / every).or(between.map(f64::recip)).unwrap_or(f64::NAN);
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(Failure::wrong("no two rows follow each other, so there is no time between them"));
        }
        Ok(Self { recording, rows, time, rate_hz, stretches, missing })
    }

    fn column(&self, name: &str) -> Result<usize, Failure> {
        self.recording.column(name).ok_or_else(|| {
            let columns = self.recording.columns.join(", ");
            Failure::wrong(format!("the recording has no column {name}")).remedy(format!("it has {columns}"))
        })
    }

    fn has(&self, name: &str) -> bool {
        self.recording.column(name).is_some()
    }

    /// Pieces without a gap of what `point` makes of a row.
    fn pieces(&self, point: impl Fn(usize, &[f64]) -> (f64, f64)) -> Vec<Vec<(f64, f64)>> {
        let piece = |ends: &[usize]| (ends[0]..ends[1]).map(|i| point(i, &self.rows[i])).collect();
        self.stretches.windows(2).map(piece).collect()
    }

    /// The longest stretch without a gap.
    fn longest(&self) -> std::ops::Range<usize> {
        let longest = self.stretches.windows(2).max_by_key(|ends| ends[1] - ends[0]);
        longest.map_or(0..0, |ends| ends[0]..ends[1])
    }
}

/// What is slower is a motion, no vibration, Hz.
const SLOW_HZ: f64 = 10.0;
/// A millionth of the strongest line is nothing.
const FLOOR: f64 = 1e-6;

/// Unit and name of a column by its label; what this tool does not know has none.
fn quantity(label: &str) -> Quantity {
    let known = columns(Fields::ALL, MAX_JOINTS);
    let unit = known.iter().find(|column| column.label == label).map_or("", |column| column.field.unit());
    let unit = if label == "time_s" { "s" } else { unit };
    // "rendered_n" is the quantity rendered: its unit stands beside it.
    let suffix = format!("_{}", unit.to_lowercase().replace([' ', '/'], "_"));
    let name = label.strip_suffix(&suffix).filter(|_| !unit.is_empty()).unwrap_or(label);
    Quantity { name: name.replace('_', " "), unit: unit.into() }
}

fn named(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

/// Works out what is drawn.
pub fn panels(recording: &Recording, request: &Request) -> Result<Found, Failure> {
    let rows = Rows::of(recording, request)?;
    let force = ["rendered_n", "force_n"].into_iter().find(|name| rows.has(name));
    let signals: Vec<String> = match (request.signals.is_empty(), force) {
        (false, _) => request.signals.clone(),
        (true, Some(force)) => vec![force.into()],
        (true, None) => {
            recording.columns.iter().filter(|c| !matches!(c.as_str(), "step" | "time_s")).take(1).cloned().collect()
        }
    };
    for signal in &signals {
        rows.column(signal)?;
    }
    let drawn = |view: View| match (request.views.is_empty(), view) {
        (false, view) => request.views.contains(&view),
        (true, View::Force) => force.is_some() && rows.has("distance_m"),
        (true, View::Phase) => rows.has("distance_m"),
        (true, _) => !signals.is_empty(),
    };
    let span = rows.rows[rows.rows.len() - 1][rows.time] - rows.rows[0][rows.time];
    let mut found = Found {
        rows: rows.rows.len(),
        seconds: span,
        missing: rows.missing,
        strongest: None,
        stiffness: None,
        panels: Vec::new(),
    };
    if drawn(View::Time) {
        found.panels.extend(over_time(&rows, &signals)?);
    }
    if drawn(View::Force) {
        let force = force.ok_or_else(|| {
            Failure::wrong("the recording has neither rendered_n nor force_n")
                .remedy("record the fields distance, rendered")
        })?;
        let (panel, stiffness) = over_penetration(&rows, force)?;
        found.stiffness = stiffness;
        found.panels.push(panel);
    }
    if drawn(View::Spectrum) {
        let (panel, strongest) = amplitudes(&rows, &signals, request.most_hz)?;
        found.strongest = strongest;
        found.panels.push(panel);
    }
    if drawn(View::Phase) {
        found.panels.push(phase(&rows)?);
    }
    if found.panels.is_empty() {
        return Err(Failure::wrong("the recording has nothing but steps and times").remedy("record more fields"));
    }
    Ok(found)
}

/// A panel for each unit.
fn over_time(rows: &Rows<'_>, signals: &[String]) -> Result<Vec<Panel>, Failure> {
    let mut panels: Vec<Panel> = Vec::new();
    for signal in signals {
        let column = rows.column(signal)?;
        let of = quantity(signal);
        let curve = Curve { name: signal.clone(), pieces: rows.pieces(|_, row| (row[rows.time], row[column])) };
        match panels.iter_mut().find(|panel| panel.y.unit == of.unit) {
            Some(panel) => {
                panel.curves.push(curve);
                panel.y.name =
                    panel.curves.iter().map(|curve| quantity(&curve.name).name).collect::<Vec<_>>().join(", ");
            }
            None => panels.push(Panel {
                view: View::Time,
                x: named("time", "s"),
                y: of,
                curves: vec![curve],
                note: String::new(),
            }),
        }
    }
    Ok(panels)
}

fn over_penetration(rows: &Rows<'_>, force: &str) -> Result<(Panel, Option<f64>), Failure> {
    let (distance, column) = (rows.column("distance_m")?, rows.column(force)?);
    let deepest = rows.rows.iter().fold(0.0_f64, |deepest, row| deepest.max(-row[distance]));
    // What is far from the wall is no part of this picture: an empty row of points along the axis.
    let near = |row: &[f64]| -row[distance] >= -0.1 * deepest;
    let mut pieces = Vec::new();
    for piece in rows.pieces(|i, _| (i as f64, 0.0)) {
        let mut open = Vec::new();
        for (i, _) in piece {
            let row = &rows.rows[i as usize];
            if near(row) {
                open.push((-row[distance], row[column]));
            } else if !open.is_empty() {
                pieces.push(std::mem::take(&mut open));
            }
        }
        pieces.push(open);
    }
    pieces.retain(|piece| piece.len() > 1);
    let touched: Vec<(f64, f64)> = pieces.iter().flatten().copied().filter(|(x, _)| *x > 0.0).collect();
    let stiffness = slope(&touched);
    let note = match stiffness {
        Some(stiffness) => format!("line through the rows in contact: {} N/m", crate::words::short(stiffness as f32)),
        None => "no wall was touched".into(),
    };
    let (x, y) = (named("penetration", "m"), quantity(force));
    Ok((Panel { view: View::Force, x, y, curves: vec![Curve { name: force.into(), pieces }], note }, stiffness))
}

/// Slope of the straight line of least squares.
fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let count = points.len() as f64;
    let mean = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let spread: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    let both: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    (points.len() > 2 && spread > 0.0).then(|| both / spread)
}

fn amplitudes(
    rows: &Rows<'_>,
    signals: &[String],
    most_hz: Option<f64>,
) -> Result<(Panel, Option<SpectralLine>), Failure> {
    let stretch = rows.longest();
    let half = 0.5 * rows.rate_hz;
    let most = most_hz.unwrap_or(1000.0).min(half);
    let mut panel = Panel {
        view: View::Spectrum,
        x: named("frequency", "Hz"),
        y: named("amplitude", "dB"),
        curves: Vec::new(),
        note: String::new(),
    };
    let unit = quantity(&signals[0]).unit;
    let reference = if unit.is_empty() { String::new() } else { format!(" re 1 {unit}") };
    panel.y.name.push_str(&reference);
    let mut strongest = None;
    for signal in signals.iter().filter(|signal| quantity(signal).unit == unit) {
        let column = rows.column(signal)?;
        let values: Vec<f64> = rows.rows[stretch.clone()].iter().map(|row| row[column]).collect();
        let lines = spectrum(&values, rows.rate_hz).ok_or_else(|| {
            Failure::wrong(format!("{} without a gap are too few for a spectrum", counted(values.len(), "row")))
                .remedy("record longer, or leave the spectrum out")
                .choose(Choice::Shown)
        })?;
        let fast = lines.iter().filter(|line| line.frequency >= SLOW_HZ);
        let top = fast.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
        if panel.curves.is_empty() {
            strongest = top.copied().filter(|top| top.amplitude > 0.0);
        }
        let shown = lines.iter().filter(|line| line.frequency <= most);
        let highest = lines.iter().fold(0.0, |highest: f64, line| highest.max(line.amplitude));
        // What never moved lies where a unit's floor is, and not thousands of decibels below it.
        let highest = if highest > 0.0 { highest } else { 1.0 };
        let points = shown.map(|line| (line.frequency, 20.0 * line.amplitude.max(FLOOR * highest).log10())).collect();
        panel.curves.push(Curve { name: signal.clone(), pieces: vec![points] });
    }
    if stretch.len() < rows.rows.len() {
        panel.note = format!("of the longest stretch without a gap, {}", counted(stretch.len(), "row"));
    }
    if let Some(line) = strongest {
        let size = with_unit(line.amplitude, &unit);
        let says = format!("strongest above {SLOW_HZ} Hz: {size} at {:.1} Hz", line.frequency);
        panel.note = if panel.note.is_empty() { says } else { format!("{says}; {}", panel.note) };
    }
    Ok((panel, strongest))
}

fn phase(rows: &Rows<'_>) -> Result<Panel, Failure> {
    let distance = rows.column("distance_m")?;
    let measured = rows.recording.column("velocity_m_s");
    let ends = |i: usize| {
        let stretch = rows.stretches.windows(2).find(|ends| (ends[0]..ends[1]).contains(&i));
        stretch.map_or((i, i), |ends| (i.saturating_sub(1).max(ends[0]), (i + 1).min(ends[1] - 1)))
    };
    let speed = |i: usize, row: &[f64]| match measured {
        Some(column) => row[column],
        None => {
            let (before, after) = ends(i);
            let apart = (after - before).max(1) as f64 / rows.rate_hz;
            (rows.rows[after][distance] - rows.rows[before][distance]) / apart
        }
    };
    let note = match measured {
        Some(_) => String::new(),
        None => "velocity: differences of the distance, because the recording has none".into(),
    };
    Ok(Panel {
        view: View::Phase,
        x: named("distance to the wall", "m"),
        y: named("velocity", "m/s"),
        curves: vec![Curve { name: "velocity".into(), pieces: rows.pieces(|i, row| (row[distance], speed(i, row))) }],
        note,
    })
}

/// Size of a panel's frame, and of what is around it, pixels.
const SIZE: (f64, f64) = (600.0, 190.0);
const LEFT: f64 = 96.0;
const HEAD: f64 = 82.0;
const FOOT: f64 = 84.0;
/// A phase portrait of faster rows is drawn of means: differences between single rows are encoder steps, whose speeds
/// make an area of its line.
const SMOOTHED_HZ: f64 = 1000.0;
/// Points from which on a line that may cross itself is drawn thin.
const MANY: usize = 1000;
const COLOURS: [&str; 4] = [FULL, OFF, WASHOUT, BOUND];

/// Puts them on paper, one below the other.
pub fn draw(title: &str, subtitle: &[String], found: &Found) -> Picture {
    let head = HEAD + 16.0 * subtitle.len().saturating_sub(1) as f64;
    let height = head + (SIZE.1 + FOOT) * found.panels.len() as f64;
    let mut canvas = Canvas::new(LEFT + SIZE.0 + 24.0, height);
    canvas.text((LEFT, 26.0), 15.0, Anchor::Start, false, title);
    for (line, text) in subtitle.iter().enumerate() {
        canvas.text((LEFT, 45.0 + 16.0 * line as f64), 11.5, Anchor::Start, false, text);
    }
    for (index, panel) in found.panels.iter().enumerate() {
        let at = (LEFT, head + (SIZE.1 + FOOT) * index as f64);
        // Means over at least a millisecond; at a kilohertz and below every row is drawn.
        let rows = (found.rows as f64 / (SMOOTHED_HZ * found.seconds.max(f64::MIN_POSITIVE))).ceil();
        match panel.view {
            View::Phase if rows > 2.5 => draw_panel(&mut canvas, at, &smoothed(panel, rows as usize)),
            _ => draw_panel(&mut canvas, at, panel),
        }
    }
    let views: Vec<&str> = found.panels.iter().map(|panel| panel.y.name.as_str()).collect();
    canvas.finish(title, &format!("Of a recording: {}.", views.join("; ")))
}

fn draw_panel(canvas: &mut Canvas, at: (f64, f64), panel: &Panel) {
    let points = || panel.curves.iter().flat_map(|curve| curve.pieces.iter().flatten()).filter(|p| finite(p));
    let ends = |pick: fn(&(f64, f64)) -> f64| {
        let (low, high) =
            points().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high { (0.0, 1.0) } else { (low, high) }
    };
    let axis = |quantity: &Quantity, (low, high): (f64, f64), room: f64| {
        // A constant is a line in the middle of something.
        let span =
            if high - low > 1e-12 * high.abs().max(low.abs()) { high - low } else { 1e-3_f64.max(0.2 * high.abs()) };
        Axis {
            name: quantity.name.clone(),
            unit: quantity.unit.clone(),
            low: low - room * span,
            high: high + room * span,
        }
    };
    let y = axis(&panel.y, ends(|p| p.1), 0.06);
    let frame = PlotArea { at, size: SIZE, x: axis(&panel.x, ends(|p| p.0), 0.0), y };
    frame.clipped(canvas, |canvas| {
        for (curve, colour) in panel.curves.iter().zip(COLOURS.into_iter().cycle()) {
            for piece in &curve.pieces {
                let points = match panel.view {
                    View::Time | View::Spectrum => envelope(&frame, piece),
                    View::Force | View::Phase => thinned(&frame, piece),
                };
                // A line that crosses itself many times would be an area.
                let crossed = matches!(panel.view, View::Force | View::Phase) && points.len() > MANY;
                frame.curve(canvas, &points, Stroke::solid(colour, if crossed { 0.4 } else { 1.1 }));
            }
        }
        if frame.y.low < 0.0 && frame.y.high > 0.0 {
            frame.curve(
                canvas,
                &[(frame.x.low, 0.0), (frame.x.high, 0.0)],
                Stroke { colour: INK, width: 0.5, dash: "2 3" },
            );
        }
    });
    frame.draw(canvas, "");
    if !panel.note.is_empty() {
        canvas.text((at.0 + SIZE.0, at.1 - 6.0), 11.5, Anchor::End, false, &panel.note);
    }
    if panel.curves.len() > 1 {
        let entries: Vec<(Mark<'_>, String)> = panel
            .curves
            .iter()
            .zip(COLOURS.into_iter().cycle())
            .map(|(curve, colour)| (Mark::Line(Stroke::solid(colour, 1.6)), curve.name.clone()))
            .collect();
        // Above the frame and its note: it hides no curve.
        PlotArea::legend_line(canvas, (at.0, at.1 - 24.0), &entries);
    }
}

fn finite(point: &(f64, f64)) -> bool {
    point.0.is_finite() && point.1.is_finite()
}

/// Where more points than half pixels follow each other: first, lowest, highest and last of each half pixel, so that no
/// peak is lost.
fn envelope(frame: &PlotArea, piece: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    let place = |point: &(f64, f64)| (2.0 * frame.pixel(point.0, point.1).0).floor();
    for column in piece.chunk_by(|a, b| place(a) == place(b)) {
        if column.len() <= 4 {
            kept.extend(column.iter().filter(|p| finite(p)));
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
        kept.extend(picked.into_iter().map(|i| column[i]).filter(finite));
    }
    kept
}

/// A panel of the means of every `together` points that follow each other; of the last ones, fewer.
fn smoothed(panel: &Panel, together: usize) -> Panel {
    let mean = |points: &[(f64, f64)]| {
        let sum = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
        (sum.0 / points.len() as f64, sum.1 / points.len() as f64)
    };
    let mut smooth = panel.clone();
    for piece in smooth.curves.iter_mut().flat_map(|curve| &mut curve.pieces) {
        *piece = piece.chunks(together).map(mean).collect();
    }
    let drawn = format!("drawn: means over {}", counted(together, "row"));
    smooth.note = if panel.note.is_empty() { drawn } else { format!("{drawn}; {}", panel.note) };
    smooth
}

/// Without the points that lie on the one before them, within a quarter of a pixel.
fn thinned(frame: &PlotArea, piece: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    let mut last = (f64::INFINITY, f64::INFINITY);
    for point in piece.iter().filter(|p| finite(p)) {
        let pixel = frame.pixel(point.0, point.1);
        if (pixel.0 - last.0).hypot(pixel.1 - last.1) > 0.25 || last.0.is_infinite() {
            kept.push(*point);
            last = pixel;
        }
    }
    kept
}
