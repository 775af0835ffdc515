//! `haptic measure-range`: the stable range as a board has it, by raising the stiffness until the loop oscillates.

use super::port::Port;
use crate::cli::Numbers;
use clap::ValueEnum;
use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::range::{Range, predict};
use haptic::analysis::sampled::{Estimator, Loop};
use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use haptic::interrupt;
use haptic::link::Board;
use haptic::measure::campaign::{self, Plan};
use haptic::measure::progress::{Mode, Point, Progress};
use haptic::measure::{Bench, Setup};
use haptic::plot::range::{Contents, MeasuredPoint, draw};
use haptic_bridge::model::device::Device;
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt::Write;
use std::io::{IsTerminal, Write as _};
use std::path::PathBuf;

/// Measure on a board which walls stay stable; moves the motors
///
/// For every damping the stiffness is raised until the telemetry shows a growing oscillation, taken back at once, and
/// the boundary bisected; the median of the repeats and their bounds are reported. The theory is not consulted, only
/// drawn beside it. Take the hand off the device. Ctrl-C at any moment turns the motors off; the same command then goes
/// on where it stopped.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML) of the device on the board
    device: PathBuf,
    #[command(flatten)]
    port: Port,
    /// Normal of the wall, placed where the tip is; any length
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Numbers,
    /// Control rate in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20_000.0)]
    rate: f64,
    /// Cutoff of the velocity filter in Hz
    #[arg(long, value_name = "HZ", default_value_t = 500.0)]
    cutoff: f64,
    /// Measure at exactly these dampings, in N s/m [default: --points even ones up to where the range ends]
    #[arg(long, value_name = "A,B,..")]
    kd: Option<Numbers>,
    /// How many dampings
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=200))]
    points: u16,
    /// Repeats at each damping
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=100))]
    repeats: u16,
    /// Feed-forward to measure with
    #[arg(long, value_name = "KIND", default_value = "both")]
    feed_forward: Kinds,
    /// Corner of the washout in Hz, for --feed-forward washout
    #[arg(long, value_name = "HZ", default_value_t = 2.0)]
    washout: f64,
    /// Largest joint torque the measurement may ask for, in N m
    #[arg(long, value_name = "NM", default_value_t = 1.0)]
    torque_limit: f64,
    /// Farthest the tip is pulled aside to set it swinging, in mm
    #[arg(long, value_name = "MM", default_value_t = 0.5)]
    pull: f64,
    /// Keep what was measured in this file, and go on from it
    #[arg(long, value_name = "FILE", default_value = "measured-range.json")]
    progress: PathBuf,
    /// Do not ask before a real motor moves
    #[arg(long)]
    yes: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Draw the measured dots over the predicted range into this SVG file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Draw the same into this PNG file
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
}

/// Which feed-forward.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kinds {
    /// Without, then with equation (4)
    Both,
    /// Without
    Off,
    /// With equation (4)
    Full,
    /// With equation (4) behind a washout
    Washout,
}

impl Kinds {
    fn modes(self) -> Vec<Mode> {
        match self {
            Kinds::Both => vec![Mode::Off, Mode::Full],
            Kinds::Off => vec![Mode::Off],
            Kinds::Full => vec![Mode::Full],
            Kinds::Washout => vec![Mode::Washout],
        }
    }
}

/// One point of `--json`.
#[derive(serde::Serialize)]
struct JsonPoint<'a> {
    mode: Mode,
    kd: f64,
    kp: f64,
    low: f64,
    high: f64,
    repeats: &'a [f64],
}

/// Measures, prints and draws.
pub fn run(args: Args) -> Result<(), Failure> {
    let file = DeviceFile::load(&args.device)?;
    let spec = file.spec();
    let normal = args.normal.clone().unit(spec.task, "--normal")?;
    if !(args.torque_limit > 0.0 && args.torque_limit.is_finite() && args.pull > 0.0 && args.pull <= 5.0) {
        return Err(Failure::wrong("--torque-limit must be positive, and --pull from 0 to 5 mm"));
    }
    let kd = match args.kd.clone() {
        Some(Numbers(kd)) if kd.iter().any(|kd| *kd < 0.0) => {
            return Err(Failure::wrong("--kd takes dampings that are not negative"));
        }
        kd => kd.map(|kd| kd.0),
    };
    let plan = Plan { modes: args.feed_forward.modes(), kd, points: args.points.into(), repeats: args.repeats.into() };
    let what = format!(
        "{} along {normal:?} at {} Hz, cutoff {} Hz, washout {} Hz",
        file.name, args.rate, args.cutoff, args.washout
    );
    let mut progress = Progress::open(&args.progress, &what)?;

    let interrupt = interrupt::watch();
    let mut board = args.port.open_with(&args.device)?;
    ready(&mut board, &file, &args)?;
    let setup = Setup {
        normal: normal.clone(),
        rate_hz: args.rate,
        cutoff_hz: args.cutoff,
        washout_hz: args.washout,
        torque_limit: args.torque_limit,
        largest_pull: args.pull * 1e-3,
    };
    let stop = || interrupt.is_set();
    let q = {
        let mut bench = Bench::new(&mut board, &file, setup, &stop)?;
        let q = bench.pose().to_vec();
        let bar = ProgressBar::new(plan.total() as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:32} {pos}/{len} repeats, {eta} to go{msg}") {
            bar.set_style(style);
        }
        campaign::run(&mut bench, &plan, &mut progress, |progress, done| {
            bar.set_position(done as u64);
            Ok(progress.save(&args.progress)?)
        })?;
        bar.finish_and_clear();
        bench.finish()?;
        q
    };

    let details = board.details()?;
    let device = Linearised::at(&file.description, &q, &normal)?;
    let around = Loop {
        rate_hz: args.rate,
        delay_samples: f64::from(details.delay_samples),
        estimator: Estimator::Butterworth(args.cutoff),
        drive: Drive::Ideal,
        damping_compensation: false,
    };
    let washout = plan.modes.contains(&Mode::Washout).then_some(args.washout);
    if args.svg.is_some() || args.png.is_some() {
        let range = predict(&device, &around, None, washout)?;
        let picture = picture(&file.name, &args, &progress, &range);
        args.svg.as_deref().map(|path| picture.save_svg(path)).transpose()?;
        args.png.as_deref().map(|path| picture.save_png(path)).transpose()?;
    }
    if args.json {
        let points: Vec<JsonPoint<'_>> =
            plan.modes.iter().flat_map(|mode| progress.of(*mode)).map(json_point).collect();
        let json = serde_json::to_string(&serde_json::json!({ "points": points })).map_err(Failure::impossible)?;
        return print(&(json + "\n"));
    }
    print(&table(&file.name, &plan, &progress, &device, &around, washout)?)
}

/// Sees that the board has the device, and that the user wants its motors to move.
fn ready(board: &mut Board, file: &DeviceFile, args: &Args) -> Result<(), Failure> {
    let details = board.details()?;
    if !details.real {
        let device = Device::new(&file.name, &file.description).map_err(Failure::wrong)?;
        return Ok(board.set_device(&device)?);
    }
    if details.device.as_deref() != Some(file.name.as_str()) {
        return Err(Failure::impossible(format!(
            "the board has {}, not {}",
            details.device.as_deref().unwrap_or("no device"),
            file.name
        ))
        .remedy("load it with `haptic device`, home it and check its polarity first"));
    }
    if args.yes {
        return Ok(());
    }
    eprintln!(
        "This moves the motors by themselves: the tip swings by up to {} mm with at most {} N m, and will oscillate briefly, \
         many times.\nKeep the hand off the device and clear of it. Ctrl-C turns the motors off.",
        args.pull * 12.0,
        args.torque_limit
    );
    if !std::io::stdin().is_terminal() {
        return Err(Failure::impossible("nobody is there to agree").remedy("agree beforehand with --yes"));
    }
    eprint!("Go on? Type yes: ");
    let _ = std::io::stderr().flush();
    let mut answer = String::new();
    let read = std::io::stdin().read_line(&mut answer);
    match (read, answer.trim()) {
        (Ok(_), "yes") => Ok(()),
        _ => Err(Failure::impossible("not measured: you did not agree")),
    }
}

fn json_point(point: &Point) -> JsonPoint<'_> {
    let (low, high) = point.bounds();
    JsonPoint { mode: point.mode, kd: point.kd, kp: point.median(), low, high, repeats: &point.repeats }
}

fn picture(name: &str, args: &Args, progress: &Progress, range: &Range) -> haptic::plot::Picture {
    let dots = |mode| -> Vec<MeasuredPoint> {
        progress
            .of(mode)
            .into_iter()
            .map(|point| {
                let (low, high) = point.bounds();
                MeasuredPoint { kd: point.kd, kp: point.median(), low, high }
            })
            .collect()
    };
    let (off, full, washed) = (dots(Mode::Off), dots(Mode::Full), dots(Mode::Washout));
    draw(&Contents {
        title: format!("{name}: stable walls, measured and predicted"),
        subtitle: [
            format!("{} Hz, cutoff {} Hz", args.rate, args.cutoff),
            "lines: linear theory with joint damping, no friction, no hand; dots: measured on the board".into(),
        ],
        range,
        passivity: None,
        measured_off: &off,
        measured_full: if full.is_empty() { &washed } else { &full },
    })
}

fn table(
    name: &str,
    plan: &Plan,
    progress: &Progress,
    device: &Linearised,
    around: &Loop,
    washout: Option<f64>,
) -> Result<String, Failure> {
    let mut text = format!("{name}: largest stable stiffness, measured (median of {} repeats)\n", plan.repeats);
    let _ = writeln!(
        text,
        "{:>10}{:>12}{:>12}{:>12}{:>12}{:>14}",
        "", "kd N s/m", "kp N/m", "lowest", "highest", "linear theory"
    );
    for &mode in &plan.modes {
        let points = progress.of(mode);
        let kds: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let range = predict(device, around, Some(&kds), washout)?;
        let predicted = match mode {
            Mode::Off => &range.off,
            Mode::Full => &range.full,
            Mode::Washout => range.washout.as_ref().unwrap_or(&range.full),
        };
        for (point, theory) in points.iter().zip(&predicted.boundary) {
            let (low, high) = point.bounds();
            let label = format!("{mode:?}").to_lowercase();
            let _ = writeln!(
                text,
                "{label:>10}{:>12.4}{:>12.2}{low:>12.2}{high:>12.2}{:>14.2}",
                point.kd,
                point.median(),
                theory.kp
            );
        }
    }
    text.push_str(
        "The theory knows no Coulomb friction, hand, quantisation or saturation; where they act, the two differ.\n",
    );
    Ok(text)
}
