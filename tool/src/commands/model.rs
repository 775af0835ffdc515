//! `haptic model`: the inertia that a wall meets at one pose, and the feed-forward that changes it.

use super::answer::Json;
use super::arguments::{self, DeviceAt, HoldingArgs, Numbers};
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::units::JointUnits;
use haptic_host::device_file::DeviceFile;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::words::joint_units;
use haptic_predict::plausible::{WithWarnings, warn};
use haptic_stability::model::{Precision, Report, Rows, WallForce, evaluate_holding};
use std::fmt::Write;

/// Show the inertia that a wall meets at one pose, with coupling and feed-forward torque
///
/// Prints the mass matrix, the effective inertia Weff that a wall meets without the feed-forward, the inertia Wrr that
/// it meets with the feed-forward, and the joint torques of both. Give --normal and --force once per wall, and
/// --stiffness once with one number per wall: several walls share the feed-forward by their stiffness. --json then has
/// "directions", the stiffest first: along (the unit vector e_j), stiffness along it relative to the stiffest wall, and
/// share (s_R of the level that renders this direction and the stiffer ones; null if nothing is left to shape).
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    at: DeviceAt,
    /// Joint velocities in rad/s, of a slide in m/s [default: 0]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    qd: Option<Numbers>,
    /// Normal of a wall, pointing out of the solid, of any length
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Vec<Numbers>,
    /// Force of the wall along its normal, in N [default: 0]
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    force: Vec<Numbers>,
    /// Stiffness of each wall, in N/m or any other unit [default: all equal]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    stiffness: Option<Numbers>,
    /// Walls whose feed-forward is off while others have it, counted from 0 in the order of --normal
    #[arg(long, value_name = "I,J,..")]
    no_feed_forward: Option<Numbers>,
    #[command(flatten)]
    holding: HoldingArgs,
    /// Arithmetic: f64, or f32 with the mechanism and trigonometry of the board
    #[arg(long, value_name = "PRECISION", default_value = "f64", value_parser = arguments::precision_parser())]
    precision: Precision,
    #[command(flatten)]
    json: Json,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let (device, mut warnings) = arguments::load_device(&args.at.device, false)?;
    let spec = device.spec();
    let q = args.at.pose(&device)?;
    let qd = match args.qd {
        Some(qd) => qd.exactly(spec.joints, "--qd", "joint velocities")?,
        None => vec![0.0; spec.joints],
    };
    warnings.extend(arguments::pose_warnings(&q, &device));
    warn(&warnings);
    let walls =
        requested_walls(&args.normal, &args.force, args.stiffness.as_ref(), args.no_feed_forward.as_ref(), spec.task)?;
    let report = evaluate_holding(&device, &q, &qd, &walls, args.precision, args.holding.admissible)?;
    if args.json.is_requested() {
        let forces = walls.iter().map(|wall| wall.force).collect();
        let normals = walls.iter().map(|wall| wall.normal.clone()).collect();
        let (precision, admissible) = (args.precision, args.holding.admissible.name());
        let precision = Precision::ALL.iter().find(|(_, other)| *other == precision).map_or("", |(name, _)| name);
        let result = &Document { q, qd, normals, forces, precision, admissible, report: &report };
        return print_json(WithWarnings { result, warnings: &warnings });
    }
    let board = if args.precision == Precision::F32 { ", f32 as on the board" } else { "" };
    let heading = format!("{} ({}){board}\n", device.name, spec.name);
    let mut text = heading + &readable(&report, &q, &qd, &walls, &device.description.units());
    if let ([only], true) = (walls.as_slice(), spec.joints > spec.task) {
        text.push_str(&compare_holding(&device, &q, only, args.holding.admissible)?);
    }
    print(&text)
}

/// The document of `--json`: the inputs, so that the result can be computed again, and the result.
#[derive(serde::Serialize)]
struct Document<'a> {
    /// Joint angles, rad; travels of slides, m.
    q: Vec<f64>,
    /// Joint velocities, rad/s; of slides, m/s.
    qd: Vec<f64>,
    /// Unit normals of the walls, d entries each.
    normals: Vec<Vec<f64>>,
    /// Forces of the walls, N.
    forces: Vec<f64>,
    precision: &'static str,
    admissible: &'static str,
    #[serde(flatten)]
    report: &'a Report,
}

/// Describes Wrr/Weff of a redundant device for every coordinate that the device can hold.
fn compare_holding(device: &DeviceFile, q: &[f64], wall: &WallForce, chosen: Admissible) -> Result<String, Failure> {
    let mut text = format!(
        "This device is redundant: Wrr is with {} held constant. Wrr/Weff here for each coordinate held:",
        chosen.name()
    );
    for (name, admissible) in Admissible::ALL {
        let still = vec![0.0; q.len()];
        let report = evaluate_holding(device, q, &still, std::slice::from_ref(wall), Precision::F64, admissible)?;
        let _ = write!(text, " {name} {:.2}", report.gain() + 1.0);
    }
    Ok(text + ".\n")
}

/// Returns the walls of the options, with unit normals.
fn requested_walls(
    normals: &[Numbers],
    forces: &[Numbers],
    stiffness: Option<&Numbers>,
    without: Option<&Numbers>,
    task: usize,
) -> Result<Vec<WallForce>, Failure> {
    if !forces.is_empty() && forces.len() != normals.len() {
        let reason = format!("--normal is given {} times and --force {} times", normals.len(), forces.len());
        return Err(Failure::wrong(reason).remedy("give them in pairs, one pair per wall"));
    }
    let stiffness = match stiffness {
        Some(stiffness) => stiffness.per_wall(normals.len(), "--stiffness")?,
        None => vec![1.0; normals.len()],
    };
    let with = Numbers::with_feed_forward(without, normals.len(), "--no-feed-forward")?;
    normals
        .iter()
        .zip(stiffness.into_iter().zip(with))
        .enumerate()
        .map(|(index, (normal, (stiffness, feed_forward)))| {
            let normal = normal.unit(task, "--normal")?;
            let force = match forces.get(index) {
                Some(force) => force.exactly(1, "--force", "force")?[0],
                None => 0.0,
            };
            Ok(WallForce { normal, force, stiffness, feed_forward })
        })
        .collect()
}

fn readable(report: &Report, q: &[f64], qd: &[f64], walls: &[WallForce], units: &[&JointUnits]) -> String {
    let mut text = String::new();
    let [travel, speed, torque] = [
        joint_units(units, |joint| joint.travel),
        joint_units(units, |joint| joint.speed),
        joint_units(units, |joint| joint.torque),
    ];
    let mut line = |name: &str, unit: &str, value: String| {
        let mut lines = value.lines();
        let _ = writeln!(text, "  {name:<30}{:<8}{}", unit, lines.next().unwrap_or("none"));
        for more in lines {
            let _ = writeln!(text, "  {:<38}{more}", "");
        }
    };
    line(if travel == "m" { "joint travels q" } else { "joint angles q" }, &travel, format_row(q));
    if qd.iter().any(|value| *value != 0.0) {
        line("joint velocities", &speed, format_row(qd));
    }
    line("tip", "m", format_row(&report.position));
    line("Jacobian J", &joint_units(units, |joint| joint.jacobian), format_matrix(&report.jacobian));
    line("mass matrix M", &joint_units(units, |joint| joint.inertia), format_matrix(&report.mass));
    line("bias c + g", &torque, format_row(&report.bias));
    line("condition of J, of M", "", format_row(&[report.condition.jacobian, report.condition.mass]));
    line("mass felt at the tip", "kg", format_row(&report.perception.tip));
    line("largest over smallest of these", "", format_row(&[report.perception.ratio]));
    for (index, wall) in walls.iter().enumerate() {
        line(&format!("wall {index}: normal"), "", format_row(&wall.normal));
        line(&format!("wall {index}: force"), "N", format_row(&[wall.force]));
    }
    if walls.is_empty() {
        text.push_str("\nNo wall: give --normal (and --force) to see the inertia that it meets here.\n");
        return text;
    }
    for (index, direction) in report.directions.iter().enumerate() {
        let number = index + 1;
        line(&format!("direction {number} of the stiffness"), "", format_row(&direction.along));
        line("stiffness along it, relative", "", format_row(&[direction.stiffness]));
        if let Some(share) = direction.share {
            line(&format!("share of level {number}"), "", format_row(&[share]));
        }
    }
    line("Weff, without feed-forward", "kg", format_matrix(&report.w_eff));
    line("Wrr, with feed-forward", "kg", format_matrix(&report.w_rr));
    line("coupling Wrr - Weff", "kg", format_matrix(&report.coupling));
    if let Some(along) = &report.perception.along_wall {
        line("felt along the wall, off", "kg", format_row(&along.off));
        line("felt along the wall, full", "kg", format_row(&along.full));
    }
    line("Wra", "", format_matrix(&report.w_ra));
    line("Waa", "", format_matrix(&report.w_aa));
    line("z rendered", "N", format_row(&report.z_r));
    line("z admissible", "", format_row(&report.z_a));
    line("feed-forward force fa", "", format_row(&report.f_a));
    line("torque without feed-forward", &torque, format_row(&report.torque_without_feed_forward));
    line("torque by (4), g in z", &torque, format_row(&report.torque));
    text.push('\n');
    text.push_str(&feed_forward_benefit(report));
    if let Some(push) = sideways_push(report) {
        let _ = writeln!(
            text,
            "At rest equation (4) pushes a hand along the wall by {push:.3} N per newton (feed_forward = \"full\"); \
             \"washout\" does not push a resting hand."
        );
    }
    text
}

/// Returns the force along a single wall per newton across it, at rest; `None` if too small to feel.
fn sideways_push(report: &Report) -> Option<f64> {
    let [coupled] = report.w_ra.as_slice() else { return None };
    let tip = coupled.iter().take(report.position.len() - 1);
    let push = tip.map(|entry| entry * entry).sum::<f64>().sqrt() / report.w_rr[0][0];
    (push >= 0.005).then_some(push)
}

/// Describes the benefit of the feed-forward at this pose. The stable area of an undamped device grows by (Wrr/Weff)².
fn feed_forward_benefit(report: &Report) -> String {
    let gain = report.gain();
    if !report.directions.is_empty() {
        "Several walls share the feed-forward by their stiffness: level 1 shapes forces along direction 1, and so on. \
         The effect is smaller if the next direction is nearly as stiff. `haptic range` with the same --normal and --share \
         shows the benefit.\n"
            .into()
    } else if report.w_aa.is_empty() {
        "No direction is left free, so there is no coupling, and the feed-forward adds only the compensation of z.\n"
            .into()
    } else if gain < 0.03 {
        format!(
            "With the feed-forward this wall meets {:.1} % more inertia here: it has almost no benefit at this pose and \
             normal; leave it off.\n",
            100.0 * gain.max(0.0)
        )
    } else {
        format!(
            "With the feed-forward this wall meets {:.1} % more inertia here: the stable range of stiffness and damping \
             grows to about {:.2} times the area.\n",
            100.0 * gain,
            (1.0 + gain) * (1.0 + gain)
        )
    }
}

fn format_row(values: &[f64]) -> String {
    // Prints an entry that is tiny compared with the largest as 0, because it is a rounding error.
    let smallest = 1e-12 * values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let clean = values.iter().map(|value| if value.abs() < smallest { 0.0 } else { *value });
    clean.map(|value| format!("{:>13}", format_number(value))).collect::<String>()
}

fn format_matrix(rows: &Rows) -> String {
    rows.iter().map(|values| format_row(values)).collect::<Vec<_>>().join("\n")
}

/// Formats a number with six significant digits, as a power of ten if that is shorter.
fn format_number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if (1.0e-3..1.0e5).contains(&size) {
        let digits = (5 - size.log10().floor() as i32).clamp(0, 8) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.5e}")
    }
}
