//! `haptic design`: where, in which direction and with which links and posture a device renders walls best.

use super::answer::{Json, Pictures};
use super::arguments::{self, DeviceAt, Holding, Numbers};
use super::continued::Continue;
use haptic_bridge::render::scene::DEFAULT_RATE_HZ;
use haptic_host::error::Failure;
use haptic_host::words::percent;
use haptic_predict::design::place::{Directions, Placed, Places, directions, places};
use haptic_predict::design::posture::{Posture, Postures, postures};
use haptic_predict::design::sensitivity::{Buys, CHANGE, Effect, Sensitivity, buys_most, sensitivities};
use haptic_predict::design::{Stiffest, singular};
use haptic_predict::plausible::{Warned, warn};
use haptic_show::plot::coupling::draw;
use haptic_stability::analysis::control_loop::{Loop, TorquePath};
use haptic_stability::analysis::estimator::LinearEstimator;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::{BoundaryPoint, WORTHWHILE_RATIO};
use haptic_stability::analysis::several::Member;
use serde::Serialize;
use std::fmt::Write;

/// Find where, in which direction and with which links a device renders walls best
///
/// At one pose: the directions of the stiffest and the softest wall, and the one in which the feed-forward buys most.
/// Over the workspace: the best places of a wall, of one with the normal that is given, and of a surface that turns
/// every way. What a tenth more or less of each length, mass, inertia, rotor and gear ratio does to the wall at the
/// pose, and a counterweight. On a redundant arm: the best posture at the same tip position. Places and postures are
/// searched by the inertia that a wall meets; the stiffest walls beside them, and what each change does to them, are
/// predicted as `haptic range` does, with joint damping, transmissions and a board's delay and drive. --svg draws the device with its motion
/// along the normal, and its coupling over all directions.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    at: DeviceAt,
    /// Normal of the wall, any length [default: that in which the feed-forward buys most at the pose]
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Option<Numbers>,
    /// Half the width of the wall that is placed, in m
    #[arg(long, value_name = "M", default_value_t = 0.01)]
    patch: f64,
    /// Smallest allowed sine of the angle to a singular pose, towards which inertia grows without bound
    #[arg(long, value_name = "SINE", default_value_t = 0.3)]
    clear: f64,
    /// Poses of the joint grid, before those that cannot be reached are left out
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    points: u32,
    /// Control rate in Hz of the walls that are predicted
    #[arg(long, value_name = "HZ", default_value_t = DEFAULT_RATE_HZ)]
    rate: f64,
    /// Cutoff in Hz of their velocity filter
    #[arg(long, value_name = "HZ", default_value_t = 500.0)]
    cutoff: f64,
    #[command(flatten)]
    holding: Holding,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    pictures: Pictures,
}

/// The document of `--json`.
#[derive(Serialize)]
struct Document {
    device: String,
    q: Vec<f64>,
    normal: Vec<f64>,
    clear: f64,
    /// Options with which `haptic range DEVICE` predicts the walls at the pose.
    options: String,
    /// The stable area at the pose with the feed-forward over that without.
    area_ratio: f64,
    here: Placed,
    directions: Directions,
    places: Places,
    sensitivities: Vec<Sensitivity>,
    /// The change that buys most: of the stiffest wall without the feed-forward, of that with it, and of that with it
    /// for each kilogram of Weff.
    buys_most: [Option<Buys>; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    postures: Option<Postures>,
}

/// Searches, prints and draws.
pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let (file, mut warnings) = arguments::device(&args.at.device, true)?;
    let spec = file.spec();
    arguments::check_rate(args.rate)?;
    if !(0.0..1.0).contains(&args.clear) || !(0.0..=1.0).contains(&args.patch) {
        return Err(Failure::wrong("--clear is a sine from 0 to below 1, --patch a length up to 1 m"));
    }
    let q = args.at.pose(&file)?;
    warnings.extend(arguments::pose_doubts(&q, &file));
    warn(&warnings);
    let asked = args.normal.clone().map(|normal| normal.unit(spec.task, "--normal")).transpose()?;
    let description = &file.description;
    let mut directions = directions(description, &q, args.holding.admissible)?;
    let normal = asked.clone().unwrap_or_else(|| directions.feed_forward_buys_most.normal.clone());
    let question = format!(
        "{} {description:?} {q:?} {asked:?} {} {} {} {:?} {} {}",
        file.name, args.patch, args.clear, args.points, args.holding.admissible, args.rate, args.cutoff
    );
    let sweep = args.continued.sweep("design", &question)?;
    let mut places = places(
        description,
        asked.as_deref(),
        args.patch,
        args.clear,
        args.points as usize,
        args.holding.admissible,
        &sweep,
    )?;
    let (path, subject) = (TorquePath::usual(args.rate), Subject::new(description).map_err(Failure::wrong)?);
    let around = Loop::through(&path, args.rate, LinearEstimator::Butterworth(args.cutoff));
    let prediction = Prediction { admissible: args.holding.admissible, ..Prediction::new(subject, around) };
    let sensitivities = sensitivities(description, &q, &normal, args.holding.admissible, &prediction.around)?;
    let pose = TaskPose::at(description, &q)?.regular()?.holding(args.holding.admissible);
    let unit = haptic_stability::analysis::pose::unit_normal(&normal, spec.task, spec.joints)?;
    let (w_eff, w_rr) = haptic_stability::analysis::map::along(&pose, &unit).ok_or_else(singular)?;
    let mut here = Placed {
        q: q.clone(),
        position: pose.position.clone(),
        normal: normal.clone(),
        w_eff,
        w_rr,
        clearance: haptic_predict::design::clearance(&pose),
        walls: None,
    };
    let area_ratio = here.predict(&prediction)?.area_ratio;
    let Directions { stiffest, softest, feed_forward_buys_most, couples_most } = &mut directions;
    let mut found = vec![stiffest, softest, feed_forward_buys_most, couples_most];
    found.extend([&mut places.stiffest, &mut places.every_direction, &mut places.feed_forward_buys_most]);
    found.extend(places.along.iter_mut().flat_map(|along| [&mut along.off, &mut along.full, &mut along.worst]));
    for placed in found {
        placed.predict(&prediction)?;
    }
    let document = Document {
        here,
        area_ratio,
        options: prediction.options(&q, &[Member::new(normal.clone(), 1.0)]),
        postures: postures(description, &q, &normal, args.clear, args.holding.admissible)?,
        buys_most: [
            buys_most(&sensitivities, |effect| effect.off),
            buys_most(&sensitivities, |effect| effect.full),
            buys_most(&sensitivities, |effect| effect.full / effect.w_eff),
        ],
        device: file.name.clone(),
        clear: args.clear,
        q,
        normal,
        directions,
        places,
        sensitivities,
    };
    if args.pictures.asked() {
        let (q, normal, paper) = (&document.q, &document.normal, args.pictures.paper());
        let drawn = draw(description, &file.name, q, normal, args.holding.admissible, paper)?;
        let picture = drawn.ok_or_else(|| Failure::impossible("the linkage does not close at this pose"))?;
        args.pictures.save(&picture)?;
    }
    let result = Warned { result: &document, warnings: &warnings };
    args.json.answer(result, &readable(&document, asked.is_some(), &args))?;
    sweep.finish();
    Ok(())
}

fn list(values: &[f64]) -> String {
    // A number that rounds to zero has no sign.
    values.iter().map(|v| format!("{:.3}", (1e3 * v).round() / 1e3 + 0.0)).collect::<Vec<_>>().join(", ")
}

fn readable(document: &Document, asked: bool, args: &Args) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    line(format!("{}: q = ({}) rad, n = ({})", document.device, list(&document.q), list(&document.normal)));
    line(format!(
        "  the stiffest walls as predicted by haptic range {} {}",
        args.at.device.display(),
        document.options
    ));
    let gives = document.here.walls.is_some_and(|walls| walls.off.felt.is_some());
    if gives {
        line("  felt: at the tip, behind the transmissions".into());
    }
    let wall = |name: &str, at: &Placed| {
        let stiffest = |pick: fn(&Stiffest) -> BoundaryPoint| {
            let point = at.walls.as_ref().map(pick);
            let felt = point.and_then(|point| point.felt).map_or(String::new(), |felt| format!("{felt:>11.0}"));
            format!("{:>11.0}{felt}", point.map_or(f64::NAN, |point| point.kp))
        };
        format!(
            "  {name:<34}{:>10.4}{:>10.4}{:>8.3}{}{}  n ({})",
            at.w_eff,
            at.w_rr,
            at.w_rr / at.w_eff,
            stiffest(|walls| walls.off),
            stiffest(|walls| walls.full),
            list(&at.normal)
        )
    };
    let felt = if gives { format!("{:>11}", "felt N/m") } else { String::new() };
    let placed = |name: &str, at: &Placed| {
        format!("{}  q ({}), tip ({}) m, sine {:.2}", wall(name, at), list(&at.q), list(&at.position), at.clearance)
    };
    line(format!(
        "\n  {:<34}{:>10}{:>10}{:>8}{:>11}{felt}{:>11}{felt}",
        "at this pose", "Weff kg", "Wrr kg", "ratio", "off N/m", "full N/m"
    ));
    line(wall("along n", &document.here));
    line(wall("stiffest direction", &document.directions.stiffest));
    line(wall("softest direction", &document.directions.softest));
    line(wall("where the feed-forward buys most", &document.directions.feed_forward_buys_most));
    line(wall("where it couples most", &document.directions.couples_most));
    let places = &document.places;
    line(format!(
        "\n  over the workspace, in home's working mode: {} poses with a sine of {} and more, and between them",
        places.poses, document.clear
    ));
    line(placed("stiffest wall", &places.stiffest));
    line(placed("any direction: stiffest softest", &places.every_direction));
    line(placed("where the feed-forward buys most", &places.feed_forward_buys_most));
    if let Some(along) = &places.along {
        line(format!(
            "  a wall {:.0} mm wide with this normal, by what it meets at its worst point; N/m in its middle",
            2e3 * along.patch
        ));
        line(placed("best without the feed-forward", &along.off));
        line(placed("best with it", &along.full));
        line(placed("worst without it", &along.worst));
    }
    line(format!(
        "\n  what {:.0} % more and less of each does to the stiffest wall along n, the tip where it is",
        100.0 * CHANGE
    ));
    line(format!(
        "  {:<46}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}{:>9}{:>9}",
        "", "off +", "full +", "Weff +", "Wrr +", "force +", "count +", "off -", "full -"
    ));
    let percent = |value: Option<f64>| value.map_or("-".into(), |value| percent(value - 1.0, 2, true));
    for one in &document.sensitivities {
        let of = |effect: &Option<Effect>, pick: fn(&Effect) -> Option<f64>| percent(effect.as_ref().and_then(pick));
        line(format!(
            "  {:<46}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}{:>9}{:>9}",
            one.part,
            of(&one.more, |e| Some(e.off)),
            of(&one.more, |e| Some(e.full)),
            of(&one.more, |e| Some(e.w_eff)),
            of(&one.more, |e| Some(e.w_rr)),
            of(&one.more, |e| e.force),
            of(&one.more, |e| e.count),
            of(&one.less, |e| Some(e.off)),
            of(&one.less, |e| Some(e.full))
        ));
    }
    for (what, buys) in [
        "the stiffest wall without the feed-forward",
        "the stiffest wall with it",
        "a stiffer wall with it at the same inertia felt without",
    ]
    .iter()
    .zip(&document.buys_most)
    {
        let Some(buys) = buys else {
            line(format!("  no change of {:.0} % buys 1 % of {what}", 100.0 * CHANGE));
            continue;
        };
        let by = if buys.more { "more" } else { "less" };
        line(format!(
            "  buys most of {what}: {by} {} (off {}, full {}, Weff {})",
            buys.part,
            percent(Some(buys.effect.off)),
            percent(Some(buys.effect.full)),
            percent(Some(buys.effect.w_eff))
        ));
    }
    if let Some(found) = &document.postures {
        line(format!(
            "\n  postures with the tip where it is: {} by null motion, with a sine of {} and more",
            found.postures, document.clear
        ));
        let posture = |name: &str, at: &Posture| {
            format!(
                "  {name:<34}{:>10.4}{:>10.4}{:>8.3}  q ({}), sine {:.2}",
                at.w_eff,
                at.w_rr,
                at.w_rr / at.w_eff,
                list(&at.q),
                at.clearance
            )
        };
        line(posture("as it stands", &found.here));
        line(posture("largest Weff", &found.heaviest));
        line(posture("smallest Weff", &found.lightest));
        line(posture("largest Wrr", &found.most_held));
        line(posture("smallest Wrr", &found.least_held));
        line(format!(
            "  the posture makes Weff up to {:.2} times as large, Wrr up to {:.2} times",
            found.heaviest.w_eff / found.lightest.w_eff,
            found.most_held.w_rr / found.least_held.w_rr
        ));
        line(format!(
            "  a scene holds one with a [posture] table: orientation = {:.3} for the largest Weff, {:.3} for the largest Wrr",
            found.heaviest.orientation, found.most_held.orientation
        ));
    }
    let gain = document.area_ratio;
    line(String::new());
    line(match gain >= WORTHWHILE_RATIO {
        true => format!("Along n the feed-forward makes the stable area {gain:.2} times as large."),
        false => "Along n the feed-forward buys next to nothing.".into(),
    });
    if !asked {
        line("With --normal also the best place of a wall with that normal.".into());
    }
    text
}
