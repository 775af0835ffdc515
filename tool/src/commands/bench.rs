//! `haptic bench`: the cost and the error of every variant of the control step.

use super::answer::Json;
use super::force::ForceOption;
use haptic_host::device_file::DeviceFile;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::output;
use haptic_predict::bench::error::ErrorSources;
use haptic_predict::bench::report::{Variant, devices, mechanism_table, variant_table, variants};
use haptic_show::plot::speed;
use serde_json::json;
use std::path::PathBuf;

/// Show the cost and the error of each way to compute the control step
///
/// Instructions on the chip were counted on the emulated chip (`cargo xtask bench`); errors are computed now. The time
/// on this computer is also measured now; do not publish it.
#[derive(clap::Args)]
pub struct Args {
    /// Device files (TOML) instead of one shipped device per mechanism
    device: Vec<PathBuf>,
    /// Write the tables (CSV) and the picture into this directory instead
    #[arg(long, value_name = "DIRECTORY")]
    report: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    json: Json,
}

const COLUMN_LEGEND: &str = "
variant: mechanism/trigonometry/exact/terms (exact: the mass matrix in closed form)
  trigonometry: table (and two terms of a series, as in the firmware), minimax (polynomials)
  terms: none (Jᵀ f alone), feed-forward, feed-forward+z (with the forces of motion)
errors, N at the tip at the worst of the poses and speeds that the motors can reach, for each cause alone:
  left out: terms that are not computed, or that fade near singular poses (20 kHz, 500 Hz);
  rounding: f32 and trigonometry in the torque; tip: f32 and trigonometry in the tip's position, times 20 kN/m
area: remaining share of the exact feed-forward's stable area of stiffness and damping, at the worst pose
front: no variant of the same mechanism is both cheaper and nearer to the ideal force (without the fade near singular poses)
";

pub fn run(args: Args) -> Result<(), Failure> {
    let names = ["speed-by-mechanism.csv", "speed-against-error.csv", "speed-against-error.svg"];
    let files = args.report.as_ref().map(|folder| names.map(|name| folder.join(name)));
    args.force.check(files.iter().flatten())?;
    let devices = match args.device.as_slice() {
        [] => devices()?,
        paths => paths
            .iter()
            .map(|path| DeviceFile::load(path)?.device().map_err(Failure::wrong))
            .collect::<Result<_, Failure>>()?,
    };
    let has_timing = args.report.is_none();
    let every = devices
        .into_iter()
        .map(|device| variants(&device, has_timing).map(|variants| (device, variants)))
        .collect::<Result<Vec<_>, Failure>>()?;
    if let (Some(folder), Some([table, variants, drawing])) = (&args.report, &files) {
        std::fs::create_dir_all(folder).map_err(|error| output::write_failure(folder, &error))?;
        let (mechanisms, each, picture) = (mechanism_table(&every)?, variant_table(&every), speed::draw(&every));
        let all = [
            (table.as_path(), mechanisms.as_bytes()),
            (variants.as_path(), each.as_bytes()),
            (drawing.as_path(), picture.svg().as_bytes()),
        ];
        return output::write_together(&all, args.force.overwrite());
    }
    if args.json.is_requested() {
        let variants: Vec<&Variant> = every.iter().flat_map(|(_, variants)| variants).collect();
        return print_json(json!({ "variants": variants }));
    }
    let mut text = format!(
        "{:<52}{:>11}{:>14}{:>10}{:>12}{:>12}{:>12}{:>9}\n",
        "variant", "target", "instructions", "ns", "left out", "rounding", "tip", "area"
    );
    for variant in every.iter().flat_map(|(_, variants)| variants) {
        let ErrorSources { dropped, rounding, tip, area, .. } = variant.parts;
        text.push_str(&format!(
            "{:<52}{:>11}{:>14}{:>10}{dropped:>12.1e}{rounding:>12.1e}{tip:>12.1e}{:>7.1} %{}\n",
            variant.name,
            variant.target,
            variant.instructions.map_or("-".into(), |count| count.to_string()),
            variant.nanoseconds.map_or("-".into(), |time| format!("{time:.0}")),
            100.0 * area,
            if variant.pareto { "  front" } else { "" }
        ));
    }
    text.push_str(COLUMN_LEGEND);
    print(&text)
}
