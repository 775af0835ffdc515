//! `haptic range`: predicts which walls stay stable on a device, without and with the feed-forward.

mod ripple;
mod words;

use super::answer::{Json, Pictures};
use super::arguments::{self, DeviceAt, HoldingArgs, Numbers, WallArgs};
use super::continued::Continue;
use super::port::counted;
use clap::{Args as ClapArgs, ValueEnum};
use haptic_bridge::model::description::Description;
use haptic_bridge::render::velocity::Estimator;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_predict::boards::BoardKind;
use haptic_predict::plausible::{FileWarning, WithWarnings, warn};
use haptic_show::plot::range::{Contents, draw};
use haptic_stability::analysis::control_loop::{CURRENT_LOOP_HZ, TorquePath};
use haptic_stability::analysis::flexible::{Hand, Posture};
use haptic_stability::analysis::host::Host;
use haptic_stability::analysis::passivity::Passivity;
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::motors;
use haptic_stability::analysis::prediction::{Prediction, Subject, Walls};
use haptic_stability::analysis::range::Range;
use haptic_stability::analysis::sampled::{AnalysisError, LinearEstimator, Loop};
use haptic_stability::analysis::several::Member;
use haptic_stability::analysis::why::{EffectShares, explain_boundary};
use haptic_stability::sweep::Sweep;
use ripple::{EncoderRipple, simulate_ripple};
use words::{costly_warnings, describe_why, readable, subtitle};

/// Predict which stiffness and damping a wall can have before it oscillates
///
/// Exact sampled-data analysis (zero-order hold, delay, velocity filter, joint damping) of walls at one pose, without
/// and with the feed-forward. Friction makes the measured range larger. A hand (--hand) usually does too, but behind
/// cables it makes the range smaller. `haptic measure-range` measures the range.
#[derive(ClapArgs)]
pub struct Args {
    #[command(flatten)]
    at: DeviceAt,
    #[command(flatten)]
    walls: WallArgs,
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
    #[arg(long, value_name = "KIND", default_value = "butterworth", value_parser = arguments::estimator_parser())]
    estimator: Estimator,
    /// Take the velocity from the difference over this number of samples, before the estimator's filter
    #[arg(long, value_name = "SAMPLES", default_value_t = 1)]
    difference_over: usize,
    /// A hand on the tip: its mass (kg), damping (N s/m) and stiffness (N/m), the same in every direction
    #[arg(long, value_name = "M,B,K", allow_hyphen_values = true)]
    hand: Option<Numbers>,
    /// Control of a redundant device's posture, as a scene's [posture]: its stiffness (N m/rad) and damping (N m s/rad)
    #[arg(long, value_name = "K,D", allow_hyphen_values = true)]
    posture: Option<Numbers>,
    /// Leave the joints' own viscous damping out
    #[arg(long)]
    undamped: bool,
    /// Evaluate the boundary at these dampings only, in N s/m [default: 200 at equal intervals]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    kd: Option<Numbers>,
    /// Also analyse the feed-forward behind a washout at this frequency, in Hz
    #[arg(long, value_name = "HZ")]
    washout: Option<f64>,
    /// Let the feed-forward also compensate the joints' own damping
    #[arg(long)]
    damping_compensation: bool,
    /// Gain of the feed-forward (4); it must stay below the pole of the inertia, which the board enforces
    #[arg(long, value_name = "ALPHA", default_value_t = 1.0)]
    feed_forward_gain: f64,
    #[command(flatten)]
    holding: HoldingArgs,
    /// Drive of the motors: ideal (torque at once), voltage (resistance, inductance and back-EMF of the device file's
    /// motors), current (a current loop of --current-bandwidth) [default: ideal]
    #[arg(long, value_name = "KIND", conflicts_with = "board")]
    drive: Option<DriveKind>,
    /// Use the drive and the delay of this board, instead of an ideal drive without delay
    #[arg(long, value_name = "BOARD", value_parser = arguments::board_parser())]
    board: Option<BoardKind>,
    /// Bandwidth of the current loop in Hz, for --drive current; the default lags by half a carrier period at 20 kHz,
    /// as the boards' loops do, which reach a current within one period
    #[arg(long, value_name = "HZ", default_value_t = CURRENT_LOOP_HZ)]
    current_bandwidth: f64,
    /// Also analyse the wall as a program on a computer renders it over this board, with this number of exchanges a
    /// second
    #[arg(long, value_name = "HZ")]
    host_rate: Option<f64>,
    /// With --host-rate: age of the program's forces when they begin to act, in seconds, as `haptic board latency`
    /// measures it [default: the time between two requests]
    #[arg(long, value_name = "S", requires = "host_rate", allow_hyphen_values = true)]
    host_delay: Option<f64>,
    /// Print the limiting effects: how much sampling, delay, drive, filter, transmissions, hand and joint damping each
    /// reduce the boundary, by comparison with the same loop without the effect; --svg and --png then draw them
    #[arg(long)]
    why: bool,
    /// Also simulate the ripple that encoder steps cause in a wall pressed with 3 N, and print the stiffness from which
    /// on its root mean square exceeds this bound, in N. Damping is that of --damping-ratio, or each of --kd; the hand
    /// is that of --hand, or a light one (0.05 kg, 3 N s/m, 200 N/m)
    #[arg(long, value_name = "N")]
    ripple: Option<f64>,
    /// Simulate the ripple of one wall of this stiffness (N/m) and damping (N s/m)
    #[arg(long, value_name = "KP,KD", allow_hyphen_values = true)]
    wall: Option<Numbers>,
    /// Damping of the walls of --ripple, as a share of the critical damping of the inertia that they meet
    #[arg(long, value_name = "RATIO", default_value_t = 0.7)]
    damping_ratio: f64,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum DriveKind {
    Ideal,
    Voltage,
    Current,
}

impl Args {
    /// Returns the delay in control samples.
    fn delay(&self, description: &Description) -> f64 {
        match self.board.and_then(|_| Subject::new(description).ok()) {
            // Both boards sample at the middle of a carrier period and apply the duty at its end.
            Some(subject) => subject.torque_path(self.rate).delay_samples,
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

    /// Returns the device in the requested loop.
    fn prediction(&self, file: &DeviceFile) -> Result<Prediction, Failure> {
        let drive = match self.drive() {
            DriveKind::Ideal => Drive::Ideal,
            DriveKind::Current => Drive::Current { bandwidth_hz: self.current_bandwidth },
            DriveKind::Voltage => Drive::Voltage(motors(&file.description).ok_or_else(|| {
                Failure::wrong(format!("{} has joints without [joint.motor]", self.at.device.display()))
                    .remedy("a voltage drive is analysed with the motors' resistance and back-EMF: add them")
            })?),
        };
        let path = TorquePath { delay_samples: self.delay(&file.description), drive };
        let mut control_loop = Loop::with_torque_path(&path, self.rate, requested_estimator(self)?);
        control_loop.damping_compensation = self.damping_compensation;
        let subject = Subject::new(&file.description).map_err(Failure::wrong)?;
        let subject = if self.undamped { subject.undamped() } else { subject };
        Ok(Prediction {
            admissible: self.holding.admissible,
            gain: self.feed_forward_gain,
            posture: requested_posture(self.posture.as_ref(), file)?,
            hand: self.hand()?,
            ..Prediction::new(subject, control_loop)
        })
    }
}

/// Returns the posture of --posture, for a redundant device.
pub(super) fn requested_posture(numbers: Option<&Numbers>, file: &DeviceFile) -> Result<Option<Posture>, Failure> {
    let Some(numbers) = numbers else { return Ok(None) };
    let remedy = "write stiffness (N m/rad) and damping (N m s/rad), such as 0.5,0.03";
    let spec = file.spec();
    match numbers.0[..] {
        _ if spec.joints == spec.task => {
            let reason = format!("--posture does not apply: a {} is not redundant", spec.name);
            Err(Failure::wrong(reason).remedy("leave it out"))
        }
        [stiffness, damping] if stiffness >= 0.0 && damping >= 0.0 => Ok(Some(Posture { stiffness, damping })),
        [_, _] => Err(Failure::wrong("--posture holds a negative number").remedy(remedy)),
        _ => {
            let numbers = counted(numbers.0.len(), "number");
            Err(Failure::wrong(format!("--posture has {numbers}, and a posture has 2")).remedy(remedy))
        }
    }
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let (file, mut warnings) = arguments::load_device(&args.at.device, true)?;
    let spec = file.spec();
    arguments::check_rate(args.rate)?;
    let q = args.at.pose(&file)?;
    warnings.extend(arguments::pose_warnings(&q, &file));
    let members = args.walls.members(spec.task)?;
    let normals: Vec<Vec<f64>> = members.iter().map(|member| member.normal.clone()).collect();
    if let Some(board) = args.board.filter(|board| board.axes() < spec.joints) {
        let reason = format!("{} has {} joints, and this board drives {}", file.name, spec.joints, board.axes());
        let remedy = match BoardKind::with_axes(spec.joints) {
            Some(larger) => format!("choose --board {}, which drives {}", larger.name(), larger.axes()),
            None => "leave --board out, because no board drives as many joints".to_string(),
        };
        return Err(Failure::wrong(reason).remedy(remedy));
    }
    let prediction = args.prediction(&file)?;
    let (analyse, passivity) = wall_analysis(&args, &file, &q, &members, &prediction)?;
    let requested_kd = args.kd.as_ref().map(|kd| kd.0.as_slice());
    let range = analyse(requested_kd, args.washout)?;
    let costs = costly_warnings(&range, args.washout, |corner| analyse(requested_kd, Some(corner)))?;
    warnings.extend(costs.into_iter().map(|text| FileWarning { key: None, text }.for_command_line()));
    warn(&warnings);
    let requested = (&args.ripple, &args.kd, args.washout, args.damping_ratio, &args.hand);
    let device = (file.description, args.undamped, args.feed_forward_gain, args.holding.admissible);
    let question =
        format!("{device:?} {q:?} {normals:?} {:?} {:?} {requested:?}", prediction.around, prediction.posture);
    let sweep = args.continued.sweep("range", &question)?;
    let why = if args.why { Some(limiting_effects(&prediction, &q, &normals, &sweep)?) } else { None };
    let ripple = simulate_ripple(&args, &file, &q, &normals, &prediction, &sweep)?;
    let has_picture = args.pictures.is_requested();
    if let Some(why) = why.as_ref().filter(|_| has_picture) {
        let under = subtitle(&args, &device.0, &q, &normals, range.area_ratio);
        let title = format!("{}: reduction of the stiffest wall by each effect", file.name);
        let picture = haptic_show::plot::why::draw(&title, &under, why, args.pictures.paper());
        args.pictures.save(&picture)?;
    } else if has_picture {
        // Draws the complete boundary even if single points were requested.
        let complete = if args.kd.is_some() { analyse(None, args.washout)? } else { range.clone() };
        let picture = draw(&Contents {
            title: match &complete.host {
                Some(host) => format!(
                    "{}: {:.0} times as stiff as from a computer at {:.0} Hz",
                    file.name,
                    complete.off.top.kp / host.domain.top.kp.max(f64::MIN_POSITIVE),
                    host.rate_hz
                ),
                None => format!("{}: stable walls, predicted", file.name),
            },
            subtitle: subtitle(&args, &device.0, &q, &normals, range.area_ratio),
            range: &complete,
            passivity: passivity.as_ref(),
            washout_hz: args.washout,
            measured: String::new(),
            measured_off: &[],
            measured_full: &[],
            note: None,
            paper: args.pictures.paper(),
        });
        args.pictures.save(&picture)?;
    }
    let mut words = readable(&file.name, &args, &q, &normals, &range, passivity.as_ref(), &device.0);
    words.extend(why.as_ref().map(describe_why));
    words.extend(ripple.as_ref().map(EncoderRipple::describe));
    let request = Request::of(&args, &prediction, &q, &members);
    let passive = passivity.as_ref().map(PassiveBounds::of);
    let result = Document { request, range: &range, passive, why: why.as_ref(), ripple: ripple.as_ref() };
    args.json.answer(WithWarnings { result: &result, warnings: &warnings }, &words)?;
    sweep.finish();
    Ok(())
}

#[derive(serde::Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    request: Request,
    #[serde(flatten)]
    range: &'a Range,
    /// Passivity bounds; `None` with several walls, or if [`Passivity::new`] returns `None`.
    #[serde(skip_serializing_if = "Option::is_none")]
    passive: Option<PassiveBounds>,
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<&'a EffectShares>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ripple: Option<&'a EncoderRipple>,
}

/// Bounds below which a wall without feed-forward is passive.
#[derive(serde::Serialize)]
struct PassiveBounds {
    /// Stiffness without damping, N/m.
    kp: f64,
    /// Damping, N s/m.
    kd: f64,
    /// Stiffness with quantisation and friction, N/m; `None` without encoders.
    #[serde(skip_serializing_if = "Option::is_none")]
    kp_quantised: Option<f64>,
}

impl PassiveBounds {
    fn of(passivity: &Passivity) -> Self {
        Self {
            kp: passivity.largest_stiffness(0.0),
            kd: passivity.largest_damping(),
            kp_quantised: passivity.largest_undamped_stiffness(),
        }
    }
}

/// The inputs of the prediction, so that a program can repeat the prediction.
#[derive(serde::Serialize)]
struct Request {
    /// Joint angles, rad.
    q: Vec<f64>,
    /// Unit normals, d entries each.
    normals: Vec<Vec<f64>>,
    rate_hz: f64,
    /// Cutoff of the velocity filter, Hz; `None` for an estimator without a cutoff.
    cutoff_hz: Option<f64>,
    delay_samples: f64,
    drive: String,
    /// Options with which `haptic range DEVICE` repeats this prediction.
    options: String,
}

impl Request {
    fn of(args: &Args, prediction: &Prediction, q: &[f64], members: &[Member]) -> Self {
        let mut options = prediction.options(q, members);
        let mut more = |option: &str, value: Option<String>| {
            if let Some(value) = value {
                options += &format!(" --{option} {value}");
            }
        };
        more("washout", args.washout.map(|hz| hz.to_string()));
        more("kd", args.kd.as_ref().map(Numbers::to_string));
        more("host-rate", args.host_rate.map(|hz| hz.to_string()));
        more("host-delay", args.host_delay.map(|s| s.to_string()));
        if args.undamped {
            options += " --undamped";
        }
        let control_loop = &prediction.around;
        Self {
            q: q.to_vec(),
            normals: members.iter().map(|wall| wall.normal.clone()).collect(),
            rate_hz: control_loop.rate_hz,
            cutoff_hz: control_loop.estimator.cutoff_hz(),
            delay_samples: control_loop.delay_samples,
            drive: format!("{:?}", args.drive()).to_lowercase(),
            options,
        }
    }
}

/// Computes the effect of each part of the loop on the boundary of one wall; several walls are an error.
fn limiting_effects(
    prediction: &Prediction,
    q: &[f64],
    normals: &[Vec<f64>],
    sweep: &Sweep,
) -> Result<EffectShares, Failure> {
    let [normal] = normals else {
        let reason = "--why applies to one wall, and there are several --normal";
        return Err(Failure::wrong(reason).remedy("give one --normal"));
    };
    explain_boundary(&prediction.linearise(q, normal)?, &prediction.around, sweep)
}

fn requested_estimator(args: &Args) -> Result<LinearEstimator, Failure> {
    let over = args.difference_over;
    let alone = LinearEstimator::of(args.estimator, args.cutoff).ok_or_else(|| {
        Failure::wrong(format!("{} has no linear analysis", args.estimator.name())).remedy("choose another --estimator")
    })?;
    match over {
        1 => Ok(alone),
        _ if alone.takes_difference() => Ok(alone.with_window(over)),
        _ => {
            let reason = format!("--difference-over {over} does not apply to an estimator without a difference");
            Err(Failure::wrong(reason).remedy("leave it out, or choose a low-pass with --estimator"))
        }
    }
}

/// Function that predicts the range at given dampings and at a given washout corner, Hz.
type Analysis<'a> = Box<dyn Fn(Option<&[f64]>, Option<f64>) -> Result<Range, AnalysisError> + 'a>;

/// Returns the analysis of one wall, with its passive limits, or of several walls.
fn wall_analysis<'a>(
    args: &'a Args,
    file: &DeviceFile,
    q: &[f64],
    members: &[Member],
    prediction: &'a Prediction,
) -> Result<(Analysis<'a>, Option<Passivity>), Failure> {
    let (gain, control_loop) = (args.feed_forward_gain, &prediction.around);
    let model = prediction.walls(q, members)?;
    let passivity = match &model {
        Walls::One(device) => {
            let max = device.largest_gain().unwrap_or(1.0);
            if !(0.0..=max).contains(&gain) {
                let reason = format!("--feed-forward-gain {gain} is not between 0 and {max:.3}");
                return Err(Failure::wrong(reason)
                    .remedy("lower it: a board allows no more here, because of the pole of the inertia"));
            }
            Passivity::new(device, &file.description, control_loop)
        }
        Walls::Several(_) if args.host_rate.is_some() => {
            let reason = "--host-rate applies to one wall, and there are several --normal";
            return Err(Failure::wrong(reason).remedy("give one --normal with --host-rate"));
        }
        Walls::Several(_) if gain != 1.0 => {
            let reason = format!("--feed-forward-gain {gain} applies to one wall, and there are several --normal");
            return Err(Failure::wrong(reason).remedy("several walls are analysed with a gain of 1; leave it out"));
        }
        Walls::Several(_) => None,
    };
    let analyse = move |kd: Option<&[f64]>, washout: Option<f64>| {
        let host = match (args.host(), &model) {
            (Some(host), Walls::One(device)) => Some(host.domain(device, control_loop, kd)?),
            _ => None,
        };
        Ok(Range { host, ..model.range(control_loop, kd, washout)? })
    };
    Ok((Box::new(analyse), passivity))
}
