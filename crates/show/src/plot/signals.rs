//! Pictures of a recording: signals over time, force over penetration, spectrum, phase.
//!
//! [`panels`] computes the curves in SI units, and [`draw`] draws them. A lost row leaves a gap in every curve.

mod contact;
mod paper;

use crate::recorder::Recording;
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::control::ARM_SECONDS;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::units::JointUnits;
use haptic_bridge::safety::fault::State;
use haptic_host::error::{Choice, Failure};
use haptic_host::link::{columns, unit_of};
use haptic_host::words::{counted, with_unit};
use haptic_stability::analysis::amplitudes::{RIPPLE_HZ, SpectralLine, Spectrum, spectrum};
pub use paper::draw;
use serde::Serialize;

/// A view of a recording.
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
    /// All views with their names.
    pub const ALL: [(&'static str, Self); 4] =
        [("time", Self::Time), ("force", Self::Force), ("spectrum", Self::Spectrum), ("phase", Self::Phase)];
}

/// A request for pictures of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// Views; empty for all views that the recording has the columns for.
    pub views: Vec<View>,
    /// Columns to draw over time and as a spectrum; empty for the rendered force.
    pub signals: Vec<String>,
    /// Start time, s; `None` for the first row.
    pub from: Option<f64>,
    /// End time, s; `None` for the last row.
    pub to: Option<f64>,
}

/// A quantity along an axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantity {
    /// Name.
    pub name: String,
    /// SI unit.
    pub unit: String,
}

/// A line of a panel, interrupted where rows are missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// Name.
    pub name: String,
    /// Pieces between gaps, each a list of points in SI units.
    pub pieces: Vec<Vec<(f64, f64)>>,
}

/// One coordinate system.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Panel {
    /// View of the panel.
    pub view: View,
    /// Horizontal axis.
    pub x: Quantity,
    /// Vertical axis.
    pub y: Quantity,
    /// Curves in the panel.
    pub curves: Vec<Curve>,
    /// Ends of the straight line through the points; `None` without a line.
    pub line: Option<[(f64, f64); 2]>,
    /// Note for the reader, above the frame.
    pub note: String,
    /// Intervals of x in which a wall is touched, for signals over time.
    pub contact: Vec<(f64, f64)>,
}

/// Results of a recording in numbers, and its panels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Analysis {
    /// Number of drawn rows.
    pub rows: usize,
    /// Time that the drawn rows cover, s.
    pub seconds: f64,
    /// Number of rows missing between the drawn rows.
    pub missing: u64,
    /// Strongest spectral line of the first signal at 10 Hz or above.
    pub strongest: Option<SpectralLine>,
    /// Root mean square of the first signal above 20 Hz, in the signal's unit.
    pub ripple: Option<f64>,
    /// Stiffness of the line through force over penetration, from rows in contact whose force no limit cut, N/m.
    pub stiffness: Option<f64>,
    /// Number of rows in contact with the motors on, after the torque ramp.
    pub contact_rows: usize,
    /// Number of contact rows in which a limit cut the force; `None` if saturation is not recorded.
    pub saturated_rows: Option<usize>,
    /// Notes for the reader that belong to no panel.
    pub said: Vec<String>,
    /// The panels to draw.
    pub panels: Vec<Panel>,
    /// Number of rows that a phase portrait combines into one point.
    #[serde(skip)]
    rows_per_point: usize,
}

/// The drawn part of a recording.
struct Rows<'a> {
    recording: &'a Recording,
    rows: &'a [Vec<f64>],
    time: usize,
    /// Rows a second.
    rate_hz: f64,
    /// Index of the first row of each stretch without a gap, and the index after the last row.
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
        // A restarted board counts its steps from 0 again; the number of missing rows is then unknown.
        let step_difference = |i: usize| rows[i + 1][step] - rows[i][step];
        let every = (0..rows.len() - 1).map(step_difference).filter(|steps| *steps > 0.0).fold(f64::INFINITY, f64::min);
        let mut stretches = vec![0];
        let mut missing = 0;
        for i in 0..rows.len() - 1 {
            if step_difference(i) != every {
                stretches.push(i + 1);
                missing += (step_difference(i) / every - 1.0).max(0.0) as u64;
            }
        }
        stretches.push(rows.len());
        let between =
            (0..rows.len() - 1).find(|i| step_difference(*i) == every).map(|i| rows[i + 1][time] - rows[i][time]);
        let rate_hz = recording.rate_hz().map(|rate| rate / every).or(between.map(f64::recip)).unwrap_or(f64::NAN);
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(Failure::wrong("no two rows are consecutive, so the row rate is not known"));
        }
        Ok(Self { recording, rows, time, rate_hz, stretches, missing })
    }

    fn column(&self, name: &str) -> Result<usize, Failure> {
        self.recording.column(name).ok_or_else(|| {
            let columns = self.recording.columns.join(", ");
            Failure::wrong(format!("the recording has no column {name}")).remedy(format!("it has {columns}"))
        })
    }

    fn has_column(&self, name: &str) -> bool {
        self.recording.column(name).is_some()
    }

    /// Applies `point` to every row and returns the results in pieces without gaps.
    fn pieces(&self, point: impl Fn(usize, &[f64]) -> (f64, f64)) -> Vec<Vec<(f64, f64)>> {
        let piece = |ends: &[usize]| (ends[0]..ends[1]).map(|i| point(i, &self.rows[i])).collect();
        self.stretches.windows(2).map(piece).collect()
    }

    /// Returns the number of rows that a phase portrait averages into one point, because single rows show encoder
    /// steps. They last at least a millisecond; at 1 kHz and below every row is drawn.
    fn rows_per_point(&self) -> usize {
        (self.rate_hz / MAX_PHASE_HZ).ceil().max(1.0) as usize
    }

    /// Returns a predicate for rows in the torque ramp after arming, in which the force is less than the wall's.
    fn ramp_predicate(&self) -> impl Fn(&[f64]) -> bool {
        let armed =
            |row: &[f64]| self.recording.column("state").map(|state| row[state] == State::Armed as usize as f64);
        let pairs = self.recording.rows.windows(2);
        let switched = pairs.filter(|two| armed(&two[0]) == Some(false) && armed(&two[1]) == Some(true));
        let times: Vec<f64> = switched.map(|two| two[1][self.time]).collect();
        let time = self.time;
        move |row: &[f64]| times.iter().any(|on| (0.0..f64::from(ARM_SECONDS)).contains(&(row[time] - on)))
    }

    /// Returns the intervals (begin, end) of contact, s; empty if the recording has no distance to a wall.
    fn contact(&self) -> Vec<(f64, f64)> {
        let Some(distance) = self.recording.column("distance_m") else { return Vec::new() };
        let pieces = self.rows.chunk_by(|a, b| (a[distance] < 0.0) == (b[distance] < 0.0));
        let touched = pieces.filter(|piece| piece[0][distance] < 0.0);
        touched.map(|piece| (piece[0][self.time], piece[piece.len() - 1][self.time])).collect()
    }

    /// Returns a test for rows whose force was cut by a limit; `None` if saturation is not recorded.
    fn limit_predicate(&self) -> Option<impl Fn(&[f64]) -> bool> {
        let names = (0..MAX_JOINTS).map(|joint| format!("saturated{joint}"));
        let columns: Vec<usize> = names.filter_map(|name| self.recording.column(&name)).collect();
        (!columns.is_empty()).then_some(move |row: &[f64]| columns.iter().any(|column| row[*column] != 0.0))
    }
}

/// Row rate above which a phase portrait averages rows, Hz: encoder steps of single rows would fill an area.
const MAX_PHASE_HZ: f64 = 1000.0;
/// Lowest frequency that counts as vibration and not as motion, Hz.
const MIN_VIBRATION_HZ: f64 = 10.0;
/// Smallest drawn amplitude, relative to the strongest spectral line.
const MIN_RELATIVE_AMPLITUDE: f64 = 1e-6;

/// Returns name and unit of the column with this label; an unknown column has no unit.
pub(crate) fn column_quantity(label: &str) -> Quantity {
    let known = [&JointUnits::REVOLUTE, &JointUnits::PRISMATIC].into_iter().find_map(|units| {
        let columns = columns(Fields::ALL, &[units; MAX_JOINTS], 3);
        columns.iter().find(|column| column.label == label).map(|column| unit_of(column.field, units))
    });
    let unit = known.unwrap_or_default();
    let unit = if label == "time_s" { "s" } else { unit };
    // The "n" in "rendered_n" is the unit, which is shown separately.
    let suffix = format!("_{}", unit.to_lowercase().replace([' ', '/'], "_"));
    let name = label.strip_suffix(&suffix).filter(|_| !unit.is_empty()).unwrap_or(label);
    let name = if name == "rendered" { "force".into() } else { name.replace('_', " ") };
    Quantity { name, unit: unit.into() }
}

fn named_quantity(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

/// Computes the panels of a recording.
pub fn panels(recording: &Recording, request: &Request) -> Result<Analysis, Failure> {
    let rows = Rows::of(recording, request)?;
    let force = ["rendered_n", "force_n"].into_iter().find(|name| rows.has_column(name));
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
    let is_drawn = |view: View| match (request.views.is_empty(), view) {
        (false, view) => request.views.contains(&view),
        (true, View::Force) => force.is_some() && rows.has_column("distance_m"),
        (true, View::Phase) => rows.has_column("distance_m"),
        (true, _) => !signals.is_empty(),
    };
    let span = rows.rows[rows.rows.len() - 1][rows.time] - rows.rows[0][rows.time];
    let mut analysis = Analysis {
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
        rows_per_point: rows.rows_per_point(),
    };
    if is_drawn(View::Time) {
        analysis.panels.extend(time_panels(&rows, &signals)?);
    }
    if is_drawn(View::Force) {
        let force = force.ok_or_else(|| {
            Failure::wrong("the recording has neither rendered_n nor force_n")
                .remedy("record the fields distance, rendered")
        })?;
        let panel = contact::force_panel(&rows, force, &mut analysis)?;
        analysis.panels.push(panel);
    }
    if is_drawn(View::Spectrum) {
        let panel = spectrum_panel(&rows, &signals, &mut analysis)?;
        analysis.panels.push(panel);
    }
    if is_drawn(View::Phase) {
        let panel = phase_panel(&rows)?;
        if request.views.is_empty()
            && !is_motion(&smooth_panel(&panel, rows.rows_per_point()))
            && !analysis.panels.is_empty()
        {
            let why = "the velocity is mostly noise: it changes as much in a millisecond as over the recording";
            analysis.said.push(format!("velocity over distance is left out unless it is requested: {why}"));
        } else {
            analysis.panels.push(panel);
        }
    }
    if analysis.panels.is_empty() {
        return Err(Failure::wrong("the recording has only steps and times").remedy("record more fields"));
    }
    Ok(analysis)
}

/// Creates one time panel for each unit among the signals.
fn time_panels(rows: &Rows<'_>, signals: &[String]) -> Result<Vec<Panel>, Failure> {
    let mut panels: Vec<Panel> = Vec::new();
    for signal in signals {
        let column = rows.column(signal)?;
        let signal_quantity = column_quantity(signal);
        let curve = Curve { name: signal.clone(), pieces: rows.pieces(|_, row| (row[rows.time], row[column])) };
        match panels.iter_mut().find(|panel| panel.y.unit == signal_quantity.unit) {
            Some(panel) => {
                panel.curves.push(curve);
                panel.y.name =
                    panel.curves.iter().map(|curve| column_quantity(&curve.name).name).collect::<Vec<_>>().join(", ");
            }
            None => panels.push(Panel {
                view: View::Time,
                x: named_quantity("time", "s"),
                y: signal_quantity,
                curves: vec![curve],
                line: None,
                note: String::new(),
                contact: rows.contact(),
            }),
        }
    }
    Ok(panels)
}

/// Highest drawn frequency of a spectrum, Hz, because a hand feels nothing above it.
const MAX_SPECTRUM_HZ: f64 = 1000.0;

fn spectrum_panel(rows: &Rows<'_>, signals: &[String], analysis: &mut Analysis) -> Result<Panel, Failure> {
    let half = 0.5 * rows.rate_hz;
    let highest_hz = half.min(MAX_SPECTRUM_HZ);
    let mut panel = Panel {
        view: View::Spectrum,
        x: named_quantity("frequency", "Hz"),
        y: named_quantity("amplitude", "dB"),
        curves: Vec::new(),
        line: None,
        note: String::new(),
        contact: Vec::new(),
    };
    let unit = column_quantity(&signals[0]).unit;
    let reference = if unit.is_empty() { String::new() } else { format!(" re 1 {unit}") };
    panel.y.name.push_str(&reference);
    let mut used = 0;
    for signal in signals.iter().filter(|signal| column_quantity(signal).unit == unit) {
        let column = rows.column(signal)?;
        let values: Vec<f64> = rows.rows.iter().map(|row| row[column]).collect();
        let stretches: Vec<&[f64]> = rows.stretches.windows(2).map(|ends| &values[ends[0]..ends[1]]).collect();
        let spectrum = spectrum(&stretches, rows.rate_hz).ok_or_else(|| {
            let longest = stretches.iter().map(|stretch| stretch.len()).max().unwrap_or(0);
            Failure::wrong(format!("{} without a gap are too few for a spectrum", counted(longest, "row")))
                .remedy("record longer, or leave the spectrum out")
                .choose(Choice::DrawnSignals)
        })?;
        let Spectrum { lines, samples } = &spectrum;
        used = *samples;
        let fast = lines.iter().filter(|line| line.frequency >= MIN_VIBRATION_HZ);
        let top = fast.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
        if panel.curves.is_empty() {
            analysis.strongest = top.copied().filter(|top| top.amplitude > 0.0);
            analysis.ripple = Some(spectrum.ripple());
        }
        let shown = lines.iter().filter(|line| line.frequency <= highest_hz);
        let highest = lines.iter().fold(0.0, |highest: f64, line| highest.max(line.amplitude));
        // Draws a constant signal at the floor of its unit, not thousands of decibels below it.
        let highest = if highest > 0.0 { highest } else { 1.0 };
        let points = shown
            .map(|line| (line.frequency, 20.0 * line.amplitude.max(MIN_RELATIVE_AMPLITUDE * highest).log10()))
            .collect();
        panel.curves.push(Curve { name: signal.clone(), pieces: vec![points] });
    }
    if used < rows.rows.len() {
        let left = counted(rows.rows.len() - used, "row");
        panel.note = format!("without {left} of shorter stretches between gaps");
    }
    if let (Some(line), Some(ripple)) = (analysis.strongest, analysis.ripple) {
        let (size, ripple) = (with_unit(line.amplitude, &unit), with_unit(ripple, &unit));
        let says = format!(
            "strongest above {MIN_VIBRATION_HZ} Hz: {size} at {:.1} Hz; above {RIPPLE_HZ} Hz: {ripple} rms",
            line.frequency
        );
        panel.note = if panel.note.is_empty() { says } else { format!("{says}; {}", panel.note) };
    }
    Ok(panel)
}

fn phase_panel(rows: &Rows<'_>) -> Result<Panel, Failure> {
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
            let duration = (after - before).max(1) as f64 / rows.rate_hz;
            (rows.rows[after][distance] - rows.rows[before][distance]) / duration
        }
    };
    let note = match measured {
        Some(_) => String::new(),
        None => "velocity computed from the distance, because the recording has no column velocity_m_s".into(),
    };
    Ok(Panel {
        view: View::Phase,
        x: named_quantity("distance to the wall", "m"),
        y: named_quantity("velocity", "m/s"),
        curves: vec![Curve { name: "velocity".into(), pieces: rows.pieces(|i, row| (row[distance], speed(i, row))) }],
        line: None,
        note,
        contact: Vec::new(),
    })
}

/// Replaces every `rows_per_point` consecutive points by their mean; the last mean may have fewer.
fn smooth_panel(panel: &Panel, rows_per_point: usize) -> Panel {
    let mean = |points: &[(f64, f64)]| {
        let sum = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
        (sum.0 / points.len() as f64, sum.1 / points.len() as f64)
    };
    let mut smooth = panel.clone();
    for piece in smooth.curves.iter_mut().flat_map(|curve| &mut curve.pieces) {
        *piece = piece.chunks(rows_per_point).map(mean).collect();
    }
    let drawn = format!("drawn: means over {}", counted(rows_per_point, "row"));
    smooth.note = if panel.note.is_empty() { drawn } else { format!("{drawn}; {}", panel.note) };
    smooth
}

/// Returns true if the values of a panel's first curve are motion and not noise: the mean square difference of
/// consecutive points (von Neumann 1941) is below the variance. For noise it is twice the variance.
fn is_motion(panel: &Panel) -> bool {
    let values = || panel.curves[0].pieces.iter().flatten().map(|point| point.1);
    let count = values().count().max(1) as f64;
    let mean = values().sum::<f64>() / count;
    let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let jumps =
        panel.curves[0].pieces.iter().flat_map(|piece| piece.windows(2).map(|two| (two[1].1 - two[0].1).powi(2)));
    let (jumps, sum) = jumps.fold((0, 0.0), |(jumps, sum), jump| (jumps + 1, sum + jump));
    sum < f64::from(jumps) * variance
}
