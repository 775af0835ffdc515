//! Regenerates the impedance-range and map figures, the washout's table, and their section of docs/results.md:
//! `cargo xtask figures`.
//!
//! A strongly coupled five-bar, at a pose and along the normal where its coupling is worst, on the simulated board;
//! theory as lines, what `haptic::measure` found through the protocol as dots. Everything is deterministic: the same
//! numbers on every machine. It takes some minutes.

mod washout;
mod world;

use haptic::analysis::map;
use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::pose::unit_normal;
use haptic::analysis::range::{Domain, Range, predict};
use haptic::analysis::sampled::{Estimator, Loop};
use haptic::device_file::DeviceFile;
use haptic::link::Board;
use haptic::measure::campaign::{self, Plan};
use haptic::measure::progress::{Mode, Point, Progress};
use haptic::measure::{Bench, Setup};
use haptic::plot::range::{Contents, MeasuredPoint, draw};
use haptic::sim::{
    BoardOptions, DriveModel, Hand, HandSettings, Intent, Options, SHIPPED_DEVICE, SharedBoard, Waypoint, ready_board,
};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use world::World;

/// Where the wall is touched, rad.
const POSE: [f64; 3] = [2.6, 1.75, 0.0];
/// Dampings and repeats of every figure.
const POINTS: usize = 12;
const REPEATS: usize = 5;
/// Where the generated section of docs/results.md begins and ends.
const BEGIN: &str = "<!-- impedance range: begin, written by docs/figures/src/main.rs -->";
const END: &str = "<!-- impedance range: end -->";

struct Case {
    name: &'static str,
    rate_hz: f64,
    cutoff_hz: f64,
}

const CASES: [Case; 5] = [
    Case { name: "range-200hz", rate_hz: 200.0, cutoff_hz: 20.0 },
    Case { name: "range-1khz", rate_hz: 1000.0, cutoff_hz: 20.0 },
    Case { name: "range-10khz", rate_hz: 10_000.0, cutoff_hz: 200.0 },
    Case { name: "range-20khz", rate_hz: 20_000.0, cutoff_hz: 500.0 },
    Case { name: "range-50khz", rate_hz: 50_000.0, cutoff_hz: 1000.0 },
];

/// The modes of every figure.
const FULL: [Mode; 2] = [Mode::Off, Mode::Full];

/// Devices and normals of the maps.
const MAPS: [(&str, &[f64]); 2] = [("coupled-five-bar", &[1.0, 0.0]), ("phantom-premium-1.5", &[1.0, 1.0, 0.0])];

/// What a case came to.
struct Outcome {
    range: Range,
    progress: Progress,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let folder = root.join("docs/results");
    std::fs::create_dir_all(&folder)?;
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let results = std::thread::scope(|scope| {
        let running: Vec<_> = CASES
            .iter()
            .filter(|case| wanted.is_empty() || wanted.iter().any(|w| w == case.name))
            .map(|case| (case, scope.spawn(|| measured(case, &FULL, 2.0, REPEATS).map_err(|error| error.to_string()))))
            .collect();
        running.into_iter().map(|(case, thread)| (case, thread.join())).collect::<Vec<_>>()
    });
    let mut section = heading();
    for (case, result) in results {
        let outcome = result.map_err(|_| format!("{}: the measurement panicked", case.name))??;
        let picture = drawn(case, &outcome);
        picture.save_svg(&folder.join(format!("{}.svg", case.name)))?;
        picture.save_png(&folder.join(format!("{}.png", case.name)))?;
        let row = row(case, &outcome);
        println!("{row}");
        section.push_str(&row);
        section.push('\n');
    }
    for (device, normal) in MAPS {
        let file = DeviceFile::load(root.join(format!("devices/{device}.toml")))?;
        let picture = haptic::plot::map::draw(&file.description, &file.name, normal)?;
        picture.save_png(&folder.join(format!("map-{device}.png")))?;
    }
    if wanted.iter().any(|name| name == "washout") {
        println!("{}", washout::section()?);
    }
    if wanted.iter().any(|name| name == "world") {
        println!("{}", world::section(&folder)?);
    }
    if wanted.is_empty() {
        section.push_str(&pictures());
        section.push_str(&washout::section()?);
        section.push_str(&world::section(&folder)?);
        write_section(&root.join("docs/results.md"), &section)?;
    }
    Ok(())
}

/// The shipped device without friction and with fine encoders: what the linear theory is about. A `world` may add
/// either.
fn device_in(world: &World) -> Result<DeviceFile, Box<dyn std::error::Error>> {
    let mut file = device()?;
    let shipped = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml")?;
    for (joint, shipped) in file.description.joints[..2].iter_mut().zip(shipped.description.joints) {
        if world.viscous {
            joint.viscous = shipped.viscous;
        }
        if world.coulomb {
            joint.coulomb = shipped.coulomb;
        }
        if world.encoders {
            joint.encoder = shipped.encoder;
        }
    }
    Ok(file)
}

/// The device that the theory is about.
fn device() -> Result<DeviceFile, Box<dyn std::error::Error>> {
    let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml")?;
    for joint in &mut file.description.joints[..2] {
        joint.viscous = 0.0;
        joint.coulomb = 0.0;
        if let Some(encoder) = &mut joint.encoder {
            encoder.counts_per_turn = f64::from(1 << 23);
        }
    }
    Ok(file)
}

/// The normal of the largest Wrr/Weff at the pose.
fn worst_normal(file: &DeviceFile) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let any = unit_normal(&[1.0, 0.0], 2, 2)?;
    let point = map::at(&file.description, &POSE[..2], &any)?.ok_or("the pose is singular")?;
    Ok(point.worst_ratio.normal)
}

/// Measures a case in these modes, the washout at `washout_hz`, and predicts it.
fn measured(
    case: &Case,
    modes: &[Mode],
    washout_hz: f64,
    repeats: usize,
) -> Result<Outcome, Box<dyn std::error::Error>> {
    measured_in(case, modes, washout_hz, repeats, &world::NOTHING)
}

/// Measures a case in a `world`.
fn measured_in(
    case: &Case,
    modes: &[Mode],
    washout_hz: f64,
    repeats: usize,
    world: &World,
) -> Result<Outcome, Box<dyn std::error::Error>> {
    let file = device_in(world)?;
    let normal = worst_normal(&file)?;
    let options = Options {
        friction: true,
        start: Some(POSE),
        // The torque is held for a whole control period, so slow loops need no fine steps.
        substep: (0.01 / case.rate_hz).clamp(2e-6, 2.5e-5),
        ..Options::default()
    };
    let drive = if world.electric { DriveModel::Electric } else { DriveModel::Ideal };
    let mut simulated = ready_board(&file, BoardOptions { device: options, drive, ..BoardOptions::default() })?;
    if world.hand {
        let tip = simulated.device_mut().tip();
        let rest = Intent::Follow(vec![Waypoint { time: 0.0, value: tip }]);
        simulated.device_mut().set_hand(Hand::new(HandSettings::default(), rest, tip, 0.0));
    }
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim")?;
    let setup = Setup {
        normal: normal.clone(),
        rate_hz: case.rate_hz,
        cutoff_hz: case.cutoff_hz,
        washout_hz,
        torque_limit: world.torque_limit,
        largest_pull: world.pull,
    };
    let plan = Plan { modes: modes.to_vec(), kd: None, points: POINTS, repeats };
    let mut progress = Progress::new(case.name);
    let mut bench = Bench::new(&mut board, &file, setup, &|| false)?;
    campaign::run(&mut bench, &plan, &mut progress, |_, done| {
        if done % 20 == 0 {
            eprintln!("{}: {done} of {}", case.name, plan.total());
        }
        Ok(())
    })?;
    bench.finish()?;
    let range = predicted(case, f64::from(board.details()?.delay_samples), Some(washout_hz))?;
    Ok(Outcome { range, progress })
}

/// The linear theory of a case.
fn predicted(case: &Case, delay_samples: f64, washout_hz: Option<f64>) -> Result<Range, Box<dyn std::error::Error>> {
    let file = device()?;
    let around = Loop {
        rate_hz: case.rate_hz,
        delay_samples,
        estimator: Estimator::Butterworth(case.cutoff_hz),
        drive: Drive::Ideal,
        damping_compensation: false,
    };
    let linear = Linearised::at(&file.description, &POSE[..2], &worst_normal(&file)?)?;
    Ok(predict(&linear, &around, None, washout_hz)?)
}

fn dots(points: &[&Point]) -> Vec<MeasuredPoint> {
    let dot = |point: &&Point| {
        let (low, high) = point.bounds();
        MeasuredPoint { kd: point.kd, kp: point.median(), low, high }
    };
    points.iter().map(dot).collect()
}

fn drawn(case: &Case, outcome: &Outcome) -> haptic::plot::Picture {
    drawn_as(case, outcome, "simulated board; no friction, no hand, ideal drive")
}

fn drawn_as(case: &Case, outcome: &Outcome, world: &str) -> haptic::plot::Picture {
    let (off, full) = (outcome.progress.of(Mode::Off), outcome.progress.of(Mode::Full));
    draw(&Contents {
        title: format!("coupled-five-bar at {} Hz, cutoff {} Hz", case.rate_hz, case.cutoff_hz),
        subtitle: ["lines: linear theory; dots: measured through the protocol".into(), world.into()],
        range: &outcome.range,
        passivity: None,
        measured_off: &dots(&off),
        measured_full: &dots(&full),
    })
}

/// ∫ kp dkd of measured points at the middles of even cells.
fn measured_area(progress: &Progress, mode: Mode) -> f64 {
    let cell = progress.end(mode).unwrap_or(0.0) / POINTS as f64;
    progress.of(mode).iter().map(|point| point.median() * cell).sum()
}

/// Largest distance of a median from the line, as a share of the line's highest point.
fn deviation(points: &[&Point], domain: &Domain) -> f64 {
    let top = domain.boundary.iter().map(|p| p.kp).fold(0.0, f64::max);
    let line = |kd: f64| {
        let after = domain.boundary.iter().position(|p| p.kd >= kd);
        match after {
            Some(i) if i > 0 => {
                let (a, b) = (domain.boundary[i - 1], domain.boundary[i]);
                a.kp + (b.kp - a.kp) * (kd - a.kd) / (b.kd - a.kd)
            }
            _ => 0.0,
        }
    };
    points.iter().map(|point| (point.median() - line(point.kd)).abs() / top).fold(0.0, f64::max)
}

fn heading() -> String {
    let mut text = String::from(
        "Regenerate with `cargo xtask figures`. The device is the shipped coupled-five-bar at\n\
         q = (2.6, 1.75) rad, the wall along the normal of the largest Wrr/Weff there. Lines are the linear theory of\n\
         `haptic range` with the board's own delay; dots are what `haptic measure-range` does, through the protocol of a\n\
         simulated board: the median of 5 repeats at 12 dampings, bars from the lowest to the highest repeat.\n\n\
         Deviation: the largest distance of a measured median from the line, in percent of the line's highest point. Area\n\
         ratio: with the feed-forward over without. (Wrr/Weff)² is what an undamped device gains.\n\n\
         These cases hold the theory to account: no friction, no hand, torque at once, fine encoders.\n\n",
    );
    text.push_str("| case | deviation off | deviation full | area ratio predicted | measured | (Wrr/Weff)² |\n");
    text.push_str("|---|---|---|---|---|---|\n");
    text
}

fn row(case: &Case, outcome: &Outcome) -> String {
    let (progress, range) = (&outcome.progress, &outcome.range);
    format!(
        "| {} Hz, cutoff {} Hz | {:.2} % | {:.2} % | {:.3} | {:.3} | {:.3} |",
        case.rate_hz,
        case.cutoff_hz,
        100.0 * deviation(&progress.of(Mode::Off), &range.off),
        100.0 * deviation(&progress.of(Mode::Full), &range.full),
        range.area_ratio,
        measured_area(progress, Mode::Full) / measured_area(progress, Mode::Off),
        (range.w_rr / range.w_eff).powi(2),
    )
}

fn pictures() -> String {
    let mut text = String::new();
    for (device, _) in MAPS {
        let _ = write!(text, "\n![inertia over the workspace of {device}](results/map-{device}.png)\n");
    }
    for case in &CASES {
        let _ = write!(text, "\n![{} Hz, cutoff {} Hz](results/{}.svg)\n", case.rate_hz, case.cutoff_hz, case.name);
    }
    text
}

/// Replaces the section between the markers, or adds it at the end.
fn write_section(path: &Path, section: &str) -> std::io::Result<()> {
    let old = std::fs::read_to_string(path).unwrap_or_else(|_| "# Results\n".into());
    let body = format!("{BEGIN}\n{section}{END}");
    let new = match (old.find(BEGIN), old.find(END)) {
        (Some(from), Some(to)) if from < to => format!("{}{body}{}", &old[..from], &old[to + END.len()..]),
        _ => format!("{}\n\n## The impedance range, predicted and measured\n\n{body}\n", old.trim_end()),
    };
    std::fs::write(path, new)
}
