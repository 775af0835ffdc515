//! `haptic record`: writes telemetry to a file that other programs open, at any rate up to the control rate.

use super::force::ForceOption;
use super::port::Port;
use super::stream::{Options, follow, parse_positive};
use haptic_bridge::board::telemetry::{Field, Fields, RowShape};
use haptic_host::error::Failure;
use haptic_host::link::{fields, max_rows_per_second};
use std::path::PathBuf;

/// Default fields: those that a person reads, and those that `haptic replay` needs.
const DEFAULT_FIELDS: Fields = Fields(
    Fields::USUAL.0 | Field::Angle.bit() | Field::NormalVelocity.bit() | Field::Energy.bit() | Field::Counts.bit(),
);

/// Record telemetry to a file: MCAP for Foxglove, PlotJuggler and others, or CSV
///
/// The file's extension selects the format: FILE.mcap or FILE.csv. The file also holds device, scene, gains, rules,
/// versions, time base and losses. A recording that is cut short (unplugged, killed, disk full) is readable up to its
/// last full chunk of half a second (MCAP) or its last line (CSV).
#[derive(clap::Args)]
pub struct Args {
    /// File to write, .mcap or .csv; - is CSV to standard output
    file: PathBuf,
    /// Write a CSV file with one line of names and otherwise numbers alone, for numpy, Matlab or a spreadsheet; `haptic
    /// replay` cannot compute it again
    #[arg(long)]
    plain: bool,
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    force: ForceOption,
    /// Fields, separated by commas: usual, all, or any from the list of `haptic stream --help` [default: usual and q,
    /// velocity, energy, counts]
    #[arg(long, value_name = "NAMES", value_parser = fields)]
    fields: Option<Fields>,
    /// Rows per second, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = parse_positive)]
    rate: Option<f64>,
    /// Switch the motors on when the first rows arrive, and off at the end; an error if a fault turned them off before
    #[arg(long)]
    arm: bool,
    /// Stop after this time on the board's clock [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = parse_positive)]
    seconds: Option<f64>,
    /// Print one JSON document at the end: the file, and the losses
    #[arg(long)]
    json: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let extension = args.file.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    if args.file.as_os_str() != "-" && !matches!(extension.as_deref(), Some("mcap" | "csv")) {
        let reason = format!("{} ends neither in .mcap nor in .csv", args.file.display());
        return Err(Failure::wrong(reason).remedy("name a file with one of these extensions, which selects the format"));
    }
    if args.plain && extension.as_deref() == Some("mcap") {
        return Err(Failure::wrong("--plain applies to CSV").remedy("name a .csv file, or leave --plain out"));
    }
    args.force.check([&args.file])?;
    let mut board = args.port.open()?;
    let fields = args.fields.unwrap_or(DEFAULT_FIELDS);
    let rate = match args.rate {
        Some(rate) => rate,
        None => {
            let rate_hz = f64::from(board.details()?.rate_hz);
            let shape = RowShape::of(board.device()?.as_ref());
            max_rows_per_second(board.info().board.as_str(), fields, shape, rate_hz)
        }
    };
    let options = Options {
        file: Some(&args.file),
        plain: args.plain,
        overwrite: args.force.overwrite(),
        fields,
        rate,
        arm: args.arm,
        seconds: args.seconds,
        json: args.json,
    };
    follow(&mut board, &options)
}
