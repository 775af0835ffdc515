//! Duration of the control interrupt from entry to exit, in instructions of the unmodified image, also by source file.
//!
//! `cargo xtask timing` measures every [`Case`] for the tables of docs/results/timing.md. Tests repeat some cases.

use std::collections::BTreeMap;

use haptic_bridge::board::telemetry::Fields;
use haptic_host::output::csv_line;

use crate::boards::BoardKind;
use crate::cases::{CASES, Case, SCENES, SceneKind};
use crate::contact::{NearWall, scene};
use crate::cycles::{Flash, estimate};
use crate::image::CONTROL_INTERRUPT;
use crate::load::{
    highest_rate, highest_sustained_rate, rows_without_loss, set_free_scene, sustains_force_limit, sustains_plane,
    sustains_scenes,
};
use crate::rig::{Rig, device_file, firmware};
use crate::run::MILLISECOND;
use crate::sources::Sources;
use crate::trace::{Code, Run};

/// Value of the state in a row of telemetry while the board is armed.
const ARMED_STATE: f64 = 1.0;
/// Traced time of each case, ns: 500 periods at 20 kHz, with a request of the tasks every 20 ms.
pub const TRACED_NS: u64 = 25 * MILLISECOND;

/// Result of a measured case.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// Number of measured steps.
    pub steps: usize,
    /// Mean number of instructions of a step.
    pub mean_step: f64,
    /// Number of instructions of the longest step.
    pub longest_step: u64,
    /// Number of instructions of the shortest step.
    pub shortest_step: u64,
    /// Mean number of instructions of a valley without a request of the tasks.
    pub valley_mean: f64,
    /// Number of instructions of the longest valley, with or without a request.
    pub longest_valley: u64,
    /// Mean number of instructions of a step in each source file.
    pub files: BTreeMap<String, f64>,
    /// Estimated cycles of the longest step, for each of [`Flash::ALL`].
    pub cycles: [u64; Flash::ALL.len()],
}

impl Case {
    /// Measures the case at its rate for [`TRACED_NS`].
    #[must_use]
    pub fn measure(&self) -> Timing {
        let mut rig = self.rig(self.rate_hz);
        rig.tool.start_stream(Fields::USUAL, 1).expect("a stream starts");
        rig.run(20 * MILLISECOND);
        let runs = rig.trace_control(TRACED_NS);
        let rows = rig.tool.rows(std::time::Duration::from_millis(10)).expect("rows come");
        // The last two columns are the state and the number of touched walls.
        let in_contact =
            |row: &haptic_host::link::Row| row.values.ends_with(&[ARMED_STATE, self.scene_kind.contacts() as f64]);
        let status = rig.tool.status();
        assert!(!rows.is_empty() && rows.iter().all(in_contact), "{} is not in contact: {status:?}", self.name());
        let image = firmware(self.board);
        let code = Code::from_firmware(image).expect("an image with code");
        Timing::from_runs(&runs, &code, &mut Sources::new(image).expect("debug information"))
    }
}

impl Timing {
    fn from_runs(runs: &[Run], code: &Code, sources: &mut Sources<'_>) -> Self {
        let (mut works, mut files) = (Vec::new(), BTreeMap::new());
        let (mut longest_valley, mut quiet, mut quiet_sum) = (0, 0_u32, 0);
        for run in runs {
            let length = run.path.len() as u64;
            if sources.is_crest(run) {
                works.push(sources.instructions_without_waiting(run));
                continue;
            }
            longest_valley = longest_valley.max(length);
            if !sources.has_request(run) {
                quiet += 1;
                quiet_sum += length;
            }
        }
        let share = 1.0 / works.len().max(1) as f64;
        for &at in works.iter().flatten() {
            *files.entry(sources.file(at).to_owned()).or_default() += share;
        }
        let lengths = || works.iter().map(|work| work.len() as u64);
        let longest = works.iter().max_by_key(|work| work.len()).map_or(&[][..], Vec::as_slice);
        Self {
            steps: works.len(),
            mean_step: lengths().sum::<u64>() as f64 * share,
            longest_step: longest.len() as u64,
            shortest_step: lengths().min().unwrap_or(0),
            valley_mean: quiet_sum as f64 / f64::from(quiet.max(1)),
            longest_valley,
            files,
            cycles: Flash::ALL.map(|flash| estimate(code, longest, flash)),
        }
    }
}

impl Rig {
    /// Returns all complete runs of the control interrupt during `span` ns.
    #[must_use]
    pub fn trace_control(&mut self, span: u64) -> Vec<Run> {
        self.trace_control_during(|rig| rig.run(span))
    }

    /// Returns all complete runs of the control interrupt during `work`.
    #[must_use]
    pub fn trace_control_during(&mut self, work: impl FnOnce(&mut Self)) -> Vec<Run> {
        let image = firmware(self.kind);
        let entry = image.symbol(CONTROL_INTERRUPT).unwrap_or_else(|error| panic!("{error}")).address;
        self.trace_function_during(entry, work)
    }

    /// Returns all complete runs of the function at `entry` during `work`. The function must not be interrupted.
    fn trace_function_during(&mut self, entry: u64, work: impl FnOnce(&mut Self)) -> Vec<Run> {
        let code = Code::from_firmware(firmware(self.kind)).expect("an image with code");
        let watched = code.clone();
        self.while_stopped(move |stopped| stopped.trace(&watched, entry));
        work(self);
        self.while_stopped(move |stopped| stopped.take_trace(&code))
    }
}

/// Devices and scenes whose control step is counted in every run of the tests.
const STEPS: [(&str, SceneKind); 8] = [
    ("hapkit-paddle", SceneKind::Wall),
    ("haply-2diy", SceneKind::Wall),
    ("fictive-five-bar-turret", SceneKind::Wall),
    ("phantom-premium-1.5", SceneKind::Wall),
    ("serial-3r", SceneKind::Wall),
    ("touch", SceneKind::Wall),
    ("falcon-like", SceneKind::Wall),
    ("haply-2diy", SceneKind::Nothing),
];

/// Returns timing-steps.csv, the instructions of the control step by device and scene. The image is a release image,
/// the motors are off and the encoder counts constant.
#[must_use]
pub fn step_table() -> String {
    let mut text = csv_line(["device", "the tip meets", "instructions"]);
    let mut rig = Rig::empty(BoardKind::HBridgeF405);
    let render = firmware(rig.kind).find_ending("8compiled6render").expect("the control step").address;
    for (device, scene_kind) in STEPS {
        rig.file = Some(device_file(device));
        rig.load("");
        rig.tool.home().expect("the device can be homed");
        rig.run(MILLISECOND);
        let tip = rig.tool.status().expect("the board replies").tip.map(f64::from);
        let task = rig.file.as_ref().map_or(2, |file| file.spec().task);
        let toward = if task == 1 { [1.0, 0.0, 0.0] } else { [0.0, -1.0, 0.0] };
        let wall = NearWall { gap: -0.003, ..NearWall::with_normal(toward) };
        let walls = if scene_kind == SceneKind::Wall { &[wall][..] } else { &[] };
        rig.set_scene(&scene("", tip, task, walls));
        rig.run(MILLISECOND);
        let runs = rig.trace_function_during(render, |rig| rig.run(MILLISECOND));
        let longest = runs.iter().map(|run| run.path.len()).max().expect("control steps");
        text += &csv_line([device, scene_kind.name(), &longest.to_string()]);
    }
    text
}

/// Name of the row with the longest step.
const LONGEST_ROW: &str = "longest";
/// Name of the row with the longest valley.
const VALLEY_ROW: &str = "longest at a valley, a request";

/// Returns timing.csv, the table of the timings of [`CASES`] with one column per case.
#[must_use]
pub fn table(timings: &[Timing]) -> String {
    let mut text = csv_line(std::iter::once("instructions".to_owned()).chain(CASES.iter().map(Case::name)));
    let mut row = |name: &str, cells: Vec<String>| {
        text += &csv_line(std::iter::once(name.to_owned()).chain(cells));
    };
    let each = |value: fn(&Timing) -> u64| timings.iter().map(|timing| value(timing).to_string()).collect();
    row("mean", timings.iter().map(|timing| format!("{:.0}", timing.mean_step)).collect());
    row("shortest", each(|timing| timing.shortest_step));
    row(LONGEST_ROW, each(|timing| timing.longest_step));
    row("jitter", each(|timing| timing.longest_step - timing.shortest_step));
    let target = |(case, timing): (&Case, &Timing)| case.verdict(timing);
    row("aimed at, mean", CASES.iter().zip(timings).map(target).collect());
    row("valley: mean, no request", timings.iter().map(|timing| format!("{:.0}", timing.valley_mean)).collect());
    row(
        "crest and valley, mean",
        timings.iter().map(|timing| format!("{:.0}", timing.mean_step + timing.valley_mean)).collect(),
    );
    row(VALLEY_ROW, each(|timing| timing.longest_valley));
    let names = ["core alone", "flash as the firmware sets it", "flash without cache and prefetch"];
    for (nth, name) in names.into_iter().enumerate() {
        row(
            &format!("estimated cycles of the longest step, {name}"),
            timings.iter().map(|timing| timing.cycles[nth].to_string()).collect(),
        );
    }
    text
}

/// Returns timing-scenes.csv, the table of the timings of [`SCENES`] on a five-bar.
#[must_use]
pub fn scene_table(timings: &[Timing]) -> String {
    let mut text = csv_line([
        "the tip meets",
        "mean",
        "shortest",
        "longest",
        "aimed at, mean",
        "cycles of the longest, with the flash as set",
    ]);
    for (case, timing) in SCENES.iter().zip(timings) {
        text += &csv_line([
            case.scene_kind.name(),
            &format!("{:.0}", timing.mean_step),
            &timing.shortest_step.to_string(),
            &timing.longest_step.to_string(),
            &case.verdict(timing),
            &timing.cycles[1].to_string(),
        ]);
    }
    text
}

impl Case {
    fn verdict(&self, timing: &Timing) -> String {
        let (target, mean) = (self.target, timing.mean_step.round() as u64);
        if mean <= target { format!("{target}: met") } else { format!("{target}: missed by {}", mean - target) }
    }
}

/// Returns timing-new-scenes.csv. Each measurement takes 5 ms from the request for a new scene while the motors are on.
#[must_use]
pub fn new_scene_table() -> String {
    let mut text = csv_line(["case", "longest at a valley", "longest step", "median step"]);
    for case in [&CASES[0], &CASES[2], &CASES[4]] {
        let mut rig = case.rig(case.rate_hz);
        let runs = rig.trace_control_during(|rig| {
            set_free_scene(rig, case.rate_hz, 0);
            rig.run(5 * MILLISECOND);
        });
        let mut sources = Sources::new(firmware(case.board)).expect("debug information");
        let (mut steps, mut valleys) = (Vec::new(), Vec::new());
        for run in &runs {
            let kind = if sources.is_crest(run) { &mut steps } else { &mut valleys };
            kind.push(run.path.len());
        }
        steps.sort_unstable();
        let of = |lengths: &[usize], at: usize| lengths.get(at).map_or("none".to_owned(), usize::to_string);
        let valley = valleys.iter().max().map_or("none".to_owned(), usize::to_string);
        let (longest, median) = (of(&steps, steps.len().saturating_sub(1)), of(&steps, steps.len() / 2));
        text += &csv_line([case.name(), valley, longest, median]);
    }
    text
}

/// Returns timing-rates.csv, the rates that a five-bar and two three-joint devices sustain.
#[must_use]
pub fn rate_table() -> String {
    let mut text = csv_line([
        "case",
        "highest control rate (Hz)",
        "aimed at",
        "with new scenes",
        "with a host's plane",
        "with a limit that cuts",
        "rows a second without loss",
        "rows aimed at",
    ]);
    let targets = [(&CASES[0], "50000", "20000"), (&CASES[2], "35000", ""), (&CASES[4], "35000", "")];
    let lines = haptic_stability::cores::map(&targets, &|_, _| (), |(case, rate, rows)| {
        let cell = |found: Option<u32>| found.map_or("none".to_owned(), |found| found.to_string());
        let (highest, lossless) = (cell(highest_rate(case)), cell(rows_without_loss(case)));
        let (scenes, plane) =
            (cell(highest_sustained_rate(case, sustains_scenes)), cell(highest_sustained_rate(case, sustains_plane)));
        let cuts = cell(highest_sustained_rate(case, sustains_force_limit));
        csv_line([&case.name(), &highest, *rate, &scenes, &plane, &cuts, &lossless, *rows])
    });
    lines.into_iter().for_each(|line| text += &line);
    text
}

/// Returns the longest step and the longest valley of `case` in a table from [`table`].
#[must_use]
pub fn recorded_lengths(text: &str, case: &Case) -> Option<(u64, u64)> {
    let column = CASES.iter().position(|other| other.name() == case.name())?;
    let number = |name: &str| {
        // Numeric cells contain no commas.
        let cells = text.lines().find_map(|line| line.strip_prefix(&csv_line([name]).replace('\n', ",")))?;
        cells.split(',').nth(column)?.parse().ok()
    };
    Some((number(LONGEST_ROW)?, number(VALLEY_ROW)?))
}
