//! The report of a measurement: its points and the theory of the same loop, as a table, JSON or a picture.

use super::{Args, FrictionKind};
use crate::commands::port::counted;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::words::{joint_units, listed};
use haptic_predict::measure::MeasurementSetup;
use haptic_predict::measure::campaign::Plan;
use haptic_predict::measure::excitation::{Excitation, millimetres};
use haptic_predict::measure::progress::{Point, Progress, bounds, median};
use haptic_predict::plausible::{FileWarning, Warning, warn};
use haptic_show::plot::range::{Contents, MeasuredPoint, draw};
use haptic_stability::analysis::control_loop::Mode;
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::prediction::{Prediction, Subject, Walls, round_as_printed};
use haptic_stability::analysis::range::{BoundaryPoint, Range};
use haptic_stability::analysis::sampled::Loop;
use haptic_stability::analysis::several::Member;
use serde_json::json;
use std::fmt::Write;

pub struct Theory {
    device: Walls,
    walls: Vec<Member>,
    around: Loop,
    excitation: Excitation,
    /// The `haptic range` command that predicts the same loop, without the option --kd.
    line: String,
    q: Vec<f64>,
    /// Unit of `q`.
    unit: String,
}

fn option_value(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
}

impl Theory {
    /// Computes the theory of a measurement at `q` in the loop `around`.
    pub fn new(
        args: &Args,
        file: &DeviceFile,
        setup: &MeasurementSetup,
        q: &[f64],
        around: Loop,
        excitation: Excitation,
    ) -> Result<Self, PoseError> {
        let walls = setup.walls.clone();
        let subject = Subject::new(&file.description)?;
        let prediction = Prediction { posture: setup.law.posture, ..Prediction::new(subject, around) };
        let device = prediction.walls(q, &walls)?;
        let mut line = format!("haptic range {} --q={}", args.device.display(), option_value(q));
        line += &args.walls.options();
        line += &prediction.loop_options(prediction.gain);
        if file.description.joints.iter().all(|joint| joint.viscous == 0.0) {
            line.push_str(" --undamped");
        }
        if args.feed_forward.contains(&FeedForward::Washout) {
            let _ = write!(line, " --washout {}", args.washout);
        }
        let unit = joint_units(&file.description.units(), |joint| joint.travel);
        Ok(Self { device, walls, around: prediction.around, excitation, line, q: q.to_vec(), unit })
    }

    /// Returns the felt stiffness of a wall at the tip (N/m) if transmissions are compliant.
    fn felt_stiffness(&self, mode: FeedForward, kp: f64) -> Option<f64> {
        let Walls::One(device) = &self.device else { return None };
        // The corner does not matter, because a washout has no effect at rest.
        device.felt_stiffness(Mode::of(mode, 0.0), kp)
    }

    fn predict(&self, kd: Option<&[f64]>, washout: Option<f64>) -> Result<Range, Failure> {
        Ok(self.device.range(&self.around, kd, washout)?)
    }
}

/// Results over the complete range of one mode.
#[derive(serde::Serialize)]
struct Area {
    mode: FeedForward,
    /// ∫ kp dkd of the stiffness that was stable at every pull, N² s/m².
    measured: f64,
    /// ∫ kp dkd of the theory, N² s/m².
    theory: f64,
    /// Largest difference between the measured stiffness and the theory, as a share of the theory's maximum.
    furthest: f64,
    /// Largest spread of the repeats of a pull, as a share of their median.
    spread: f64,
}

/// Returns the difference of the largest and the smallest repeat, as a share of the median.
fn relative_spread(repeats: &[f64]) -> f64 {
    let ((low, high), median) = (bounds(repeats), median(repeats));
    if median > 0.0 { (high - low) / median } else { 0.0 }
}

/// Distance between the dots of two pulls in the picture, pixels.
const DOT_DISTANCE: f64 = 7.0;

/// Share of the theory's stiffness below which a boundary is reported as implausible: the effects that the theory omits
/// reduce it by at most a fifth on the simulated board (docs/results/complete.md).
const IMPLAUSIBLE_SHARE: f64 = 0.5;

pub struct Report<'a> {
    pub name: &'a str,
    pub args: &'a Args,
    pub plan: &'a Plan,
    pub progress: &'a Progress,
    pub theory: Theory,
}

impl Report<'_> {
    pub fn has_points(&self) -> bool {
        self.plan.modes.iter().any(|mode| !self.planned_points(*mode).is_empty())
    }

    pub fn has_boundary(&self) -> bool {
        self.plan.modes.iter().any(|mode| self.planned_points(*mode).iter().any(|point| !point.repeats.is_empty()))
    }

    /// Returns the points at dampings of the plan; a progress file may contain other dampings too.
    fn planned_points(&self, mode: FeedForward) -> Vec<&Point> {
        self.plan.points_of_plan(self.progress.points_of_mode(mode))
    }

    pub fn write(&self) -> Result<(), Failure> {
        let args = self.args;
        let warnings = self.implausible_boundaries()?;
        warn(&warnings);
        if args.pictures.is_requested() {
            args.pictures.save(&self.picture()?)?;
        }
        args.json.answer(self.document(&warnings)?, &self.table()?)
    }

    /// Returns a warning if boundaries are far below the theory.
    fn implausible_boundaries(&self) -> Result<Vec<Warning>, Failure> {
        let mut rows = Vec::new();
        for &mode in &self.plan.modes {
            let points = self.points_with_theory(mode)?.into_iter().filter(|(point, _)| !point.repeats.is_empty());
            let far = points
                .filter(|(point, theory)| self.plan.stiffness_at_every_pull(point) < IMPLAUSIBLE_SHARE * theory.kp);
            rows.extend(far.map(|(point, _)| format!("{} at kd {:.4}", mode.name(), point.kd)));
        }
        let text = format!(
            "less than half of theory's stiffness was stable ({}): possible causes are a hand on the device, another force on \
             the tip, or friction that holds a joint; remove the cause and measure again with --anew",
            listed(&rows)
        );
        Ok(if rows.is_empty() { Vec::new() } else { vec![FileWarning { key: None, text }.for_command_line()] })
    }

    fn washout(&self) -> Option<f64> {
        self.plan.modes.contains(&FeedForward::Washout).then_some(self.args.washout)
    }

    /// Returns the points of a mode with the theory at the same dampings.
    fn points_with_theory(&self, mode: FeedForward) -> Result<Vec<(&Point, BoundaryPoint)>, Failure> {
        let points = self.planned_points(mode);
        let kd: Vec<f64> = points.iter().map(|point| round_as_printed(point.kd)).collect();
        let range = self.theory.predict(Some(&kd), self.washout())?;
        Ok(points.into_iter().zip(range.of(mode).boundary.iter().copied()).collect())
    }

    fn range_command(&self) -> String {
        let points = self.plan.modes.iter().flat_map(|mode| self.planned_points(*mode));
        let mut kd: Vec<f64> = points.map(|point| round_as_printed(point.kd)).collect();
        kd.sort_by(f64::total_cmp);
        kd.dedup();
        format!("{} --kd {}", self.theory.line, option_value(&kd))
    }

    /// Returns the longest pull of this strength, mm.
    fn pull_mm(&self, strength: f64) -> f64 {
        (self.theory.excitation.longest_pull * strength * 1e6).round() / 1e3
    }

    fn drive(&self) -> String {
        match self.theory.around.drive {
            Drive::Current { bandwidth_hz } => format!("current loop of {bandwidth_hz} Hz"),
            _ => "ideal drive".into(),
        }
    }

    /// Describes pose, walls and loop in two lines, with numbers formatted by `joined`.
    fn describe_setting(&self, joined: fn(&[f64]) -> String) -> [String; 2] {
        let (args, around) = (self.args, &self.theory.around);
        let normals: Vec<String> = args.walls.normals().map(|normal| format!("({})", joined(&normal.0))).collect();
        let mut place = format!("q = ({}) {}, n = {}", joined(&self.theory.q), self.theory.unit, normals.join(" + "));
        if let Some(parts) = args.walls.shares() {
            let _ = write!(place, ", parts {}", joined(&parts.0));
        }
        [
            place,
            format!(
                "{} Hz, cutoff {} Hz, delay {}, {}",
                args.rate,
                args.cutoff,
                counted(around.delay_samples, "sample"),
                self.drive()
            ),
        ]
    }

    fn table(&self) -> Result<String, Failure> {
        let [place, around] = self.describe_setting(|values| option_value(values).replace(',', ", "));
        let mut text =
            format!("{}: largest stable stiffness, measured ({} repeats of each pull)\n", self.name, self.plan.repeats);
        if let Some(date) = &self.progress.date {
            let _ = writeln!(text, "  last result on {date}");
        }
        let _ = writeln!(text, "  {place}\n  {around}\n");
        let _ = writeln!(
            text,
            "{:>9}{:>11}{:>9}{:>12}{:>12}{:>12}{:>12}  beyond it",
            "", "kd N s/m", "pull mm", "lowest", "median", "highest", "theory"
        );
        let mut open = Vec::new();
        for &mode in &self.plan.modes {
            for (point, theory) in self.points_with_theory(mode)? {
                let label = format!("{mode:?}").to_lowercase();
                let beyond = match (&point.open, point.vibration_m) {
                    (Some(_), _) if point.repeats.is_empty() => "not measured".into(),
                    (_, Some(size)) => format!("vibrates by {} mm", millimetres(size)),
                    (_, None) => "grows".into(),
                };
                let mut row = |pull: &str, [low, median, high]: [String; 3], felt: &str| {
                    let _ = writeln!(
                        text,
                        "{label:>9}{:>11.4}{pull:>9}{low:>12}{median:>12}{high:>12}{:>12.2}  {beyond}{felt}",
                        point.kd, theory.kp
                    );
                };
                if let (Some(why), true) = (&point.open, point.repeats.is_empty()) {
                    row("", [String::new(), format!("> {:.0}", why.stable_up_to), String::new()], "");
                }
                for (pull, repeats) in self.plan.repeats_by_pull(point) {
                    let (median, (low, high)) = (median(&repeats), bounds(&repeats));
                    let felt = self.theory.felt_stiffness(mode, median);
                    let felt = felt.map_or(String::new(), |felt| format!("; felt at the tip: {felt:.0} N/m"));
                    let pull =
                        format!("{:+.3}", self.pull_mm(pull)).trim_end_matches('0').trim_end_matches('.').to_string();
                    row(&pull, [low, median, high].map(|kp| format!("{kp:.2}")), &felt);
                }
                if let Some(why) = &point.open {
                    open.push((label, point, why, theory.kp));
                }
            }
        }
        text.push('\n');
        for (label, point, why, theory) in open {
            let _ = writeln!(
                text,
                "{label} at kd {:.4}, repeat {}: stable up to {:.0} N/m, then: {}{}",
                point.kd,
                point.repeats.len() + 1,
                why.stable_up_to,
                why.reason,
                self.encoder_advice(theory.max(why.stable_up_to))
            );
        }
        for (mode, why) in &self.progress.open_ends {
            let _ = writeln!(text, "{mode:?}: the damping at which the range ends was not found: {why}");
        }
        for area in self.areas()? {
            let _ = writeln!(
                text,
                "{:?}: area {:.0} N²s/m², theory {:.0}; largest difference {:.2} % of the theory's highest stiffness",
                area.mode,
                area.measured,
                area.theory,
                100.0 * area.furthest
            );
        }
        let Excitation { quantum, friction, .. } = self.theory.excitation;
        let _ = writeln!(
            text,
            "An encoder step is {} mm here. A motion that continues by more than 6 steps from peak to peak is a vibration.",
            millimetres(quantum)
        );
        if friction > 0.0 {
            let _ = writeln!(
                text,
                "Coulomb friction of {friction:.3} N at the tip stops small swings: the boundary depends on the pulls, is \
                 usually above the theory, and may not repeat."
            );
        }
        let _ = writeln!(
            text,
            "The theory has no Coulomb friction, hand, encoder steps or saturation. Its command is:\n  {}",
            self.range_command()
        );
        Ok(text)
    }

    /// Describes the encoders that a measurement up to `stiffness` (N/m) needs, if the present ones are too coarse.
    fn encoder_advice(&self, stiffness: f64) -> String {
        let Excitation { force, .. } = self.theory.excitation;
        let factor = 2.0 * self.theory.excitation.shortest_pull() * stiffness / force;
        if factor <= 1.0 {
            return String::new();
        }
        format!("; encoders with {:.0} times the counts could measure it", factor.ceil())
    }

    /// Returns the areas under the boundaries, for ranges that were measured completely.
    fn areas(&self) -> Result<Vec<Area>, Failure> {
        let mut areas = Vec::new();
        if self.plan.kd.is_some() {
            return Ok(areas);
        }
        let range = self.theory.predict(None, self.washout())?;
        for &mode in &self.plan.modes {
            let points = self.points_with_theory(mode)?;
            let (Some(end), true) = (self.progress.end(mode), points.len() == self.plan.points) else { continue };
            if points.iter().any(|(point, _)| point.repeats.is_empty()) {
                continue;
            }
            let domain = range.of(mode);
            let top = domain.boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
            let apart =
                points.iter().map(|(point, theory)| (self.plan.stiffness_at_every_pull(point) - theory.kp).abs() / top);
            // Integrates with cells of equal width, because the dampings are the middles of cells.
            let cell = end / self.plan.points as f64;
            areas.push(Area {
                mode,
                measured: points.iter().map(|(point, _)| self.plan.stiffness_at_every_pull(point) * cell).sum(),
                theory: domain.area,
                furthest: apart.fold(0.0, f64::max),
                spread: points
                    .iter()
                    .flat_map(|(point, _)| self.plan.repeats_by_pull(point))
                    .map(|(_, repeats)| relative_spread(&repeats))
                    .fold(0.0, f64::max),
            });
        }
        Ok(areas)
    }

    fn document(&self, warnings: &[Warning]) -> Result<serde_json::Value, Failure> {
        let mut points = Vec::new();
        for &mode in &self.plan.modes {
            for (point, theory) in self.points_with_theory(mode)? {
                let (low, high) = point.bounds();
                let found = (!point.repeats.is_empty()).then(|| (self.plan.stiffness_at_every_pull(point), low, high));
                let pulls: Vec<_> = self
                    .plan
                    .repeats_by_pull(point)
                    .into_iter()
                    .map(|(pull, repeats)| {
                        let (low, high) = bounds(&repeats);
                        json!({ "pull_mm": self.pull_mm(pull), "low": low, "median": median(&repeats), "high": high })
                    })
                    .collect();
                let mut entry = json!({
                    "mode": mode,
                    "kd": point.kd,
                    "kp": found.map(|found| found.0),
                    "low": found.map(|found| found.1),
                    "high": found.map(|found| found.2),
                    "pulls": pulls,
                    "repeats": point.repeats,
                    "vibration_m": point.vibration_m,
                    "open": point.open,
                    "theory_kp": theory.kp,
                });
                if let Some(felt) = found.and_then(|found| self.theory.felt_stiffness(mode, found.0)) {
                    entry["felt"] = felt.into();
                }
                points.push(entry);
            }
        }
        let walls: Vec<_> = self
            .theory
            .walls
            .iter()
            .map(|wall| json!({ "normal": wall.normal, "share": wall.share, "feed_forward": wall.feed_forward }))
            .collect();
        Ok(json!({
            "date": self.progress.date,
            "q": self.theory.q,
            "walls": walls,
            "rate_hz": self.args.rate,
            "cutoff_hz": self.args.cutoff,
            "delay_samples": self.theory.around.delay_samples,
            "drive": self.drive(),
            "theory": self.range_command(),
            "encoder_step_m": self.theory.excitation.quantum,
            "areas": self.areas()?,
            "points": points,
            "warnings": warnings,
        }))
    }

    fn picture(&self) -> Result<haptic_show::plot::Picture, Failure> {
        let range = self.theory.predict(None, self.washout())?;
        // Places the dots of the pulls side by side, so that their bars do not hide each other.
        let beside = |nth: usize| (nth as f64 - (self.plan.pulls.len() as f64 - 1.0) / 2.0) * DOT_DISTANCE;
        let dots = |mode| -> Vec<MeasuredPoint> {
            let of = |point: &Point| {
                let (kd, pulls) = (point.kd, self.plan.repeats_by_pull(point).into_iter().enumerate());
                let dot = |(nth, (_, repeats)): (usize, (f64, Vec<f64>))| {
                    let (low, high) = bounds(&repeats);
                    MeasuredPoint { kd, kp: median(&repeats), low, high, beside: beside(nth) }
                };
                pulls.map(dot).collect::<Vec<_>>()
            };
            self.planned_points(mode).into_iter().flat_map(of).collect()
        };
        let pulls: Vec<String> = self.plan.pulls.iter().map(|pull| format!("{:+}", self.pull_mm(*pull))).collect();
        let (off, full, washed) = (dots(FeedForward::Off), dots(FeedForward::Full), dots(FeedForward::Washout));
        Ok(draw(&Contents {
            title: format!("{}: stable walls, measured and predicted", self.name),
            subtitle: self
                .describe_setting(|values| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ")),
            range: &range,
            passivity: None,
            washout_hz: self.washout(),
            measured_off: &off,
            measured: format!("measured, pulled by {} mm: median and all repeats", listed(&pulls)),
            measured_full: if full.is_empty() { &washed } else { &full },
            note: self.left_out_note(),
            paper: self.args.pictures.paper(),
        }))
    }

    /// Describes the damping that only the measurement has and that lifts the dots above the curves.
    fn left_out_note(&self) -> Option<String> {
        let known = matches!(self.args.friction, Some(FrictionKind::Viscous | FrictionKind::None));
        let dry = !self.args.frictionless && !known;
        let hand = self.args.grip.then_some("the hand that holds the tip");
        let left: Vec<String> = hand.into_iter().chain(dry.then_some("dry friction")).map(Into::into).collect();
        (!left.is_empty()).then(|| {
            format!("The curves leave out {}, which damps the measured wall: the dots lie above them.", listed(&left))
        })
    }
}
