//! What the control interrupt takes, entry to exit, in instructions of the unmodified image: by stage, mean, worst,
//! jitter.
//!
//! `cargo xtask timing` measures every [`Case`] and writes the table that docs/results.md leads to; a test measures
//! some of them again and compares.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use haptic_bridge::board::telemetry::Fields;

use crate::cases::{CASES, Case, SCENES};
use crate::cycles::{Flash, Kind, estimate, kinds};
use crate::image::CONTROL_INTERRUPT;
use crate::load::{
    highest_for, highest_rate, rows_without_loss, set_free_scene, takes_a_plane, takes_cuts, takes_scenes,
};
use crate::rig::{Rig, firmware};
use crate::run::MILLISECOND;
use crate::stages::{AT_VALLEYS, ENCODERS, REQUEST, STAGES, Stages, WAITING};
use crate::trace::{Code, Run};

/// The state of a row of telemetry.
const ARMED: f64 = 1.0;
/// What is traced of each case, ns: 500 periods at 20 kHz, with a request of the tasks every 20 ms.
pub const SPAN: u64 = 25 * MILLISECOND;

/// A measured case.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// Steps measured.
    pub periods: usize,
    /// Their mean.
    pub mean: f64,
    /// The longest of them.
    pub longest: u64,
    /// The shortest of them.
    pub shortest: u64,
    /// Mean of the valleys that carry out no request of the tasks, and the longest of all.
    pub valley_mean: f64,
    /// See there.
    pub valley: u64,
    /// Mean of each of [`STAGES`] over the steps, or over those valleys where it is theirs.
    pub stages: Vec<f64>,
    /// Cycles that the longest of them is estimated to take, for each [`Flash::ALL`].
    pub cycles: [u64; Flash::ALL.len()],
    /// Its instructions of each of [`Kind::ALL`].
    pub kinds: [u64; Kind::ALL.len()],
    /// Functions of the step that no stage names.
    pub unnamed: BTreeSet<String>,
}

impl Case {
    /// Measures [`SPAN`] of it at its rate.
    ///
    /// # Panics
    ///
    /// When the image lacks the handler or its debug information, or the device is not in contact all the time.
    #[must_use]
    pub fn measure(&self) -> Timing {
        let mut rig = self.rig(self.rate_hz);
        rig.tool.start_stream(Fields::USUAL, 1).expect("a stream starts");
        rig.run(20 * MILLISECOND);
        let runs = rig.trace_control(SPAN);
        let rows = rig.tool.rows(std::time::Duration::from_millis(10)).expect("rows come");
        // The last two columns are the state and the number of walls touched.
        let in_contact = |row: &haptic::link::Row| row.values.ends_with(&[ARMED, self.meets.contacts() as f64]);
        let status = rig.tool.status();
        assert!(!rows.is_empty() && rows.iter().all(in_contact), "{} is not in contact: {status:?}", self.name());
        let image = firmware(self.board);
        let code = Code::of(image).expect("an image with code");
        Timing::of(&runs, &code, &mut Stages::of(image).expect("debug information"))
    }
}

impl Timing {
    fn of(runs: &[Run], code: &Code, stages: &mut Stages<'_>) -> Self {
        let place = |stage: &str| STAGES.iter().position(|(name, _)| *name == stage).unwrap_or(0);
        let (encoders, waiting, request) = (place(ENCODERS), place(WAITING), place(REQUEST));
        let (mut sums, mut valleys) = (vec![0; STAGES.len()], vec![0; STAGES.len()]);
        let mut works: Vec<Vec<u32>> = Vec::new();
        let (mut valley, mut quiet, mut unnamed) = (0, 0, BTreeSet::new());
        for run in runs {
            let each = stages.of_each(run);
            if !each.contains(&encoders) {
                valley = valley.max(run.path.len() as u64);
                if !each.contains(&request) {
                    quiet += 1;
                    for stage in each {
                        valleys[stage] += 1;
                    }
                }
                continue;
            }
            unnamed.append(&mut stages.unnamed(run));
            let work = run.path.iter().zip(&each).filter(|(_, stage)| **stage != waiting);
            works.push(work.map(|(&at, _)| at).collect());
            for stage in each {
                sums[stage] += 1;
            }
        }
        let periods = works.len();
        let mean = |sum: u64| sum as f64 / periods.max(1) as f64;
        let lengths = || works.iter().map(|work| work.len() as u64);
        let longest = works.iter().max_by_key(|work| work.len()).map_or(&[][..], Vec::as_slice);
        Self {
            periods,
            mean: mean(lengths().sum()),
            longest: longest.len() as u64,
            shortest: lengths().min().unwrap_or(0),
            valley_mean: valleys.iter().sum::<u64>() as f64 / f64::from(quiet.max(1)),
            valley,
            stages: STAGES
                .iter()
                .zip(sums.into_iter().zip(valleys))
                .map(|((stage, _), (sum, of_valleys))| {
                    if stage.starts_with(AT_VALLEYS) { of_valleys as f64 / f64::from(quiet.max(1)) } else { mean(sum) }
                })
                .collect(),
            cycles: Flash::ALL.map(|flash| estimate(code, longest, flash)),
            kinds: kinds(code, longest),
            unnamed,
        }
    }
}

impl Rig {
    /// Every whole run of the control interrupt over `span` ns.
    ///
    /// # Panics
    ///
    /// When the image has no such handler.
    #[must_use]
    pub fn trace_control(&mut self, span: u64) -> Vec<Run> {
        self.trace_control_while(|rig| rig.run(span))
    }

    /// Every whole run of the control interrupt while something is `done`.
    ///
    /// # Panics
    ///
    /// When the image has no such handler.
    #[must_use]
    pub fn trace_control_while(&mut self, done: impl FnOnce(&mut Self)) -> Vec<Run> {
        let image = firmware(self.kind);
        let entry = image.symbol(CONTROL_INTERRUPT).unwrap_or_else(|error| panic!("{error}")).address;
        let code = Code::of(image).expect("an image with code");
        let watched = code.clone();
        self.with(move |bench| bench.trace(&watched, entry));
        done(self);
        self.with(move |bench| bench.take_trace(&code))
    }
}

/// Where the table is kept.
#[must_use]
pub fn document() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/results/timing.md")
}

const LONGEST: &str = "longest";
const VALLEY: &str = "longest at a valley, a request";

/// The document for these timings of [`CASES`].
#[must_use]
pub fn table(timings: &[Timing]) -> String {
    let mut text = "# The control interrupt in instructions\n\n\
        Written by `cargo xtask timing`: the release images on the emulated chip, armed, in contact, every wall with the\n\
        feed-forward in full and velocity terms unless its name says otherwise, telemetry of every step streaming; 25 ms of\n\
        each case, every instruction of the interrupt from its first to the one that returns, given to the function of the\n\
        source that it came from (emulator/src/stages.rs). Stages are means over the steps, which run at the carrier's crests,\n\
        or over the valleys half a carrier period later, where what the motors do not wait for is done: telemetry is written,\n\
        and what builds up is looked at. Requests of the tasks (at least 50 a second, for the status) are carried out there, too.\n\
        Jitter is the longest step less the shortest. Waiting for the converters is time, not work: its count depends on the\n\
        emulator's speed, and the sums are without it. Instructions are no cycles: those of the longest step are an estimate by\n\
        ARM's timings and a model of the flash and its accelerator (emulator/src/cycles.rs), with the exception's own. At 20 kHz\n\
        a period has 8,400 of them.\n\n"
        .to_owned();
    let mut row = |name: &str, cells: Vec<String>| {
        let _ = writeln!(text, "| {name} | {} |", cells.join(" | "));
    };
    row("", CASES.iter().map(Case::name).collect());
    row("---", CASES.iter().map(|_| "--:".to_owned()).collect());
    let stages = |at_valleys: bool, row: &mut dyn FnMut(&str, Vec<String>)| {
        let wanted = |stage: &str| stage != REQUEST && stage.starts_with(AT_VALLEYS) == at_valleys;
        for (nth, (stage, _)) in STAGES.iter().enumerate().filter(|(_, (stage, _))| wanted(stage)) {
            row(stage, timings.iter().map(|timing| format!("{:.0}", timing.stages[nth])).collect());
        }
    };
    stages(false, &mut row);
    let each = |value: fn(&Timing) -> u64| timings.iter().map(|timing| value(timing).to_string()).collect();
    row("**mean**", timings.iter().map(|timing| format!("{:.0}", timing.mean)).collect());
    row("shortest", each(|timing| timing.shortest));
    row(LONGEST, each(|timing| timing.longest));
    row("jitter", each(|timing| timing.longest - timing.shortest));
    let target = |(case, timing): (&Case, &Timing)| case.verdict(timing);
    row("aimed at, mean", CASES.iter().zip(timings).map(target).collect());
    stages(true, &mut row);
    row("valley: mean, no request", timings.iter().map(|timing| format!("{:.0}", timing.valley_mean)).collect());
    row(
        "crest and valley, mean",
        timings.iter().map(|timing| format!("{:.0}", timing.mean + timing.valley_mean)).collect(),
    );
    row(VALLEY, each(|timing| timing.valley));
    for (nth, (_, name)) in Kind::ALL.iter().enumerate() {
        row(&format!("of the longest: {name}"), timings.iter().map(|timing| timing.kinds[nth].to_string()).collect());
    }
    let names = ["the core alone", "with the flash as the firmware sets it", "with a flash that nothing accelerates"];
    for (nth, name) in names.into_iter().enumerate() {
        row(
            &format!("cycles of the longest, estimated, {name}"),
            timings.iter().map(|timing| timing.cycles[nth].to_string()).collect(),
        );
    }
    text
}

/// What follows the table: every other kind of scene on a five-bar, by these timings of [`SCENES`].
#[must_use]
pub fn scenes(timings: &[Timing]) -> String {
    let Case { board, device, rate_hz, .. } = SCENES[0];
    let mut text = format!(
        "\n## Every other kind of scene\n\n\
        On {} with a {device} at {} kHz: instructions of a step, entry to exit.\n\n\
        | the tip meets | mean | shortest | longest | aimed at, mean | cycles of the longest, with the flash as set |\n\
        | --- | --: | --: | --: | --: | --: |\n",
        board.name(),
        rate_hz / 1000
    );
    for (case, timing) in SCENES.iter().zip(timings) {
        let _ = writeln!(
            text,
            "| {} | {:.0} | {} | {} | {} | {} |",
            case.meets.name(),
            timing.mean,
            timing.shortest,
            timing.longest,
            case.verdict(timing),
            timing.cycles[1]
        );
    }
    text
}

impl Case {
    fn verdict(&self, timing: &Timing) -> String {
        let (target, mean) = (self.target, timing.mean.round() as u64);
        if mean <= target { format!("{target}: met") } else { format!("{target}: missed by {}", mean - target) }
    }
}

/// What follows those tables: what a new scene takes that comes with the motors on.
#[must_use]
pub fn replacements() -> String {
    let mut text = "\n## A new scene with the motors on\n\n\
        Instructions from the request on, for 5 ms: it is checked in one valley and taken over in the next, and what acted\n\
        before fades for half a second.\n\n\
        | | longest at a valley | longest step | median step |\n| --- | --: | --: | --: |\n"
        .to_owned();
    for case in [&CASES[0], &CASES[2], &CASES[4]] {
        let mut rig = case.rig(case.rate_hz);
        let runs = rig.trace_control_while(|rig| {
            set_free_scene(rig, case.rate_hz, 0);
            rig.run(5 * MILLISECOND);
        });
        let mut stages = Stages::of(firmware(case.board)).expect("debug information");
        let encoders = STAGES.iter().position(|(name, _)| *name == ENCODERS).unwrap_or(0);
        let (mut steps, mut valleys) = (Vec::new(), Vec::new());
        for run in &runs {
            let kind = if stages.of_each(run).contains(&encoders) { &mut steps } else { &mut valleys };
            kind.push(run.path.len());
        }
        steps.sort_unstable();
        let of = |lengths: &[usize], at: usize| lengths.get(at).map_or("none".to_owned(), usize::to_string);
        let valley = valleys.iter().max().map_or("none".to_owned(), usize::to_string);
        let (longest, median) = (of(&steps, steps.len().saturating_sub(1)), of(&steps, steps.len() / 2));
        let _ = writeln!(text, "| {} | {valley} | {longest} | {median} |", case.name());
    }
    text
}

/// What follows the tables: the rates that a five-bar and two kinds of three joints sustain.
#[must_use]
pub fn rates() -> String {
    let mut text = "\n## Rates\n\n\
        The highest control rate at which no period is missed in 200 ms of contact, every step's usual telemetry asked for\n\
        (tried in steps of 5 kHz from 50 down to 10), and the rows of usual telemetry a second that come without a loss at\n\
        20 kHz in a second of it. Beside them the highest rates at which no period is missed while four new scenes come with\n\
        the motors on, while a host moves a plane beside the board's wall, and while the limit of the tip's force cuts in\n\
        every step; above them the motors may turn off with `ControlOverrun`. The emulated core executes 84 million\n\
        instructions a second, two cycles each.\n\n\
        | | highest control rate | aimed at | with new scenes | with a host's plane | with a limit that cuts | rows a second without loss | aimed at |\n\
        | --- | --: | --: | --: | --: | --: | --: | --: |\n"
        .to_owned();
    for (case, rate, rows) in [(&CASES[0], "50000", "20000"), (&CASES[2], "35000", ""), (&CASES[4], "35000", "")] {
        let cell = |found: Option<u32>| found.map_or("none".to_owned(), |found| found.to_string());
        let (highest, whole) = (cell(highest_rate(case)), cell(rows_without_loss(case)));
        let (scenes, plane) = (cell(highest_for(case, takes_scenes)), cell(highest_for(case, takes_a_plane)));
        let cuts = cell(highest_for(case, takes_cuts));
        let _ =
            writeln!(text, "| {} | {highest} | {rate} | {scenes} | {plane} | {cuts} | {whole} | {rows} |", case.name());
    }
    text
}

/// The longest step of `case` that the table `text` records, and the longest run at a valley.
#[must_use]
pub fn recorded(text: &str, case: &Case) -> Option<(u64, u64)> {
    let cells = |name: &str| -> Option<Vec<&str>> {
        let line = text.lines().find(|line| line.starts_with(&format!("| {name} |")))?;
        Some(line.trim_matches('|').split('|').map(str::trim).collect())
    };
    let column = cells("")?.iter().position(|cell| *cell == case.name())?;
    let number = |name: &str| cells(name)?.get(column)?.parse().ok();
    Some((number(LONGEST)?, number(VALLEY)?))
}
