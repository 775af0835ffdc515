//! `haptic tune`: finds the settings of the stiffest wall on a device, and its limiting factor.

use super::answer::Json;
use super::arguments::{self, Numbers};
use super::continued::Continue;
use super::estimators;
use super::force::ForceOption;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{FeedForward, Scene, Surface};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, PortSpec};
use haptic_host::output;
use haptic_host::scene_file::SceneFile;
use haptic_host::words::{digits, joint_units};
use haptic_predict::measure::board_measurement;
use haptic_predict::plausible::scene::{contact_limits_at, file_warnings};
use haptic_predict::tune::measured::{self, MeasuredWall};
use haptic_predict::tune::{
    Alternative, Baseline, Margins, Question, RATES_HZ, Settings, TuneResult, TunedWall, USUAL_RIPPLE_N, baseline,
    ripple_like, to_toml, tune,
};
use haptic_stability::analysis::prediction::Subject;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Find the settings that render the stiffest wall on a device
///
/// Searches control rate, velocity estimator, cutoff, damping, stiffness, washout and feed-forward for the stiffest
/// wall that stays stable, ripples little under a hand that slides along it, loses contact at most once after a tap,
/// and stays within the motors' limits, on the device of the file and on slightly different devices. Reports the
/// limiting factor. Stability is predicted; ripple is simulated with the steps of the encoders, and once more on a
/// simulated board under another hand. Takes some minutes; Ctrl-C ends it, and with --continue the same command
/// continues from there. With --scene the pose, the normal and the ripple come from a wall in that file, and the result
/// is compared with that wall.
#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    subcommand: Option<Subcommand>,
    #[command(flatten)]
    search: Search,
}

#[derive(clap::Subcommand)]
enum Subcommand {
    Estimators(estimators::Args),
}

#[derive(clap::Args)]
struct Search {
    /// Device file (TOML)
    #[arg(required = true)]
    device: Option<PathBuf>,
    /// Joint angles in rad, travels in m, such as 2.4,0.7 [default: where the wall of --scene is touched, or the device
    /// file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
    /// Normal of the wall, of any length [default: the normal of the wall of --scene]
    #[arg(long, value_name = "X,Y,..", required_unless_present = "scene", allow_hyphen_values = true)]
    normal: Option<Numbers>,
    /// Scene file whose wall is to be made stiffer: the wall is tested with the same margins and compared
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Index of the wall in --scene, from 0
    #[arg(long, value_name = "INDEX", default_value_t = 0, requires = "scene")]
    wall: usize,
    /// Largest ripple in N: root mean square of the wall's force above 20 Hz, under a hand that presses with 1.5 to 4.5
    /// N and slides along at 30 mm/s, and under the hand that presses the simulated board [default: 0.1, or the ripple
    /// of the wall of --scene as it is written, and 0.002 at least]
    #[arg(long, value_name = "N")]
    ripple: Option<f64>,
    /// Control rates to try, in Hz
    #[arg(long, value_name = "A,B,..", default_value = "1000,5000,10000,20000")]
    rates: Numbers,
    /// Feed-forwards to try; full pushes a resting hand along the wall
    #[arg(long, value_name = "KIND", value_delimiter = ',', default_value = "off,washout", value_parser = arguments::feed_forward_parser())]
    feed_forward: Vec<FeedForward>,
    /// Penetration in encoder counts at which the motors may reach their limit
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    counts: f64,
    /// Speed in m/s at which the damping alone may reach the motors' limit
    #[arg(long, value_name = "M/S", default_value_t = 0.1)]
    speed: f64,
    /// Coordinate that a redundant device holds [default: the scene's, or orientation]
    #[arg(long, value_name = "COORDINATE", value_parser = arguments::admissible_parser())]
    admissible: Option<Admissible>,
    /// Also measure both walls on the simulated board with all effects: some minutes
    #[arg(long)]
    measure: bool,
    #[command(flatten)]
    continued: Continue,
    /// Write a scene file with the wall
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Load the scene onto this board: a serial port or a board's serial number, or tcp:HOST:PORT (HAPTIC_PORT is not
    /// used)
    #[arg(long, value_name = "PORT")]
    port: Option<PortSpec>,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    force: ForceOption,
}

#[derive(Serialize)]
struct Document<'a> {
    device: &'a str,
    q: &'a [f64],
    normal: &'a [f64],
    ripple_limit_n: f64,
    board_ripple_limit_n: Option<f64>,
    margins: Margins,
    /// Options with which `haptic range DEVICE` predicts the wall of the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    options: Option<String>,
    #[serde(flatten)]
    answer: &'a TuneResult,
    #[serde(skip_serializing_if = "Option::is_none")]
    scene: Option<&'a Baseline>,
    /// Stiffness of the result relative to the scene's wall, at the same margins and at most the same ripple.
    #[serde(skip_serializing_if = "Option::is_none")]
    times: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    measured: Option<&'a MeasuredWall>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scene_measured: Option<&'a MeasuredWall>,
}

/// The wall to make stiffer, and the pose in which it is touched.
struct WallPlace {
    q: Vec<f64>,
    normal: Vec<f64>,
    point: Option<Vec<f64>>,
    written: Option<Settings>,
    admissible: Admissible,
}

pub fn run(args: Args) -> Result<(), Failure> {
    match args.subcommand {
        Some(Subcommand::Estimators(args)) => estimators::run(args),
        None => search(args.search),
    }
}

fn search(args: Search) -> Result<(), Failure> {
    let overwrite = args.force.overwrite();
    if let Some(out) = &args.out {
        output::check(out, overwrite)?;
    }
    if let Some(PortSpec::Sim(_)) = args.port {
        return Err(Failure::wrong("a board on --port sim exists only during this command")
            .remedy("run `haptic sim` in another terminal and use the port that it prints"));
    }
    let Some(device) = &args.device else { return Err(Failure::wrong("no device file")) };
    let file = DeviceFile::load(device)?;
    let place = requested_place(&args, &file)?;
    let mut board = args.port.as_ref().map(|port| open_with_device(port, &file)).transpose()?;
    let mut question = Question {
        file: &file,
        q: place.q.clone(),
        normal: place.normal.clone(),
        admissible: place.admissible,
        margins: Margins::default(),
        ripple_n: args.ripple.unwrap_or(USUAL_RIPPLE_N),
        board_ripple_n: Some(args.ripple.unwrap_or(USUAL_RIPPLE_N)),
        counts: args.counts,
        speed: args.speed,
        rates_hz: if args.rates.0.is_empty() { RATES_HZ.to_vec() } else { args.rates.0.clone() },
        estimators: haptic_predict::tune::estimators(),
        feed_forwards: args.feed_forward.clone(),
        known: None,
    };
    let inputs = format!("{question:?} {:?} {:?}", place.written, args.ripple);
    let sweep = args.continued.sweep("tune", &inputs)?.in_lines();
    if let (None, Some(settings)) = (args.ripple, &place.written) {
        let (ripple_n, board_ripple_n) = ripple_like(&question, settings, &sweep)?;
        (question.ripple_n, question.board_ripple_n) = (ripple_n, Some(board_ripple_n));
    }
    let before = place
        .written
        .map(|settings| sweep.run_stage("the wall of the scene", || baseline(&question, &settings, &sweep)));
    let before = before.transpose()?;
    question.known = before.map(|before| before.settings);
    let answer = tune(&question, &sweep)?;
    let (mut best_measured, mut scene_measured) = (None, None);
    if args.measure {
        let stages: Vec<Option<Settings>> = vec![before.map(|before| before.settings), Some(answer.best.settings)];
        let measure = |settings: &Option<Settings>| settings.map(|s| measured::measure(&question, &s, &sweep));
        let mut results = sweep.run_stage("measured on the simulated board", || {
            haptic_stability::cores::map(&stages, &|_, _| {}, measure)
        });
        best_measured = results.pop().flatten().transpose()?;
        scene_measured = results.pop().flatten().transpose()?;
    }
    let times = before
        .filter(|before| before.settings.stiffness > 0.0)
        .map(|before| answer.best.settings.stiffness / before.settings.stiffness);
    let point = match &place.point {
        Some(point) => point.clone(),
        // Places the wall 5 mm in front of the tip, so that the board can be armed.
        None => tip_position(&file, &question.q)?.iter().zip(&question.normal).map(|(p, n)| p - 5e-3 * n).collect(),
    };
    let comments = scene_comments(&args, &file, &answer, question.ripple_n);
    let text = to_toml(&answer.best.settings, question.admissible, &point, &question.normal, &comments);
    let tuned = SceneFile::parse(&text, "tuned.toml", file.spec().task)?;
    let options = Subject::new(&file.description)
        .ok()
        .and_then(|subject| {
            contact_limits_at(&subject, &tuned.scene, 0, &question.q, &subject.torque_path(tuned.scene.rate_hz))
        })
        .map(|contact| contact.options);
    let scene: Scene<f32> =
        tuned.scene().map_err(|error| Failure::impossible(format!("the resulting scene cannot be used: {error}")))?;
    if let Some(out) = &args.out {
        output::write(out, text.as_bytes(), overwrite)?;
    }
    if let Some(board) = &mut board {
        board.set_scene(&scene)?;
    }
    let document = Document {
        device: &file.name,
        q: &question.q,
        normal: &question.normal,
        ripple_limit_n: question.ripple_n,
        board_ripple_limit_n: question.board_ripple_n,
        margins: question.margins,
        options,
        answer: &answer,
        scene: before.as_ref(),
        times,
        measured: best_measured.as_ref(),
        scene_measured: scene_measured.as_ref(),
    };
    let mut text = readable(&document, &joint_units(&file.description.units(), |joint| joint.travel));
    if let Some(out) = &args.out {
        let _ = writeln!(text, "written to {}", out.display());
    }
    if let Some(board) = &board {
        let _ = writeln!(text, "loaded on {}", board.port());
    }
    args.json.answer(&document, &text)?;
    sweep.finish();
    Ok(())
}

/// Opens the board, which must have this device loaded.
fn open_with_device(port: &PortSpec, file: &DeviceFile) -> Result<Board, Failure> {
    let mut board = haptic_sim::open(port)?;
    let device = haptic_bridge::model::device::Device::new(&file.name, &file.description).map_err(Failure::wrong)?;
    match board_measurement::other_loaded_device(&mut board, &device)? {
        None => Ok(board),
        Some(loaded) => {
            Err(Failure::impossible(format!("the board has {loaded} loaded, and the file is {}", file.name))
                .remedy("load it with `haptic device` first"))
        }
    }
}

fn tip_position(file: &DeviceFile, q: &[f64]) -> Result<Vec<f64>, Failure> {
    Ok(haptic_stability::analysis::pose::TaskPose::at(&file.description, q)?.regular()?.position)
}

/// Returns the wall as typed, as in the scene, or at home.
fn requested_place(args: &Search, file: &DeviceFile) -> Result<WallPlace, Failure> {
    let spec = file.spec();
    let q = args.q.as_ref().map(|q| q.exactly(spec.joints, "--q", "joint angles")).transpose()?;
    let normal = args.normal.as_ref().map(|normal| normal.unit(spec.task, "--normal")).transpose()?;
    let home = || arguments::pose(None, file);
    let Some(path) = &args.scene else {
        let normal =
            normal.ok_or_else(|| Failure::wrong("no --normal").remedy("give the normal of the wall, such as 0,1"))?;
        let admissible = args.admissible.unwrap_or_default();
        return Ok(WallPlace { q: q.map_or_else(home, Ok)?, normal, point: None, written: None, admissible });
    };
    let scene = SceneFile::load(path, spec.task)?.scene;
    if scene.posture.is_some() {
        haptic_host::tell!(
            "the [posture] of {} is left out of the search and of the scene that is written: put it back and check it \
             with `haptic check`",
            path.display()
        );
    }
    let Some(wall) = scene.walls.get(args.wall) else {
        return Err(Failure::wrong(format!("{} has no wall {}", path.display(), args.wall)).remedy("count from 0"));
    };
    let touched = touching_pose(file, &scene, args.wall);
    let untouchable = |what: &str| {
        Failure::impossible(format!("wall {} of {} cannot be touched", args.wall, path.display()))
            .remedy(format!("give {what}"))
    };
    let q = match (q, &touched) {
        (Some(q), _) => q,
        (None, Some((q, _))) => q.clone(),
        (None, None) => return Err(untouchable("--q and --normal")),
    };
    let normal = match (normal, &wall.surface, touched) {
        (Some(normal), ..) => normal,
        (None, Surface::Plane(plane), _) => plane.normal[..spec.task].to_vec(),
        (None, _, Some((_, normal))) => normal,
        (None, _, None) => return Err(untouchable("--normal")),
    };
    let point = match wall.surface {
        Surface::Plane(plane) if args.normal.is_none() => plane.point[..spec.task].to_vec(),
        _ => tip_position(file, &q)?,
    };
    Ok(WallPlace {
        q,
        normal,
        point: Some(point),
        written: Settings::of(&scene, args.wall),
        admissible: args.admissible.unwrap_or(scene.admissible),
    })
}

/// Returns the pose nearest to home in which the device touches a wall of a scene, and the normal there.
fn touching_pose(file: &DeviceFile, scene: &Scene<f64>, wall: usize) -> Option<(Vec<f64>, Vec<f64>)> {
    let (_, contacts) = file_warnings(&Subject::new(&file.description).ok()?, scene);
    contacts.into_iter().find(|contact| contact.wall == wall).map(|contact| (contact.q, contact.normal))
}

fn scene_comments(args: &Search, file: &DeviceFile, answer: &TuneResult, ripple: f64) -> Vec<String> {
    let scene = args.scene.as_deref().map_or(String::new(), |scene: &Path| format!(", after {}", scene.display()));
    vec![
        format!("The stiffest wall that `haptic tune` found on {}{scene}.", file.name),
        format!("Ripple {:.3} N (allowed: {ripple:.3} N); limited by: {}.", answer.best.ripple_n, answer.active),
    ]
}

/// Formats the stiffness that a hand feels if transmissions are compliant, as an addition to the wall's stiffness.
fn felt_in_words(felt: Option<f64>) -> String {
    felt.map_or(String::new(), |felt| format!(" (felt at the tip: {felt:.0} N/m)"))
}

/// Formats the ripple of a wall, with its ripple on the simulated board if that was measured.
fn ripple_in_words(found: &TunedWall) -> String {
    let board = found.board_ripple_n.map_or(String::new(), |ripple| format!(", {ripple:.4} N on the simulated board"));
    format!("ripple {:.4} N{board}", found.ripple_n)
}

fn settings_in_words(settings: &Settings) -> String {
    let mut text = format!("{} Hz, {}", settings.rate_hz, settings.estimator);
    if settings.value != 0 {
        let _ = write!(text, " {}", settings.value);
    }
    if settings.has_cutoff() {
        let _ = write!(text, " at {} Hz", settings.cutoff_hz);
    }
    let _ = write!(text, ", damping {} N s/m, feed-forward {}", settings.damping, settings.feed_forward.name());
    if settings.feed_forward == FeedForward::Washout {
        let _ = write!(text, " at {} Hz", settings.washout_hz);
    }
    if settings.damping_compensation {
        text.push_str(", damping compensated");
    }
    text
}

fn readable(document: &Document<'_>, unit: &str) -> String {
    let Document { answer, margins, .. } = document;
    let best: &TunedWall = &answer.best;
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    let joined = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    line(format!("{}: q = ({}) {unit}, n = ({})", document.device, joined(document.q), joined(document.normal)));
    line(format!(
        "  the stiffest wall        {:>10} N/m{}   {}",
        best.settings.stiffness,
        felt_in_words(best.felt),
        ripple_in_words(best)
    ));
    line(format!("    {}", settings_in_words(&best.settings)));
    if let Some(scene) = document.scene {
        let ripple = scene
            .ripple_n
            .map_or("no stiffness meets margins, ripple and rebounds".into(), |ripple| format!("ripple {ripple:.4} N"));
        let felt = felt_in_words(scene.felt);
        line(format!("  the scene's settings     {:>10} N/m{felt}   {ripple}", scene.settings.stiffness));
        line(format!(
            "    {}; {} N/m as written, {} N/m within the margins and the motors' limits with any ripple",
            settings_in_words(&scene.settings),
            scene.as_written,
            scene.within_margins
        ));
    }
    if let Some(times) = document.times {
        line(format!(
            "  {times:.2} times as stiff within the same margins and {} N of ripple, {} N on the simulated board",
            digits(document.ripple_limit_n),
            document.board_ripple_limit_n.map_or("any".into(), digits)
        ));
    }
    line(format!(
        "\n  limited by: {}, the first limit that a stiffer wall exceeds; margins: gain {}, {:.1} us more delay, {:.0} % of mass, {:.0} % of each inertia, {:.0} % of friction, {:.0} % of counts, and hands",
        answer.active,
        margins.gain,
        1e6 * margins.delay_s,
        100.0 * margins.mass,
        100.0 * margins.inertia,
        100.0 * margins.friction,
        100.0 * margins.counts
    ));
    line(format!("  {:<30}{:>14}", "at this damping, alone", "up to N/m"));
    for limit in &answer.limits {
        let up_to = limit.stiffness.map_or("no bound".into(), |stiffness| format!("{stiffness:.0}"));
        line(format!("    {:<28}{up_to:>14}{}", limit.limit, felt_in_words(limit.felt)));
    }
    line("  nearby".into());
    for neighbour in &answer.beside {
        let ripple = neighbour.ripple_n.map_or("the tip flies off".into(), |ripple| format!("ripple {ripple:.4} N"));
        let beyond = if neighbour.allowed { "" } else { ", beyond the margins or the motors' limits" };
        let rebounds = if neighbour.rebounds { ", rebounds" } else { "" };
        line(format!(
            "    {:>10} N/m with {} N s/m: {ripple}{beyond}{rebounds}",
            neighbour.stiffness, neighbour.damping
        ));
    }
    for other in &answer.feed_forwards {
        line(describe_other(other, best, answer.passed_over.as_ref()));
    }
    line("\n  the best of each estimator".into());
    for found in &answer.others {
        let (felt, settings) = (felt_in_words(found.felt), settings_in_words(&found.settings));
        line(format!("    {:>10} N/m{felt}  {}  {settings}", found.settings.stiffness, ripple_in_words(found)));
    }
    line(format!("  {} combinations, {} of them simulated", answer.looked_at.0, answer.looked_at.1));
    let describe_measured = |name: &str, measured: &MeasuredWall| {
        let ripple = measured
            .ripple_n
            .map_or("the wall does not hold the hand".into(), |ripple| format!("ripple {ripple:.4} N"));
        let open = measured
            .open
            .as_ref()
            .map_or(String::new(), |why| format!(" or more, because no limit was reached: {why}"));
        format!("  {name}: {ripple}; a struck tip comes to rest up to {:.0} N/m{open}", measured.stiffness)
    };
    if let Some(found) = document.scene_measured {
        line(describe_measured("on the simulated board, the scene's settings", found));
    }
    if let Some(found) = document.measured {
        line(describe_measured("on the simulated board, these", found));
    }
    if let (Some(before), Some(found)) = (document.scene_measured, document.measured) {
        line(rest_range_in_words(before, found));
    }
    text
}

/// Describes the best wall with another feed-forward.
fn describe_other(other: &Alternative, best: &TunedWall, passed_over: Option<&TunedWall>) -> String {
    let mut text = format!("  feed-forward {}: ", other.feed_forward.name());
    match &other.best {
        Some(found) => {
            let _ = write!(
                text,
                "{} N/m{} at most, {:.2} times, with a ripple of {:.4} N",
                found.settings.stiffness,
                felt_in_words(found.felt),
                found.settings.stiffness / best.settings.stiffness,
                found.ripple_n
            );
            if passed_over == Some(found) {
                text.push_str("; not chosen, because the difference is less than 3 %");
            }
        }
        None => text.push_str("no wall with it is nearly as stiff"),
    }
    let ripple = other.ripple_n.map_or("flies off".into(), |ripple| format!("ripples {ripple:.4} N"));
    let _ = write!(text, ". The wall above with it {ripple}, and up to {:.0} N/m keep the margins", other.allowed);
    text
}

/// Describes the cost of a stiffer wall: a struck tip comes to rest up to another stiffness.
fn rest_range_in_words(before: &MeasuredWall, found: &MeasuredWall) -> String {
    let at_least = |measured: &MeasuredWall| if measured.open.is_some() { "at least " } else { "" };
    format!(
        "  cost: at these dampings a struck tip came to rest up to {}{:.0} N/m, and now up to {}{:.0} N/m",
        at_least(before),
        before.stiffness,
        at_least(found),
        found.stiffness
    )
}
