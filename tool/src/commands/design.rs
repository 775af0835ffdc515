//! `haptic design`: finds the place, direction, links and posture with which a device renders walls best.

use super::answer::{Json, Pictures};
use super::arguments::{self, DeviceAt, HoldingArgs, Numbers};
use super::continued::Continue;
use haptic_bridge::model::description::Description;
use haptic_bridge::render::scene::DEFAULT_RATE_HZ;
use haptic_host::error::Failure;
use haptic_host::words::{joint_units, percent};
use haptic_predict::design::place::{Directions, Places, WallPlace, directions, places};
use haptic_predict::design::posture::{Posture, Postures, postures};
use haptic_predict::design::sensitivity::{BestChange, CHANGE, Effect, Sensitivity, buys_most, sensitivities};
use haptic_predict::design::{StiffestWalls, singular_pose};
use haptic_predict::plausible::{WithWarnings, warn};
use haptic_show::plot::coupling::draw;
use haptic_stability::analysis::control_loop::Loop;
use haptic_stability::analysis::estimator::LinearEstimator;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::{BoundaryPoint, WORTHWHILE_RATIO};
use haptic_stability::analysis::several::Member;
use serde::Serialize;
use std::fmt::Write;

/// Find the place, direction and links with which a device renders walls best
///
/// At one pose: the directions of the stiffest and the softest wall, and the direction in which the feed-forward has
/// the largest benefit. Over the workspace: the best places of a wall, of a wall with the given normal, and of a
/// surface with all directions. Also the effect of a tenth more or less of each length, mass, inertia, rotor and gear
/// ratio, and of a counterweight, on the wall at the pose. On a redundant arm: the best posture at the same tip
/// position. Places and postures are searched by the inertia that a wall meets; the stiffest walls there, and the
/// effects of changes, are predicted as `haptic range` does, with joint damping, transmissions and a board's delay and
/// drive. --svg draws the device with its motion along the normal, and its coupling over all directions.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    at: DeviceAt,
    /// Normal of the wall, of any length [default: the direction with the largest benefit of the feed-forward at the
    /// pose]
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Option<Numbers>,
    /// Half the width of the wall to place, in m
    #[arg(long, value_name = "M", default_value_t = 0.01)]
    patch: f64,
    /// Smallest allowed sine of the angle to a singular pose, towards which inertia grows without bound
    #[arg(long, value_name = "SINE", default_value_t = 0.3)]
    clear: f64,
    /// Poses of the joint grid, before unreachable poses are left out
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    points: u32,
    /// Control rate of the predicted walls, in Hz
    #[arg(long, value_name = "HZ", default_value_t = DEFAULT_RATE_HZ)]
    rate: f64,
    /// Cutoff of the predicted walls' velocity filter, in Hz
    #[arg(long, value_name = "HZ", default_value_t = 500.0)]
    cutoff: f64,
    #[command(flatten)]
    holding: HoldingArgs,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(Serialize)]
struct Document {
    device: String,
    q: Vec<f64>,
    normal: Vec<f64>,
    clear: f64,
    /// Options with which `haptic range DEVICE` predicts the walls at the pose.
    options: String,
    /// Stable area at the pose with the feed-forward, relative to the area without it.
    area_ratio: f64,
    here: WallPlace,
    directions: Directions,
    places: Places,
    sensitivities: Vec<Sensitivity>,
    /// Changes with the largest benefit for three quantities: the stiffest wall without the feed-forward, the stiffest
    /// wall with it, and the stiffest wall with it per kilogram of Weff.
    buys_most: [Option<BestChange>; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    postures: Option<Postures>,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let (file, mut warnings) = arguments::load_device(&args.at.device, true)?;
    let spec = file.spec();
    arguments::check_rate(args.rate)?;
    if !(0.0..1.0).contains(&args.clear) || !(0.0..=1.0).contains(&args.patch) {
        return Err(Failure::wrong(
            "--clear must be a sine of at least 0 and less than 1, and --patch a length of at most 1 m",
        ));
    }
    let q = args.at.pose(&file)?;
    warnings.extend(arguments::pose_warnings(&q, &file));
    warn(&warnings);
    let requested = args.normal.clone().map(|normal| normal.unit(spec.task, "--normal")).transpose()?;
    let description = &file.description;
    let mut directions = directions(description, &q, args.holding.admissible)?;
    let normal = requested.clone().unwrap_or_else(|| directions.feed_forward_buys_most.normal.clone());
    let question = format!(
        "{} {description:?} {q:?} {requested:?} {} {} {} {:?} {} {}",
        file.name, args.patch, args.clear, args.points, args.holding.admissible, args.rate, args.cutoff
    );
    let sweep = args.continued.sweep("design", &question)?;
    let mut places = places(
        description,
        requested.as_deref(),
        args.patch,
        args.clear,
        args.points as usize,
        args.holding.admissible,
        &sweep,
    )?;
    let subject = Subject::new(description).map_err(Failure::wrong)?;
    let path = subject.torque_path(args.rate);
    let control_loop = Loop::with_torque_path(&path, args.rate, LinearEstimator::Butterworth(args.cutoff));
    let prediction = Prediction { admissible: args.holding.admissible, ..Prediction::new(subject, control_loop) };
    let sensitivities = sensitivities(description, &q, &normal, args.holding.admissible, &prediction.around)?;
    let pose = TaskPose::at(description, &q)?.regular()?.holding(args.holding.admissible);
    let unit = haptic_stability::analysis::pose::unit_normal(&normal, spec.task, spec.joints)?;
    let (w_eff, w_rr) = haptic_stability::analysis::map::effective_inertias(&pose, &unit).ok_or_else(singular_pose)?;
    let mut here = WallPlace {
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
    let mut placements = vec![stiffest, softest, feed_forward_buys_most, couples_most];
    placements.extend([&mut places.stiffest, &mut places.every_direction, &mut places.feed_forward_buys_most]);
    placements.extend(places.along.iter_mut().flat_map(|along| [&mut along.off, &mut along.full, &mut along.worst]));
    for placed in placements {
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
    if args.pictures.is_requested() {
        let (q, normal, paper) = (&document.q, &document.normal, args.pictures.paper());
        let drawn = draw(description, &file.name, q, normal, args.holding.admissible, paper)?;
        let picture = drawn.ok_or_else(|| Failure::impossible("the linkage does not close at this pose"))?;
        args.pictures.save(&picture)?;
    }
    let result = WithWarnings { result: &document, warnings: &warnings };
    args.json.answer(result, &readable(&document, &file.description, requested.is_some(), &args))?;
    sweep.finish();
    Ok(())
}

fn join(values: &[f64]) -> String {
    // Removes the sign of a number that rounds to zero.
    values.iter().map(|v| format!("{:.3}", (1e3 * v).round() / 1e3 + 0.0)).collect::<Vec<_>>().join(", ")
}

fn readable(document: &Document, description: &Description, has_normal: bool, args: &Args) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    let unit = joint_units(&description.units(), |joint| joint.travel);
    line(format!("{}: q = ({}) {unit}, n = ({})", document.device, join(&document.q), join(&document.normal)));
    line(format!(
        "  the stiffest walls as predicted by haptic range {} {}",
        args.at.device.display(),
        document.options
    ));
    let is_compliant = document.here.walls.is_some_and(|walls| walls.off.felt.is_some());
    if is_compliant {
        line("  felt: at the tip, behind the transmissions".into());
    }
    let wall = |name: &str, at: &WallPlace| {
        let stiffest = |pick: fn(&StiffestWalls) -> BoundaryPoint| {
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
            join(&at.normal)
        )
    };
    let felt = if is_compliant { format!("{:>11}", "felt N/m") } else { String::new() };
    let placed = |name: &str, at: &WallPlace| {
        format!("{}  q ({}), tip ({}) m, sine {:.2}", wall(name, at), join(&at.q), join(&at.position), at.clearance)
    };
    line(format!(
        "\n  {:<34}{:>10}{:>10}{:>8}{:>11}{felt}{:>11}{felt}",
        "at this pose", "Weff kg", "Wrr kg", "ratio", "off N/m", "full N/m"
    ));
    line(wall("along n", &document.here));
    line(wall("stiffest direction", &document.directions.stiffest));
    line(wall("softest direction", &document.directions.softest));
    line(wall("largest benefit of feed-forward", &document.directions.feed_forward_buys_most));
    line(wall("largest coupling", &document.directions.couples_most));
    let places = &document.places;
    line(format!(
        "\n  over the workspace, in home's working mode: {} poses with a sine of {} or more, and between them",
        places.poses, document.clear
    ));
    line(placed("stiffest wall", &places.stiffest));
    line(placed("stiffest in its softest direction", &places.every_direction));
    line(placed("largest benefit of feed-forward", &places.feed_forward_buys_most));
    if let Some(along) = &places.along {
        line(format!(
            "  a wall {:.0} mm wide with this normal, by the inertia at its worst point; N/m at its middle",
            2e3 * along.patch
        ));
        line(placed("best without the feed-forward", &along.off));
        line(placed("best with it", &along.full));
        line(placed("worst without it", &along.worst));
    }
    line(format!(
        "\n  effect of ±{:.0} % in each number on the stiffest wall along n, at the same tip position",
        100.0 * CHANGE
    ));
    line(format!(
        "  {:<46}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}{:>9}{:>9}",
        "", "off +", "full +", "Weff +", "Wrr +", "force +", "count +", "off -", "full -"
    ));
    let percent = |value: Option<f64>| value.map_or("-".into(), |value| percent(value - 1.0, 2, true));
    for sensitivity in &document.sensitivities {
        let change =
            |effect: &Option<Effect>, pick: fn(&Effect) -> Option<f64>| percent(effect.as_ref().and_then(pick));
        line(format!(
            "  {:<46}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}{:>9}{:>9}",
            sensitivity.part,
            change(&sensitivity.more, |e| Some(e.off)),
            change(&sensitivity.more, |e| Some(e.full)),
            change(&sensitivity.more, |e| Some(e.w_eff)),
            change(&sensitivity.more, |e| Some(e.w_rr)),
            change(&sensitivity.more, |e| e.force),
            change(&sensitivity.more, |e| e.count),
            change(&sensitivity.less, |e| Some(e.off)),
            change(&sensitivity.less, |e| Some(e.full))
        ));
    }
    for (what, buys) in [
        "the stiffest wall without the feed-forward",
        "the stiffest wall with it",
        "the stiffest wall with it per kilogram of Weff",
    ]
    .iter()
    .zip(&document.buys_most)
    {
        let Some(buys) = buys else {
            line(format!("  no change of {:.0} % improves {what} by 1 %", 100.0 * CHANGE));
            continue;
        };
        let by = if buys.more { "more" } else { "less" };
        line(format!(
            "  largest improvement of {what}: {by} {} (off {}, full {}, Weff {})",
            buys.part,
            percent(Some(buys.effect.off)),
            percent(Some(buys.effect.full)),
            percent(Some(buys.effect.w_eff))
        ));
    }
    if let Some(postures) = &document.postures {
        line(format!(
            "\n  postures at the same tip position: {} by null motion, with a sine of {} or more",
            postures.postures, document.clear
        ));
        let posture = |name: &str, at: &Posture| {
            format!(
                "  {name:<34}{:>10.4}{:>10.4}{:>8.3}  q ({}), sine {:.2}",
                at.w_eff,
                at.w_rr,
                at.w_rr / at.w_eff,
                join(&at.q),
                at.clearance
            )
        };
        line(posture("as given", &postures.here));
        line(posture("largest Weff", &postures.heaviest));
        line(posture("smallest Weff", &postures.lightest));
        line(posture("largest Wrr", &postures.most_held));
        line(posture("smallest Wrr", &postures.least_held));
        line(format!(
            "  the posture makes Weff up to {:.2} times as large, Wrr up to {:.2} times",
            postures.heaviest.w_eff / postures.lightest.w_eff,
            postures.most_held.w_rr / postures.least_held.w_rr
        ));
        line(format!(
            "  a [posture] table in a scene holds a posture: orientation = {:.3} for the largest Weff, {:.3} for the largest Wrr",
            postures.heaviest.orientation, postures.most_held.orientation
        ));
    }
    let gain = document.area_ratio;
    line(String::new());
    line(match gain >= WORTHWHILE_RATIO {
        true => format!("Along n the feed-forward makes the stable area {gain:.2} times as large."),
        false => "Along n the feed-forward has almost no benefit.".into(),
    });
    if !has_normal {
        line("--normal adds the best place of a wall with that normal.".into());
    }
    text
}
