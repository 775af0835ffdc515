//! `haptic bench`: every variant of the control step with its cost and its error.

use haptic::bench::report::{Variant, devices, page, picture, variants};
use haptic::device_file::DeviceFile;
use haptic::error::{Failure, print};
use std::path::PathBuf;

/// Show what each way of computing the control step costs and what error it leaves
///
/// Instructions on the chip were counted on the emulated chip (benches/counts.json); errors are computed here and now;
/// what this computer takes is measured now and is no result to quote.
#[derive(clap::Args)]
pub struct Args {
    /// Device files (TOML) instead of one shipped device per mechanism
    device: Vec<PathBuf>,
    /// Write the page and the picture into this directory instead
    #[arg(long, value_name = "DIRECTORY")]
    report: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Computes and prints, or writes the report.
pub fn run(args: Args) -> Result<(), Failure> {
    let devices = match args.device.as_slice() {
        [] => devices()?,
        paths => paths
            .iter()
            .map(|path| DeviceFile::load(path)?.device().map_err(Failure::wrong))
            .collect::<Result<_, Failure>>()?,
    };
    let timed = args.report.is_none();
    let every = devices
        .into_iter()
        .map(|device| variants(&device, timed).map(|variants| (device, variants)))
        .collect::<Result<Vec<_>, Failure>>()?;
    if let Some(directory) = args.report {
        let failed = |error: std::io::Error| Failure::impossible(format!("{}: {error}", directory.display()));
        std::fs::create_dir_all(&directory).map_err(failed)?;
        std::fs::write(directory.join("speed-against-error.md"), page(&every)).map_err(failed)?;
        return Ok(picture(&every).save_svg(&directory.join("speed-against-error.svg"))?);
    }
    if args.json {
        let variants: Vec<&Variant> = every.iter().flat_map(|(_, variants)| variants).collect();
        return print(&format!("{}\n", serde_json::json!({ "variants": variants })));
    }
    let mut text = format!(
        "{:<52}{:>11}{:>14}{:>10}{:>12}{:>12}{:>12}\n",
        "variant", "target", "instructions", "ns", "max N m", "RMS N m", "duty steps"
    );
    for variant in every.iter().flat_map(|(_, variants)| variants) {
        text.push_str(&format!(
            "{:<52}{:>11}{:>14}{:>10}{:>12.2e}{:>12.2e}{:>12.3}{}\n",
            variant.name,
            variant.target,
            variant.instructions.map_or("-".into(), |count| count.to_string()),
            variant.nanoseconds.map_or("-".into(), |time| format!("{time:.0}")),
            variant.error_max,
            variant.error_rms,
            variant.errors.duty.max,
            if variant.pareto { "  front" } else { "" }
        ));
    }
    print(&text)
}
