//! `haptic range`: which walls stay stable on a device, predicted, without and with the feed-forward.

use super::arguments::{self, Numbers};
use super::continued::Continue;
use super::force::Force;
use super::port::counted;
use clap::{Args as ClapArgs, ValueEnum};
use haptic::analysis::control_loop::{CURRENT_LOOP_HZ, usual_delay};
use haptic::analysis::flexible::Hand;
use haptic::analysis::host::{Host, HostWall};
use haptic::analysis::passivity::Passivity;
use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::pose::motors;
use haptic::analysis::range::{Domain, Range, WORTHWHILE_RATIO, predict, predict_several};
use haptic::analysis::ripple::{Along, DampingRule, LIGHT_HAND, PUSH_N, Pressed, Ripple};
use haptic::analysis::sampled::{AnalysisError, LinearEstimator, Loop, Mode};
use haptic::analysis::several::{Member, WallSet};
use haptic::analysis::why::{Both, Limits, Why, why};
use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use haptic::plausible::{Doubt, Warned, angles, warn};
use haptic::plot::range::{Contents, draw};
use haptic::sweep::Sweep;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::description::Description;
use haptic_bridge::render::scene::{MAX_RATE_HZ, MIN_RATE_HZ};
use haptic_bridge::render::velocity::Estimator;
use std::fmt::Write;
use std::path::PathBuf;

/// Predict which stiffness and damping a wall can have before it oscillates
///
/// Exact sampled-data analysis (zero-order hold, delay, velocity filter, joint damping) of walls at one pose,
/// without and with the feed-forward. Friction and a hand make the measured range larger; `haptic measure-range`
/// measures it.
#[derive(ClapArgs)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Joint angles in rad, such as 2.4,0.7 [default: the device file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
    /// Normal of a wall, any length; once per wall that acts
    #[arg(long, value_name = "X,Y,..", required = true, allow_hyphen_values = true)]
    normal: Vec<Numbers>,
    /// Each wall's part of stiffness and damping, with several --normal; results are the totals [default: equal parts]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    share: Option<Numbers>,
    /// Walls whose feed-forward is off beside others that have it, counted from 0 in the order of --normal
    #[arg(long, value_name = "I,J,..")]
    no_feed_forward: Option<Numbers>,
    /// Control rate in Hz
    #[arg(long, value_name = "HZ", default_value_t = 1_000.0)]
    rate: f64,
    /// Cutoff of the velocity filter in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0)]
    cutoff: f64,
    /// Delay from reading the encoders to applying the torque, in control samples [default: 0]
    #[arg(long, value_name = "SAMPLES", allow_hyphen_values = true, conflicts_with = "board")]
    delay: Option<f64>,
    /// Velocity estimator
    #[arg(long, value_name = "KIND", default_value = "butterworth", value_parser = arguments::linear_estimator())]
    estimator: Estimator,
    /// Take the velocity from the difference over so many samples, before the estimator's filter
    #[arg(long, value_name = "SAMPLES", default_value_t = 1)]
    difference_over: usize,
    /// A hand on the tip: its mass (kg), damping (N s/m) and stiffness (N/m), the same in every direction
    #[arg(long, value_name = "M,B,K", allow_hyphen_values = true)]
    hand: Option<Numbers>,
    /// Leave the joints' own viscous damping out
    #[arg(long)]
    undamped: bool,
    /// Evaluate the boundary at exactly these dampings, in N s/m [default: 200 even ones]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    kd: Option<Numbers>,
    /// Also analyse the feed-forward behind a washout at this frequency, in Hz
    #[arg(long, value_name = "HZ")]
    washout: Option<f64>,
    /// Let the feed-forward compensate the joints' own damping too
    #[arg(long)]
    damping_compensation: bool,
    /// How much of (4)'s feed-forward there is; below the pole of the inertia, which the board enforces
    #[arg(long, value_name = "ALPHA", default_value_t = 1.0)]
    feed_forward_gain: f64,
    /// What a redundant device holds: orientation, joint-0, joint-1, joint-2 or consistent
    #[arg(long, value_name = "COORDINATE", default_value = "orientation", value_parser = arguments::admissible)]
    admissible: Admissible,
    /// How the motors are driven: ideal (torque at once), voltage (resistance, inductance and back-EMF of the device
    /// file's motors), current (a current loop of --current-bandwidth) [default: ideal]
    #[arg(long, value_name = "KIND", conflicts_with = "board")]
    drive: Option<DriveKind>,
    /// The drive and the delay of this board, instead of an ideal drive without delay
    #[arg(long, value_name = "BOARD")]
    board: Option<BoardKind>,
    /// Bandwidth of the current loop in Hz, for --drive current; the default lags by half a carrier period at 20 kHz,
    /// as the boards' loops do, which make a current within one
    #[arg(long, value_name = "HZ", default_value_t = CURRENT_LOOP_HZ)]
    current_bandwidth: f64,
    /// Also analyse the wall rendered by a program on a computer that asks so many times a second, over this board
    #[arg(long, value_name = "HZ")]
    host_rate: Option<f64>,
    /// Age of that program's forces when they begin to act, in seconds, as `haptic latency` measures it
    /// [default: from one request to the next]
    #[arg(long, value_name = "S", requires = "host_rate", allow_hyphen_values = true)]
    host_delay: Option<f64>,
    /// Say why the boundary lies where it lies: what sampling, delay, drive, filter, transmissions, hand and joint
    /// damping take from it, each by the same loop without it; --svg and --png then draw that
    #[arg(long)]
    why: bool,
    /// Also simulate what encoder steps make of a wall that a hand presses with 3 N, and say from which stiffness on the
    /// root mean square of its force exceeds this bound, in N; damping is that of --damping-ratio, or each of --kd. The
    /// hand is that of --hand, or a light one (0.05 kg, 3 N s/m, 200 N/m)
    #[arg(long, value_name = "N")]
    ripple: Option<f64>,
    /// The same of one wall, whose stiffness (N/m) and damping (N s/m) are given
    #[arg(long, value_name = "KP,KD", allow_hyphen_values = true)]
    wall: Option<Numbers>,
    /// Damping of the walls of --ripple, as a share of the critical damping of the inertia they meet
    #[arg(long, value_name = "RATIO", default_value_t = 0.7)]
    damping_ratio: f64,
    #[command(flatten)]
    continued: Continue,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Draw the range into this SVG file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Draw the range into this PNG file
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Drives of the analysis.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum DriveKind {
    Ideal,
    Voltage,
    Current,
}

/// Boards whose drive and delay are known.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum BoardKind {
    OdriveV3,
    HBridgeF405,
}

impl BoardKind {
    fn axes(self) -> usize {
        match self {
            BoardKind::OdriveV3 => 2,
            BoardKind::HBridgeF405 => 3,
        }
    }
}

impl Args {
    /// Control samples.
    fn delay(&self) -> f64 {
        match self.board {
            // Both boards sample at the middle of a carrier period and apply the duty at its end.
            Some(_) => usual_delay(self.rate),
            None => self.delay.unwrap_or(0.0),
        }
    }

    fn drive(&self) -> DriveKind {
        match self.board {
            Some(_) => DriveKind::Current,
            None => self.drive.unwrap_or(DriveKind::Ideal),
        }
    }

    fn host(&self) -> Option<Host> {
        self.host_rate.map(|rate_hz| Host { rate_hz, delay_s: self.host_delay.unwrap_or(1.0 / rate_hz) })
    }

    fn hand(&self) -> Result<Hand, Failure> {
        let Some(Numbers(numbers)) = &self.hand else { return Ok(Hand::default()) };
        let remedy = "write mass (kg), damping (N s/m) and stiffness (N/m), such as 0.2,5,500";
        match numbers[..] {
            [mass, damping, stiffness] if numbers.iter().all(|number| *number >= 0.0) => {
                Ok(Hand { mass, damping, stiffness })
            }
            [_, _, _] => Err(Failure::wrong("--hand holds a negative number").remedy(remedy)),
            _ => {
                let numbers = counted(numbers.len(), "number");
                Err(Failure::wrong(format!("--hand has {numbers}, and a hand has 3")).remedy(remedy))
            }
        }
    }
}

/// Below this ratio a feed-forward costs more than it brings, beyond what rounds away.
const COSTLY: f64 = 0.99;

/// Analyses, prints and draws.
pub fn run(args: Args) -> Result<(), Failure> {
    args.force.pictures(args.svg.as_ref(), args.png.as_ref())?;
    let file = DeviceFile::load(&args.device)?;
    let spec = file.spec();
    if !(MIN_RATE_HZ..=MAX_RATE_HZ).contains(&args.rate) {
        let reason = format!("--rate {} Hz is none that a board has", args.rate);
        return Err(Failure::wrong(reason).remedy(format!("write {MIN_RATE_HZ} to {MAX_RATE_HZ} Hz")));
    }
    let q = match (&args.q, file.description.home) {
        (Some(q), _) => q.clone().exactly(spec.joints, "--q", "joint angles")?,
        (None, Some(home)) => home[..spec.joints].to_vec(),
        (None, None) => {
            return Err(Failure::wrong(format!("{} has no [home], so there is no pose", args.device.display()))
                .remedy("say which with --q"));
        }
    };
    let mut warnings: Vec<_> = angles(&q, "--q").into_iter().map(Doubt::typed).collect();
    let normals = args
        .normal
        .iter()
        .map(|normal| normal.clone().unit(spec.task, "--normal"))
        .collect::<Result<Vec<Vec<f64>>, Failure>>()?;
    let shares = match args.share.clone() {
        Some(share) => share.per_wall(normals.len(), "--share")?,
        None => vec![1.0; normals.len()],
    };
    let with = Numbers::with_feed_forward(args.no_feed_forward.clone(), normals.len(), "--no-feed-forward")?;
    let members: Vec<Member> = normals
        .iter()
        .zip(shares.into_iter().zip(with))
        .map(|(normal, (share, feed_forward))| Member { normal: normal.clone(), share, feed_forward })
        .collect();
    if let Some(board) = args.board.filter(|board| board.axes() < spec.joints) {
        let reason = format!("{} has {} joints, and this board drives {}", file.name, spec.joints, board.axes());
        return Err(Failure::wrong(reason).remedy("choose a board with as many axes: h-bridge-f405 has three"));
    }
    let drive = match args.drive() {
        DriveKind::Ideal => Drive::Ideal,
        DriveKind::Current => Drive::Current { bandwidth_hz: args.current_bandwidth },
        DriveKind::Voltage => Drive::Voltage(motors(&file.description).ok_or_else(|| {
            Failure::wrong(format!("{} has joints without [joint.motor]", args.device.display()))
                .remedy("a voltage drive is analysed with the motors' resistance and back-EMF: add them")
        })?),
    };
    let around = Loop {
        rate_hz: args.rate,
        delay_samples: args.delay(),
        estimator: estimator(&args)?,
        drive,
        damping_compensation: args.damping_compensation,
    };
    let (analyse, passivity) = walls(&args, &file, &q, &members, &around)?;
    let range = analyse(args.kd.as_ref().map(|kd| kd.0.as_slice()))?;
    warnings.extend(costly(&range).map(|text| Doubt { key: None, text }.typed()));
    warn(&warnings);
    let asked = (&args.ripple, &args.kd, args.washout, args.damping_ratio, &args.hand);
    let device = (file.description, args.undamped, args.feed_forward_gain, args.admissible);
    let question = format!("{device:?} {q:?} {normals:?} {around:?} {asked:?}");
    let sweep = args.continued.sweep("range", &question)?;
    let why = if args.why { Some(explained(&args, &file, &q, &normals, &around, &sweep)?) } else { None };
    let steps = stepped(&args, &file, &q, &normals, &around, &sweep)?;
    let pictures = args.svg.is_some() || args.png.is_some();
    if let Some(why) = why.as_ref().filter(|_| pictures) {
        let title = format!("{}: what each effect takes from the stiffest wall", file.name);
        let picture = haptic::plot::why::draw(&title, &subtitle(&args, &q, &normals, range.area_ratio), why);
        args.svg.as_deref().map(|path| picture.save_svg(path)).transpose()?;
        args.png.as_deref().map(|path| picture.save_png(path)).transpose()?;
    } else if pictures {
        // A picture always shows the whole boundary, whatever points were asked for.
        let whole = if args.kd.is_some() { analyse(None)? } else { range.clone() };
        let picture = draw(&Contents {
            title: format!("{}: stable walls, predicted", file.name),
            subtitle: subtitle(&args, &q, &normals, range.area_ratio),
            range: &whole,
            passivity: passivity.as_ref(),
            washout_hz: args.washout,
            measured_off: &[],
            measured_full: &[],
        });
        args.svg.as_deref().map(|path| picture.save_svg(path)).transpose()?;
        args.png.as_deref().map(|path| picture.save_png(path)).transpose()?;
    }
    if args.json {
        let result = Explained { range: &range, why: why.as_ref(), ripple: steps.as_ref() };
        let json =
            serde_json::to_string(&Warned { result: &result, warnings: &warnings }).map_err(Failure::impossible)?;
        print(&(json + "\n"))?;
    } else {
        print(&readable(&file.name, &args, &q, &normals, &range, passivity.as_ref(), &file.description))?;
        why.map_or(Ok(()), |why| print(&in_words(&why)))?;
        steps.map_or(Ok(()), |steps| print(&steps.in_words()))?;
    }
    sweep.finish();
    Ok(())
}

/// What encoder steps make of pressed walls.
#[derive(serde::Serialize)]
struct Steps {
    /// What one count of the coarsest joint moves along the normal, m.
    count_m: f64,
    push_n: f64,
    /// Mass (kg), damping (N s/m), stiffness (N/m).
    hand: [f64; 3],
    /// One entry for each way of damping.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    lines: Vec<StepsAlong>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wall: Option<StepsOfWall>,
}

#[derive(serde::Serialize)]
struct StepsAlong {
    bound_n: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    damping_ratio: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    kd: Option<f64>,
    off: Along,
    full: Along,
    #[serde(skip_serializing_if = "Option::is_none")]
    washout: Option<Along>,
}

#[derive(serde::Serialize)]
struct StepsOfWall {
    /// The largest force that one count alone makes, N.
    step_n: f64,
    off: Ripple,
    full: Ripple,
    #[serde(skip_serializing_if = "Option::is_none")]
    washout: Option<Ripple>,
}

/// What encoder steps make of the walls that were asked for.
fn stepped(
    args: &Args,
    file: &DeviceFile,
    q: &[f64],
    normals: &[Vec<f64>],
    around: &Loop,
    sweep: &Sweep,
) -> Result<Option<Steps>, Failure> {
    if args.ripple.is_none() && args.wall.is_none() {
        return Ok(None);
    }
    let [normal] = normals else {
        let reason = "--ripple or --wall with several --normal";
        return Err(Failure::wrong(reason).remedy("ask for the ripple of one wall at a time"));
    };
    if args.damping_compensation {
        let reason = "--ripple or --wall with --damping-compensation";
        return Err(Failure::wrong(reason).remedy("the ripple is simulated without it: leave it out"));
    }
    let positive = |value: f64, what: &str| match value.is_finite() && value > 0.0 {
        true => Ok(value),
        false => Err(Failure::wrong(format!("{what} {value} is not more than zero")).remedy("write a positive number")),
    };
    let device = seen(args, file, q, normal)?;
    let mut description = file.description;
    if args.undamped {
        description.joints.iter_mut().for_each(|joint| joint.viscous = 0.0);
    }
    let hand = if args.hand.is_some() { args.hand()? } else { LIGHT_HAND };
    let (q, normal) = (q.to_vec(), normal.clone());
    let pressed = Pressed { device: &device, description, q, normal, around, hand, push_n: PUSH_N };
    let unseen = || {
        Failure::wrong(format!("{} has joints without [joint.encoder]", args.device.display()))
            .remedy("ripple is what encoder steps make: add them")
    };
    let count_m = pressed.count_m().ok_or_else(unseen)?;
    let washout = args.washout.map(Mode::Washout);
    let mut lines = Vec::new();
    if let Some(bound) = args.ripple {
        let bound_n = positive(bound, "--ripple")?;
        let ratio = positive(args.damping_ratio, "--damping-ratio")?;
        let dampings: Vec<DampingRule> = match &args.kd {
            Some(Numbers(dampings)) => dampings.iter().map(|kd| DampingRule::Damping(*kd)).collect(),
            None => vec![DampingRule::Ratio(ratio)],
        };
        for line in dampings {
            let along = |mode| pressed.along(mode, line, bound_n, sweep)?.ok_or_else(unseen);
            let (damping_ratio, kd) = match line {
                DampingRule::Ratio(ratio) => (Some(ratio), None),
                DampingRule::Damping(kd) => (None, Some(kd)),
            };
            lines.push(StepsAlong {
                bound_n,
                damping_ratio,
                kd,
                off: along(Mode::Off)?,
                full: along(Mode::Full)?,
                washout: washout.map(along).transpose()?,
            });
        }
    }
    let wall = match args.wall.clone() {
        None => None,
        Some(wall) => {
            let wall = wall.exactly(2, "--wall", "numbers, stiffness and damping")?;
            if wall[0].is_nan() || wall[0] <= 0.0 || wall[1].is_nan() || wall[1] < 0.0 {
                return Err(Failure::wrong("--wall needs a stiffness above zero and a damping that is not negative")
                    .remedy("write N/m and N s/m, such as 5000,150"));
            }
            let of = |mode| pressed.ripple(mode, wall[0], wall[1]).ok_or_else(unseen);
            Some(StepsOfWall {
                step_n: pressed.step_n(wall[0], wall[1]).ok_or_else(unseen)?,
                off: of(Mode::Off)?,
                full: of(Mode::Full)?,
                washout: washout.map(of).transpose()?,
            })
        }
    };
    Ok(Some(Steps { count_m, push_n: PUSH_N, hand: [hand.mass, hand.damping, hand.stiffness], lines, wall }))
}

impl Steps {
    fn in_words(&self) -> String {
        let mut text = String::new();
        let [mass, damping, stiffness] = self.hand;
        let _ = writeln!(
            text,
            "\n  encoder steps, simulated: one count is {:.4} mm here; a hand of {mass} kg, {damping} N s/m, {stiffness} \
             N/m presses with {} N",
            1e3 * self.count_m,
            self.push_n
        );
        for line in &self.lines {
            let damping = match (line.damping_ratio, line.kd) {
                (Some(ratio), _) => format!("{ratio} of critical damping"),
                (_, kd) => format!("kd = {} N s/m", kd.unwrap_or_default()),
            };
            let mut row = |label: &str, along: &Along| {
                let from = match along.kp_from {
                    Some(kp) => format!("from {kp:.1} N/m on"),
                    None => "at no wall tried".into(),
                };
                let _ = writeln!(
                    text,
                    "  {label:<18} force ripple above {} N rms {from}; stable to {:.1} N/m ({damping})",
                    line.bound_n, along.kp_stable
                );
            };
            row("no feed-forward", &line.off);
            row("feed-forward (4)", &line.full);
            if let Some(washout) = &line.washout {
                row("washout", washout);
            }
        }
        if let Some(wall) = &self.wall {
            let mut row = |label: &str, ripple: &Ripple| {
                let _ = match (ripple.rms_n, ripple.peak_n, ripple.motion_m) {
                    (Some(rms), Some(peak), Some(motion)) => writeln!(
                        text,
                        "  {label:<18} {} N/m, {} N s/m: ripple {rms:.3} N rms, {peak:.3} N peak; the tip moves {:.4} mm",
                        ripple.kp,
                        ripple.kd,
                        1e3 * motion
                    ),
                    _ => writeln!(text, "  {label:<18} {} N/m, {} N s/m: the tip flies off", ripple.kp, ripple.kd),
                };
            };
            row("no feed-forward", &wall.off);
            row("feed-forward (4)", &wall.full);
            if let Some(washout) = &wall.washout {
                row("washout", washout);
            }
            let _ = writeln!(text, "  one count alone changes that wall's force by up to {:.3} N", wall.step_n);
        }
        text
    }
}

/// The document of `--json`.
#[derive(serde::Serialize)]
struct Explained<'a> {
    #[serde(flatten)]
    range: &'a Range,
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<&'a Why>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ripple: Option<&'a Steps>,
}

/// What each effect takes, of the one wall that there is.
fn explained(
    args: &Args,
    file: &DeviceFile,
    q: &[f64],
    normals: &[Vec<f64>],
    around: &Loop,
    sweep: &Sweep,
) -> Result<Why, Failure> {
    let [normal] = normals else {
        let reason = "--why with several --normal";
        return Err(Failure::wrong(reason).remedy("ask why of one wall at a time"));
    };
    why(&seen(args, file, q, normal)?, around, sweep)
}

/// The device as one wall sees it.
fn seen(args: &Args, file: &DeviceFile, q: &[f64], normal: &[f64]) -> Result<Linearised, Failure> {
    let mut device = Linearised::holding(&file.description, q, normal, args.admissible)?.held(args.hand()?);
    device.gain = args.feed_forward_gain;
    Ok(if args.undamped { device.undamped() } else { device })
}

/// Why, as a table.
fn in_words(why: &Why) -> String {
    let mut text =
        format!("\n  {:<40}{:>16}{:>9}{:>16}{:>9}\n", "largest kp without", "off N/m", "takes", "full N/m", "takes");
    let number = |limits: Option<Limits>| limits.map_or("no limit".into(), |limits| format!("{:.2}", limits.kp_max));
    let share = |share: Option<f64>| share.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share));
    let mut row = |name: &str, limits: &Both, takes: [String; 2]| {
        let [off, full] = takes;
        let _ = writeln!(text, "  {name:<40}{:>16}{off:>9}{:>16}{full:>9}", number(limits.off), number(limits.full));
    };
    row("(with everything)", &why.limits, [String::new(), String::new()]);
    for without in &why.effects {
        let name = format!("{} ({})", without.effect, without.instead);
        row(&name, &without.limits, [share(without.takes.off), share(without.takes.full)]);
    }
    text.push_str("  takes: of the largest stiffness without it; negative where it helps; they do not add up\n");
    text
}

/// A doubt about a feed-forward that costs more than it brings.
fn costly(range: &Range) -> Option<String> {
    let top = |domain: &Domain| domain.boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
    let stiffness = top(&range.full) / top(&range.off).max(f64::MIN_POSITIVE);
    let worse = range.off.area > 0.0 && (range.area_ratio < COSTLY || stiffness < COSTLY);
    worse.then(|| {
        format!(
            "the feed-forward costs more than it brings here: the stable area becomes {:.2} times as large and the \
             stiffest wall {stiffness:.2} times as stiff; leave it off at this pose and normal",
            range.area_ratio
        )
    })
}

/// The estimator that was asked for.
fn estimator(args: &Args) -> Result<LinearEstimator, Failure> {
    let over = args.difference_over;
    let alone = LinearEstimator::of(args.estimator, args.cutoff).ok_or_else(|| {
        Failure::wrong(format!("{} has no linear analysis", args.estimator.name())).remedy("choose another --estimator")
    })?;
    match over {
        1 => Ok(alone),
        _ if alone.takes_difference() => Ok(alone.over(over)),
        _ => {
            let reason = format!("--difference-over {over} with an estimator that takes no difference");
            Err(Failure::wrong(reason).remedy("leave it out, or choose a low-pass with --estimator"))
        }
    }
}

/// What predicts the range at given dampings.
type Analysis<'a> = Box<dyn Fn(Option<&[f64]>) -> Result<Range, AnalysisError> + 'a>;

/// The analysis of one wall, with its passive limits, or of several.
fn walls<'a>(
    args: &'a Args,
    file: &DeviceFile,
    q: &[f64],
    members: &[Member],
    around: &'a Loop,
) -> Result<(Analysis<'a>, Option<Passivity>), Failure> {
    let gain = args.feed_forward_gain;
    if let [only] = members {
        let device = seen(args, file, q, &only.normal)?;
        let most = device.most_gain().unwrap_or(1.0);
        if !(0.0..=most).contains(&gain) {
            let reason = format!("--feed-forward-gain {gain} is not from 0 to {most:.3}");
            return Err(
                Failure::wrong(reason).remedy("a board gives no more here: beyond lies the pole of the inertia")
            );
        }
        let passivity = Passivity::new(&device, &file.description, 1.0 / args.rate, around.delay_samples);
        let analyse = move |kd: Option<&[f64]>| {
            let host = args.host().map(|host| host.domain(&device, around, kd)).transpose()?;
            Ok(Range { host, ..predict(&device, around, kd, args.washout)? })
        };
        return Ok((Box::new(analyse), Some(passivity)));
    }
    if args.host_rate.is_some() {
        let reason = "--host-rate with several --normal";
        return Err(Failure::wrong(reason).remedy("a wall that a computer renders is analysed one at a time"));
    }
    if gain != 1.0 {
        let reason = format!("--feed-forward-gain {gain} with several --normal");
        return Err(Failure::wrong(reason).remedy("several walls are analysed with a gain of 1; leave it out"));
    }
    if file.description.is_flexible() || args.hand()?.is_there() {
        let reason = "several --normal with transmissions ([joint.transmission]) or --hand";
        return Err(Failure::wrong(reason).remedy("analyse one wall at a time, or the rigid device by itself"));
    }
    let set = WallSet::at(&file.description, q, members, args.admissible)?;
    let set = if args.undamped { set.undamped() } else { set };
    Ok((Box::new(move |kd| predict_several(&set, around, kd, args.washout)), None))
}

fn subtitle(args: &Args, q: &[f64], normals: &[Vec<f64>], ratio: f64) -> [String; 2] {
    let joined = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    [
        format!(
            "q = ({}) rad, n = {}",
            joined(q),
            normals.iter().map(|n| format!("({})", joined(n))).collect::<Vec<_>>().join(" + ")
        ),
        format!(
            "{} Hz, cutoff {} Hz, delay {}, {:?} drive; area ratio {ratio:.3}",
            args.rate,
            args.cutoff,
            counted(args.delay(), "sample"),
            args.drive()
        )
        .to_lowercase()
        .replace("hz", "Hz"),
    ]
}

/// What is in the loop that is not in every one.
fn besides(args: &Args, description: &Description) -> Vec<String> {
    let mut besides = Vec::new();
    if description.is_flexible() {
        besides.push("with the transmissions and modes of the device file".to_string());
    }
    if let Some(Numbers(hand)) = &args.hand {
        besides.push(format!("in a hand of {} kg, {} N s/m, {} N/m", hand[0], hand[1], hand[2]));
    }
    let joints = &description.joints[..description.kind.spec().joints];
    if joints.iter().any(|joint| joint.friction.is_some() || joint.cogging.is_some()) {
        besides.push(
            "without dry friction and cogging, which are not linear (--ripple and `haptic sim` have them)".into(),
        );
    }
    if args.difference_over > 1 {
        besides.push(format!("velocity from the difference over {} samples", args.difference_over));
    }
    besides
}

fn readable(
    name: &str,
    args: &Args,
    q: &[f64],
    normals: &[Vec<f64>],
    range: &Range,
    passivity: Option<&Passivity>,
    description: &Description,
) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    let [pose, around] = subtitle(args, q, normals, range.area_ratio);
    line(format!("{name}: {pose}"));
    line(format!("  {around}"));
    for more in besides(args, description) {
        line(format!("  {more}"));
    }
    line(format!("  effective inertia Weff, met without feed-forward  {:>12.6} kg", range.w_eff));
    line(format!("  rendered inertia Wrr, met with feed-forward       {:>12.6} kg", range.w_rr));
    if let Some((gain, met)) = range.feed_forward_gain.zip(range.inertia_met) {
        line(format!("  met with {gain} times the feed-forward{:>28.6} kg", met));
        line(format!("  {}", price(range.w_eff, range.w_rr, gain)));
    }
    line(String::new());
    line(format!("  {:<26}{:>14}{:>14}{:>18}", "", "max kp N/m", "kd_max N s/m", "area N²s/m²"));
    let mut row = |label: &str, domain: &Domain| {
        let top = domain.boundary.iter().map(|p| p.kp).fold(0.0, f64::max);
        line(format!("  {label:<26}{top:>14.2}{:>14.4}{:>18.6e}", domain.kd_max, domain.area));
    };
    row("no feed-forward", &range.off);
    row("feed-forward (4)", &range.full);
    if let Some(washout) = &range.washout {
        row(&format!("washout {} Hz", args.washout.unwrap_or_default()), washout);
    }
    if let Some(host) = &range.host {
        row(&format!("on a computer, {:.0} Hz", host.rate_hz), &host.domain);
    }
    if args.kd.is_some() {
        line("  max kp: of the dampings asked for; without --kd that of the whole range".into());
    }
    line(String::new());
    // A dozen rows are enough to read; --json gives the rest.
    let step = if args.kd.is_some() { 1 } else { (range.off.boundary.len() / 12).max(1) };
    let domains = [
        ("off", Some(&range.off)),
        ("full", Some(&range.full)),
        ("washed", range.washout.as_ref()),
        ("host", range.host.as_ref().map(|host| &host.domain)),
    ];
    let columns = || domains.iter().filter_map(|(name, domain)| Some((name, domain.as_ref()?)));
    line(columns().fold(" ".into(), |row, (name, _)| {
        format!("{row} {:>12}{:>14}", format!("kd {name}"), format!("kp_max {name}"))
    }));
    for index in (0..range.off.boundary.len()).step_by(step) {
        line(
            columns()
                .filter_map(|(_, domain)| domain.boundary.get(index))
                .fold(" ".into(), |row, point| format!("{row} {:>12.4}{:>14.2}", point.kd, point.kp)),
        );
    }
    line(String::new());
    let islands = range.off.islands.len() + range.full.islands.len();
    if islands > 0 {
        line(format!(
            "  {islands} stable intervals lie above the boundary (islands): listed with --json, not counted."
        ));
    }
    if let Some(passivity) = passivity {
        line(format!(
            "  passive without feed-forward (Colgate and Schenkel 1997): kp < {:.2} N/m at kd = 0, kd < {:.4} N s/m",
            passivity.sampled(0.0),
            passivity.damping
        ));
        if let Some(limit) = passivity.quantised() {
            line(format!(
                "  passive with quantisation and friction (Abbott and Okamura 2005): kp <= {limit:.2} N/m at kd = 0"
            ));
        }
    }
    if let Some(host) = &range.host {
        line(format!("  {}", on_a_computer(range, host)));
    }
    line(verdict(range));
    text
}

/// What a gain costs, in a sentence.
fn price(w_eff: f64, w_rr: f64, gain: f64) -> String {
    let coupling = 1.0 - w_eff / w_rr;
    format!(
        "its price: {gain} times (4)'s push along the wall at rest, and a coupling off by 1 % changes the inertia met by \
         {:.2} % ({:.2} % at a gain of 1)",
        gain * coupling / (1.0 - gain * coupling),
        coupling / (1.0 - coupling)
    )
}

/// What rendering on the board is worth, in a sentence.
fn on_a_computer(range: &Range, host: &HostWall) -> String {
    let top = |domain: &Domain| domain.boundary.iter().map(|point| point.kp).fold(0.0, f64::max);
    let by =
        format!("a computer that asks {:.0} times a second, its forces {} ms old", host.rate_hz, 1e3 * host.delay_s);
    if top(&host.domain) == 0.0 {
        return format!("rendered by {by}: never stable");
    }
    let times = top(&range.off) / top(&host.domain);
    format!("rendered by {by}: the board's own wall is up to {times:.1} times as stiff")
}

/// What the feed-forward buys, in a sentence.
fn verdict(range: &Range) -> String {
    let ratio = range.area_ratio;
    if range.off.area == 0.0 {
        "Nothing is stable here without the feed-forward: lower the delay or raise the cutoff.".into()
    } else if range.full.area == 0.0 {
        "With the feed-forward nothing is stable here: uneven joint damping makes it creep. Try --damping-compensation."
            .into()
    } else if ratio < WORTHWHILE_RATIO {
        format!(
            "The feed-forward buys nothing here: the stable area changes by {:+.1} %. Leave it off at this pose and normal.",
            100.0 * (ratio - 1.0)
        )
    } else {
        format!("With the feed-forward the stable area is {ratio:.3} times as large.")
    }
}
