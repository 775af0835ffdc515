//! `haptic board latency`: measures the round trip to a board.

use super::interrupt;
use super::port::OnBoard;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::latency::{Spread, measure};

/// Measure the round trip to a board
///
/// Requests the state of the device repeatedly, as a program that renders forces does; the motors stay as they are. The
/// round trip is measured on the computer's clock. The age is measured on the board's clock: from the state that a
/// program receives to the moment when the force computed from it would begin to act.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
    /// Number of exchanges
    #[arg(long, value_name = "N", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(2..=10_000_000))]
    exchanges: u32,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let stop = interrupt::watch();
    let latency = measure(&mut board, args.exchanges as usize, || stop.is_set())?;
    if args.on.json.is_requested() {
        return print_json(&latency);
    }
    let mut report =
        format!("{} exchanges, {:.0} a second, on {}\n", latency.round_trip.count, latency.per_second, board.port());
    for (name, spread) in [("round trip", &latency.round_trip), ("age of a force when it begins to act", &latency.age)]
    {
        report.push_str(&describe_spread(name, spread));
    }
    print(&report)
}

fn describe_spread(name: &str, spread: &Spread) -> String {
    let ms = |seconds: f64| format!("{:.3} ms", 1e3 * seconds);
    let mut text = format!(
        "\n{name}: median {}, 99 % within {}, 99.9 % within {}, longest {}\n",
        ms(spread.median),
        ms(spread.p99),
        ms(spread.p999),
        ms(spread.max)
    );
    let most = spread.histogram.iter().map(|bin| bin.count).max().unwrap_or(1).max(1);
    for bin in &spread.histogram {
        // Prints at least one mark for a bin that is not empty.
        let length = (40 * bin.count).div_ceil(most);
        text.push_str(&format!("  up to {:>9} {:>8}  {}\n", ms(bin.to), bin.count, "#".repeat(length)));
    }
    text
}
