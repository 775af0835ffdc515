//! What the control interrupt takes, entry to exit, in instructions of the unmodified image: by stage, mean, worst,
//! jitter.
//!
//! `cargo xtask timing` measures every [`Case`] and writes the table that docs/results.md leads to; a test measures
//! some of them again and compares.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use haptic_bridge::board::telemetry::Fields;

use crate::cases::{CASES, Case};
use crate::cycles::{Flash, Kind, estimate, kinds};
use crate::load::{highest_rate, rows_without_loss};
use crate::rig::{Rig, firmware};
use crate::run::MILLISECOND;
use crate::stages::{REQUEST, SAMPLING, STAGES, Stages};
use crate::trace::{Code, Run};

/// The state of a row of telemetry.
const ARMED: f64 = 1.0;
/// The handler that the vector table names for the control interrupt.
const CONTROL_INTERRUPT: &str = "TIM1_UP_TIM10";
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
    /// The longest run at a valley: it carries out a request of the tasks, if there is one.
    pub valley: u64,
    /// Mean of each of [`STAGES`] over [`Timing::periods`].
    pub stages: Vec<f64>,
    /// Cycles that the longest of them is estimated to take, for each [`Flash::ALL`].
    pub cycles: [u64; Flash::ALL.len()],
    /// Its instructions of each of [`Kind::ALL`].
    pub kinds: [u64; Kind::ALL.len()],
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
        let in_contact = |row: &haptic::link::Row| row.values.ends_with(&[ARMED, self.walls as f64]);
        let status = rig.tool.status();
        assert!(!rows.is_empty() && rows.iter().all(in_contact), "{} is not in contact: {status:?}", self.name());
        let image = firmware(self.board);
        let code = Code::of(image).expect("an image with code");
        Timing::of(&runs, &code, &mut Stages::of(image).expect("debug information"))
    }
}

impl Timing {
    fn of(runs: &[Run], code: &Code, stages: &mut Stages<'_>) -> Self {
        let sampling = STAGES.iter().position(|(name, _)| *name == SAMPLING).unwrap_or(0);
        let mut sums = vec![0; STAGES.len()];
        let mut works: Vec<Vec<u32>> = Vec::new();
        let mut valley = 0;
        for run in runs {
            let each = stages.of_each(run);
            if !each.contains(&sampling) {
                valley = valley.max(run.path.len() as u64);
                continue;
            }
            let work = run.path.iter().zip(&each).filter(|(_, stage)| **stage != sampling);
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
            valley,
            stages: sums.into_iter().map(mean).collect(),
            cycles: Flash::ALL.map(|flash| estimate(code, longest, flash)),
            kinds: kinds(code, longest),
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
    pub fn trace_control(&self, span: u64) -> Vec<Run> {
        let image = firmware(self.kind);
        let entry = image.symbol(CONTROL_INTERRUPT).unwrap_or_else(|error| panic!("{error}")).address;
        let code = Code::of(image).expect("an image with code");
        let watched = code.clone();
        self.with(move |bench| bench.trace(&watched, entry));
        self.run(span);
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
        feed-forward in full, telemetry of every step streaming; 25 ms of each case, every instruction of the interrupt from\n\
        its first to the one that returns, given to the function of the source that it came from (emulator/src/stages.rs).\n\
        Stages are means over the steps, which run at the carrier's crests. Requests of the tasks (at least 50 a second, for\n\
        the status) are carried out at its valleys. Jitter is the longest less the shortest. Waiting for the converters is time, not work: its count depends on the\n\
        emulator's speed, and the sums are without it. Instructions are no cycles: those of the longest step are an estimate by\n\
        ARM's timings and a model of the flash and its accelerator (emulator/src/cycles.rs), with the exception's own. At 20 kHz\n\
        a period has 8,400 of them.\n\n"
        .to_owned();
    let mut row = |name: &str, cells: Vec<String>| {
        let _ = writeln!(text, "| {name} | {} |", cells.join(" | "));
    };
    row("", CASES.iter().map(Case::name).collect());
    row("---", CASES.iter().map(|_| "--:".to_owned()).collect());
    for (nth, (stage, _)) in STAGES.iter().enumerate().filter(|(_, (stage, _))| *stage != REQUEST) {
        row(stage, timings.iter().map(|timing| format!("{:.0}", timing.stages[nth])).collect());
    }
    let each = |value: fn(&Timing) -> u64| timings.iter().map(|timing| value(timing).to_string()).collect();
    row("**mean**", timings.iter().map(|timing| format!("{:.0}", timing.mean)).collect());
    row("shortest", each(|timing| timing.shortest));
    row(LONGEST, each(|timing| timing.longest));
    row("jitter", each(|timing| timing.longest - timing.shortest));
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
    let target = |(case, timing): (&Case, &Timing)| match case.target {
        Some(target) if timing.longest <= target => format!("{target}: met"),
        Some(target) => format!("{target}: missed by {}", timing.longest - target),
        None => "none".to_owned(),
    };
    row("target", CASES.iter().zip(timings).map(target).collect());
    text
}

/// What follows the table: the rates that the first and the third of [`CASES`] sustain.
#[must_use]
pub fn rates() -> String {
    let mut text = "\n## Rates\n\n\
        The highest control rate at which no period is missed in 200 ms of contact, every step's usual telemetry asked for\n\
        (tried in steps of 5 kHz from 50 down to 10), and the rows of usual telemetry a second that come without a loss at\n\
        20 kHz. The emulated core executes 84 million instructions a second, two cycles each.\n\n\
        | | highest control rate | aimed at | rows a second without loss | aimed at |\n| --- | --: | --: | --: | --: |\n"
        .to_owned();
    for (case, rate, rows) in [(&CASES[0], "50000", "20000"), (&CASES[2], "30000", "")] {
        let cell = |found: Option<u32>| found.map_or("none".to_owned(), |found| found.to_string());
        let (highest, whole) = (cell(highest_rate(case)), cell(rows_without_loss(case)));
        let _ = writeln!(text, "| {} | {highest} | {rate} | {whole} | {rows} |", case.name());
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
