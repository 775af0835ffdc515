//! `haptic tune estimators`: compares velocity estimators on a device, by simulation with its encoder steps.

use super::answer::Json;
use super::arguments::{self, DeviceAt, Numbers};
use super::continued::Continue;
use haptic_bridge::render::scene::DEFAULT_RATE_HZ;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_predict::bench::estimators::{Comparison, RESOLUTION_N, Row, compare, comparison_wall};
use haptic_stability::analysis::control_loop::Loop;
use haptic_stability::analysis::estimator::LinearEstimator;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::several::Member;
use serde_json::json;
use std::fmt::Write;

/// Compare velocity estimators on a device, by simulation with its encoder steps
///
/// Prints for each estimator the area of walls (stiffness over damping) that come to rest; the ripple of a wall's force
/// under a hand that presses with growing force, without and with the feed-forward (4), and under a hand at rest; the
/// delay and the noise of the velocity. Estimators with at least the Butterworth's area come first, ordered by their
/// ripple under the growing force: a hand at rest is no test, because friction may hold the tip between two counts.
/// Takes a minute. Put the word of the first column into a scene file as `estimator`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    at: DeviceAt,
    /// Normal of the wall, of any length
    #[arg(long, value_name = "X,Y,..", required = true, allow_hyphen_values = true)]
    normal: Numbers,
    /// Control rate in Hz
    #[arg(long, value_name = "HZ", default_value_t = DEFAULT_RATE_HZ)]
    rate: f64,
    /// Cutoff in Hz [default: 500, or a tenth of the rate if that is less]
    #[arg(long, value_name = "HZ")]
    cutoff: Option<f64>,
    /// Stiffness and damping of the pressed wall, in N/m and N s/m [default: a quarter and half of the range that
    /// `range --board` predicts stable with the Butterworth]
    #[arg(long, value_name = "KP,KD")]
    wall: Option<Numbers>,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    json: Json,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let file = DeviceFile::load(&args.at.device)?;
    let spec = file.spec();
    arguments::check_rate(args.rate)?;
    let q = args.at.pose(&file)?;
    let normal = args.normal.unit(spec.task, "--normal")?;
    let cutoff = args.cutoff.unwrap_or((0.1 * args.rate).min(500.0));
    let wall = match args.wall {
        Some(wall) => {
            let wall = wall.exactly(2, "--wall", "numbers, stiffness and damping")?;
            if wall.iter().any(|gain| *gain < 0.0) {
                return Err(
                    Failure::wrong("--wall has a negative number").remedy("write stiffness and damping, 0 or more")
                );
            }
            (wall[0], wall[1])
        }
        None => comparison_wall(&file, &q, &normal, args.rate, cutoff)?,
    };
    let comparison = Comparison { file: &file, q: &q, normal: &normal, rate_hz: args.rate, cutoff_hz: cutoff, wall };
    let question = format!("{:?} {q:?} {normal:?} {} {cutoff} {wall:?}", file.description, args.rate);
    let sweep = args.continued.sweep("estimators", &question)?.in_lines();
    let rows = compare(&comparison, &sweep)?;
    let subject = Subject::new(&file.description).map_err(Failure::wrong)?;
    let path = subject.torque_path(args.rate);
    let control_loop = Loop::with_torque_path(&path, args.rate, LinearEstimator::Butterworth(cutoff));
    let options = Prediction::new(subject, control_loop).options(&q, &[Member::new(normal.clone(), 1.0)]);
    let document = json!({
        "device": file.name, "options": options, "q": q, "normal": normal, "rate_hz": args.rate, "cutoff_hz": cutoff,
        "wall": { "stiffness": wall.0, "damping": wall.1 }, "estimators": rows,
    });
    args.json.answer(document, &readable(&comparison, &rows))?;
    sweep.finish();
    Ok(())
}

fn readable(comparison: &Comparison<'_>, rows: &[Row]) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}: control at {} Hz; ripple on a wall of {:.0} N/m and {:.1} N s/m under a hand that presses with 3 N growing by 1 N/s, and at rest\n",
        comparison.file.name, comparison.rate_hz, comparison.wall.0, comparison.wall.1
    );
    let _ = writeln!(
        text,
        "  {:<22}{:>8}{:>11}{:>14}{:>9}{:>12}{:>10}{:>10}{:>12}",
        "estimator",
        "value",
        "cutoff Hz",
        "area N²s/m²",
        "press N",
        "with (4) N",
        "at rest N",
        "delay ms",
        "noise mm/s"
    );
    for row in rows {
        let newtons = |ripple: f64| format!("{ripple:.4}");
        let or_none = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        let _ = writeln!(
            text,
            "  {:<22}{:>8}{:>11}{:>14.3e}{:>9}{:>12}{:>10}{:>10.3}{:>12.2}{}",
            row.estimator,
            or_none(row.value.map(|value| value.to_string())),
            or_none(row.cutoff_hz.map(|hz| format!("{hz:.1}"))),
            row.area,
            or_none(row.press_n[0].map(newtons)),
            or_none(row.press_n[1].map(newtons)),
            or_none(row.ripple_n.map(newtons)),
            1e3 * row.delay_s,
            1e3 * row.noise_m_s,
            if row.holds { "" } else { "  does not hold the hand" }
        );
    }
    if rows.iter().all(|row| row.press_n[0].is_some_and(|press| press < RESOLUTION_N)) {
        let _ = writeln!(
            text,
            "  every ripple is below {RESOLUTION_N} N, so this wall cannot rank them: choose a stiffer wall with more damping with --wall"
        );
    }
    text
}
