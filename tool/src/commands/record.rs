//! `haptic record`: telemetry into a file that other programs open, at any rate up to the loop's.

use super::force::Force;
use super::port::Port;
use super::stream::{Wanted, follow, positive};
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_host::error::Failure;
use haptic_host::link::{fields, rows_that_fit};
use std::path::PathBuf;

/// Fields that are recorded by default: those that a person wants to see, and those that `haptic replay` needs.
const FIELDS: Fields = Fields(
    Fields::USUAL.0 | Field::Angle.bit() | Field::NormalVelocity.bit() | Field::Energy.bit() | Field::Counts.bit(),
);

/// Record telemetry to a file: MCAP for Foxglove, PlotJuggler and others, or CSV
///
/// The file's ending says which: FILE.mcap or FILE.csv. Device, scene, gains, rules, versions, time base and losses are
/// in it. A recording that is cut short (unplugged, killed, disk full) is readable to its last full chunk of half a
/// second (MCAP) or its last line (CSV).
#[derive(clap::Args)]
pub struct Args {
    /// The file to write, .mcap or .csv; - is CSV to standard output
    file: PathBuf,
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    force: Force,
    /// Fields, separated by commas: usual, all, or any of the list of `haptic stream --help` [default: usual and q,
    /// velocity, energy, counts]
    #[arg(long, value_name = "NAMES", value_parser = fields)]
    fields: Option<Fields>,
    /// Rows per second, at most the control rate [default: as many as the link carries]
    #[arg(long, value_name = "HZ", value_parser = positive)]
    rate: Option<f64>,
    /// Switch the motors on once rows come, and off at the end; an error where a fault turned them off before
    #[arg(long)]
    arm: bool,
    /// Stop after so many seconds of the board's time [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    seconds: Option<f64>,
    /// Print one JSON document at the end: where the rows are, and what was lost
    #[arg(long)]
    json: bool,
}

/// Records until the time is over, Ctrl-C, or the board goes away.
pub fn run(args: Args) -> Result<(), Failure> {
    let ending = args.file.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    if args.file.as_os_str() != "-" && !matches!(ending.as_deref(), Some("mcap" | "csv")) {
        let reason = format!("{} ends neither in .mcap nor in .csv", args.file.display());
        return Err(Failure::wrong(reason).remedy("the ending says which format is written"));
    }
    args.force.check([&args.file])?;
    let mut board = args.port.open()?;
    let fields = args.fields.unwrap_or(FIELDS);
    let rate = match args.rate {
        Some(rate) => rate,
        None => {
            let rate_hz = f64::from(board.details()?.rate_hz);
            let axes = board.device()?.map_or(0, |device| device.axes());
            rows_that_fit(board.info().board.as_str(), fields, axes, rate_hz)
        }
    };
    let wanted = Wanted {
        file: Some(&args.file),
        overwrite: args.force.overwrite(),
        fields,
        rate,
        arm: args.arm,
        seconds: args.seconds,
        json: args.json,
    };
    follow(&mut board, &wanted)
}
