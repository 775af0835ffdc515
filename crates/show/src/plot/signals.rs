//! Pictures of a recording: signals over time, force over penetration, spectrum, phase.
//!
//! The curves are worked out first, as points in SI units ([`panels`]), and then put on paper ([`draw`]). A row that
//! was lost is a gap: no line leads over it.

mod contact;
mod paper;

use crate::recorder::Recording;
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::control::ARM_SECONDS;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::State;
use haptic_host::error::{Choice, Failure};
use haptic_host::link::columns;
use haptic_host::words::{counted, with_unit};
use haptic_stability::analysis::amplitudes::{RIPPLE_HZ, SpectralLine, Spectrum, spectrum};
pub use paper::draw;
use serde::Serialize;

/// A view of a recording that can be drawn.
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

/// A request for pictures of a recording.
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
}

/// A quantity along an axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// Its name.
    pub name: String,
    /// SI unit.
    pub unit: String,
}

/// A line of a panel, in pieces where rows are missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// Points in SI units.
    pub pieces: Vec<Vec<(f64, f64)>>,
}

/// One coordinate system.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Panel {
    /// The view that it belongs to.
    pub view: View,
    /// Along the horizontal axis.
    pub x: Quantity,
    /// Along the vertical axis.
    pub y: Quantity,
    /// Its lines.
    pub curves: Vec<Curve>,
    /// Ends of the straight line through its points, where there is one.
    pub line: Option<[(f64, f64); 2]>,
    /// A note for the reader, above the frame.
    pub note: String,
}

/// The findings of a recording in numbers, and its panels.
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
    /// Root mean square of what that signal has from 20 Hz on, in its unit.
    pub ripple: Option<f64>,
    /// Stiffness of the line through force over penetration, in contact and where no limit cut the force, N/m.
    pub stiffness: Option<f64>,
    /// Rows in contact with the motors on, after torque has ramped up.
    pub contact_rows: usize,
    /// Of these, rows in which a limit cut the force; none where the recording does not say.
    pub saturated_rows: Option<usize>,
    /// Notes for the reader beside the panels.
    pub said: Vec<String>,
    /// The panels to draw.
    pub panels: Vec<Panel>,
    /// Rows of which a phase portrait is drawn as one.
    #[serde(skip)]
    together: usize,
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

    /// Number of rows that are drawn as one because single rows show encoder steps. Together they last at least a
    /// millisecond; at a kilohertz and below every row is drawn by itself.
    fn together(&self) -> usize {
        (self.rate_hz / SMOOTHED_HZ).ceil().max(1.0) as usize
    }

    /// A test for rows in which torque still ramps up after the motors were switched on: their force is less than the
    /// wall asks for.
    fn ramping(&self) -> impl Fn(&[f64]) -> bool {
        let armed =
            |row: &[f64]| self.recording.column("state").map(|state| row[state] == State::Armed as usize as f64);
        let pairs = self.recording.rows.windows(2);
        let switched = pairs.filter(|two| armed(&two[0]) == Some(false) && armed(&two[1]) == Some(true));
        let times: Vec<f64> = switched.map(|two| two[1][self.time]).collect();
        let time = self.time;
        move |row: &[f64]| times.iter().any(|on| (0.0..f64::from(ARM_SECONDS)).contains(&(row[time] - on)))
    }

    /// A test for rows whose force was cut by a limit; `None` if the recording does not say.
    fn cut(&self) -> Option<impl Fn(&[f64]) -> bool> {
        let names = (0..MAX_JOINTS).map(|joint| format!("saturated{joint}"));
        let columns: Vec<usize> = names.filter_map(|name| self.recording.column(&name)).collect();
        (!columns.is_empty()).then_some(move |row: &[f64]| columns.iter().any(|column| row[*column] != 0.0))
    }
}

/// A phase portrait of faster rows is drawn of means: differences between single rows are encoder steps, whose speeds
/// make an area of its line.
const SMOOTHED_HZ: f64 = 1000.0;
/// Anything slower is a motion and no vibration, Hz.
const SLOW_HZ: f64 = 10.0;
/// A millionth of the strongest line is nothing.
const FLOOR: f64 = 1e-6;

/// Unit and name of a column by its label; what this tool does not know has none.
pub(crate) fn quantity(label: &str) -> Quantity {
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
        ripple: None,
        stiffness: None,
        contact_rows: 0,
        saturated_rows: None,
        said: Vec::new(),
        panels: Vec::new(),
        together: rows.together(),
    };
    if drawn(View::Time) {
        found.panels.extend(over_time(&rows, &signals)?);
    }
    if drawn(View::Force) {
        let force = force.ok_or_else(|| {
            Failure::wrong("the recording has neither rendered_n nor force_n")
                .remedy("record the fields distance, rendered")
        })?;
        let panel = contact::over_penetration(&rows, force, &mut found)?;
        found.panels.push(panel);
    }
    if drawn(View::Spectrum) {
        let panel = amplitudes(&rows, &signals, &mut found)?;
        found.panels.push(panel);
    }
    if drawn(View::Phase) {
        let panel = phase(&rows)?;
        if request.views.is_empty() && !moves(&smoothed(&panel, rows.together())) && !found.panels.is_empty() {
            let why = "the velocity is noise, from millisecond to millisecond as large as over all";
            found.said.push(format!("velocity over distance is left out unless it is asked for: {why}"));
        } else {
            found.panels.push(panel);
        }
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
                line: None,
                note: String::new(),
            }),
        }
    }
    Ok(panels)
}

/// Highest frequency that a spectrum shows, Hz: beyond it a hand feels nothing.
const MOST_HZ: f64 = 1000.0;

fn amplitudes(rows: &Rows<'_>, signals: &[String], found: &mut Found) -> Result<Panel, Failure> {
    let half = 0.5 * rows.rate_hz;
    let most = half.min(MOST_HZ);
    let mut panel = Panel {
        view: View::Spectrum,
        x: named("frequency", "Hz"),
        y: named("amplitude", "dB"),
        curves: Vec::new(),
        line: None,
        note: String::new(),
    };
    let unit = quantity(&signals[0]).unit;
    let reference = if unit.is_empty() { String::new() } else { format!(" re 1 {unit}") };
    panel.y.name.push_str(&reference);
    let mut used = 0;
    for signal in signals.iter().filter(|signal| quantity(signal).unit == unit) {
        let column = rows.column(signal)?;
        let values: Vec<f64> = rows.rows.iter().map(|row| row[column]).collect();
        let stretches: Vec<&[f64]> = rows.stretches.windows(2).map(|ends| &values[ends[0]..ends[1]]).collect();
        let spectrum = spectrum(&stretches, rows.rate_hz).ok_or_else(|| {
            let most = stretches.iter().map(|stretch| stretch.len()).max().unwrap_or(0);
            Failure::wrong(format!("{} without a gap are too few for a spectrum", counted(most, "row")))
                .remedy("record longer, or leave the spectrum out")
                .choose(Choice::Shown)
        })?;
        let Spectrum { lines, samples } = &spectrum;
        used = *samples;
        let fast = lines.iter().filter(|line| line.frequency >= SLOW_HZ);
        let top = fast.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
        if panel.curves.is_empty() {
            found.strongest = top.copied().filter(|top| top.amplitude > 0.0);
            found.ripple = Some(spectrum.ripple());
        }
        let shown = lines.iter().filter(|line| line.frequency <= most);
        let highest = lines.iter().fold(0.0, |highest: f64, line| highest.max(line.amplitude));
        // A signal that never moved lies at its unit's floor, and not thousands of decibels below it.
        let highest = if highest > 0.0 { highest } else { 1.0 };
        let points = shown.map(|line| (line.frequency, 20.0 * line.amplitude.max(FLOOR * highest).log10())).collect();
        panel.curves.push(Curve { name: signal.clone(), pieces: vec![points] });
    }
    if used < rows.rows.len() {
        let left = counted(rows.rows.len() - used, "row");
        panel.note = format!("without {left} of shorter stretches between gaps");
    }
    if let (Some(line), Some(ripple)) = (found.strongest, found.ripple) {
        let (size, ripple) = (with_unit(line.amplitude, &unit), with_unit(ripple, &unit));
        let says = format!(
            "strongest above {SLOW_HZ} Hz: {size} at {:.1} Hz; above {RIPPLE_HZ} Hz: {ripple} rms",
            line.frequency
        );
        panel.note = if panel.note.is_empty() { says } else { format!("{says}; {}", panel.note) };
    }
    Ok(panel)
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
        line: None,
        note,
    })
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

/// Returns true if the values of a panel's first curve go somewhere, and do not only jump: the mean square from point
/// to point (von Neumann 1941) is below their variance, of which noise has twice as much.
fn moves(panel: &Panel) -> bool {
    let values = || panel.curves[0].pieces.iter().flatten().map(|point| point.1);
    let count = values().count().max(1) as f64;
    let mean = values().sum::<f64>() / count;
    let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let jumps =
        panel.curves[0].pieces.iter().flat_map(|piece| piece.windows(2).map(|two| (two[1].1 - two[0].1).powi(2)));
    let (jumps, sum) = jumps.fold((0, 0.0), |(jumps, sum), jump| (jumps + 1, sum + jump));
    sum < f64::from(jumps) * variance
}
