//! `haptic map`: the inertia that a wall meets over the workspace, and the benefit of the feed-forward there.

use super::answer::{Json, Pictures};
use super::arguments::{self, HoldingArgs, Numbers};
use super::continued::Continue;
use haptic_host::error::Failure;
use haptic_predict::plausible::{WithWarnings, warn};
use haptic_show::plot::map::draw;
use haptic_stability::analysis::map::{MapPoint, map_swept};
use std::fmt::Write;
use std::path::PathBuf;

/// Map inertia and coupling over the workspace for one wall normal
///
/// Covers the poses that the device reaches from home without crossing a singularity: effective and rendered inertia
/// along the normal, the two worst normals at each pose (of the ratio Wrr/Weff and of the coupling Wrr - Weff),
/// conditioning, and the axes of the operational-space inertia. In JSON, eigenvector k belongs to eigenvalue k. The
/// picture shows one plane of the workspace (with a turret, the plane of the linkage at joint 0 = 0), coloured by
/// coupling/w_rr over the first two entries of the position (docs/devices.md).
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Normal of the wall, of any length
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Numbers,
    /// Poses of the joint grid, before unreachable poses are left out
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    points: u32,
    #[command(flatten)]
    holding: HoldingArgs,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    json: Json,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(serde::Serialize)]
struct Document {
    points: Vec<MapPoint>,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let (file, warnings) = arguments::load_device(&args.device, false)?;
    warn(&warnings);
    let normal = args.normal.unit(file.spec().task, "--normal")?;
    let has_picture = args.pictures.is_requested();
    let question = format!("{:?} {normal:?} {} {:?}", file.description, args.points, args.holding.admissible);
    let sweep = args.continued.sweep("map", &question)?;
    let points = map_swept(&file.description, &normal, args.points as usize, args.holding.admissible, &sweep)?;
    if points.is_empty() {
        return Err(Failure::impossible("no pose of this grid is regular").remedy("use more --points"));
    }
    if has_picture {
        let picture = draw(&file.description, &file.name, &normal, args.holding.admissible, args.pictures.paper())?;
        args.pictures.save(&picture)?;
    }
    let words = readable(&file.name, &points);
    args.json.answer(WithWarnings { result: &Document { points }, warnings: &warnings }, &words)?;
    sweep.finish();
    Ok(())
}

fn readable(name: &str, points: &[MapPoint]) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    line(format!("{name}: {} poses", points.len()));
    line(format!("  {:<34}{:>13}{:>13}{:>13}", "", "lowest", "median", "highest"));
    let mut row = |label: &str, pick: fn(&MapPoint) -> f64| {
        // Removes the sign of a number that rounds to zero.
        let mut values: Vec<f64> = points.iter().map(|point| (1e5 * pick(point)).round() / 1e5 + 0.0).collect();
        values.sort_by(f64::total_cmp);
        let (low, middle, high) = (values[0], values[values.len() / 2], values[values.len() - 1]);
        line(format!("  {label:<34}{low:>13.5}{middle:>13.5}{high:>13.5}"));
    };
    row("Weff along the normal, kg", |p| p.w_eff);
    row("Wrr along the normal, kg", |p| p.w_rr);
    row("coupling Wrr - Weff, kg", |p| p.coupling);
    row("ratio Wrr/Weff", |p| p.w_rr / p.w_eff);
    row("ratio at the worst normal", |p| p.worst_ratio.value);
    row("coupling at its worst normal, kg", |p| p.worst_coupling.value);
    row("condition of J", |p| p.condition.jacobian);
    row("condition of M", |p| p.condition.mass);
    let enlarged = points.iter().filter(|p| (p.w_rr / p.w_eff).powi(2) >= 1.05).count();
    line(format!(
        "The feed-forward enlarges the stable area of this normal by 5 % or more at {:.0} % of the poses.",
        100.0 * enlarged as f64 / points.len() as f64
    ));
    text
}
