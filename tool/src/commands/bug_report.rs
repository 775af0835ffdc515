//! `haptic board report`: how a board is, as a page to send with a question; the motors stay off.

use super::force::Force;
use super::port::{OnBoard, fault_alone, state_in_words};
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::digits::shortest;
use haptic_host::error::{Failure, on_one_line, visible};
use haptic_host::link::{Board, BoardError, Row};
use haptic_host::output;
use haptic_host::read_back::{running, scene, to_toml};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// Examine a board with its motors off, and write a page to send with a question
///
/// Encoders and currents at rest, bus, flash, stack and timing, each with a verdict and what to do; then versions,
/// faults, device, scene and rules. A board whose current amplifiers sleep while the motors are off shows zeros there.
/// Keep hands off the device for the second that it takes. The page has no serial number, no name of board or device,
/// no port and no path. Refused while the motors are on.
#[derive(clap::Args)]
pub struct Args {
    /// File to write (Markdown) [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    on: OnBoard,
}

/// What was found about one part.
#[derive(Serialize)]
struct Finding {
    part: String,
    /// `OK`, `look at`, `bad` or `not known`.
    verdict: &'static str,
    what: String,
}

const OK: &str = "OK";
const LOOK: &str = "look at";
const BAD: &str = "bad";
const UNKNOWN: &str = "not known";

/// For how long encoders and currents are watched, s.
const SECONDS: f32 = 1.0;
/// Rows a second that are enough for that.
const ROWS: f32 = 1000.0;
/// A current at rest that is worth a look, A: bring-up asks for less at no torque (docs/bring-up.md, step 8).
const REST_CURRENT: f64 = 0.1;
/// Stack that a board should never have used, bytes.
const SPARE_STACK: u32 = 1024;

/// Examines the board, then writes the page.
pub fn run(args: Args) -> Result<(), Failure> {
    args.force.check(&args.output)?;
    let mut board = args.on.open()?;
    if !matches!(board.status()?.state, State::Disarmed | State::Fault) {
        return Err(BoardError::Refused(Refusal::Armed).into());
    }
    let findings = findings(&mut board)?;
    let page = page(&mut board, &findings)?;
    if let Some(path) = &args.output {
        output::write(path, visible(&page).as_bytes(), args.force.overwrite())?;
        return args.on.answer(json!({ "findings": findings }), &format!("{}: written\n", path.display()));
    }
    args.on.answer(json!({ "findings": findings, "page": page }), &page)
}

/// Rows of what the sensors show at rest.
fn at_rest(board: &mut Board) -> Result<Vec<Row>, Failure> {
    let rate = board.details()?.rate_hz;
    let divider = (rate / ROWS).max(1.0) as u32;
    let wanted = (SECONDS * rate / divider as f32) as usize;
    board.start_stream(Fields(Field::Current.bit() | Field::Counts.bit() | Field::BusVoltage.bit()), divider)?;
    let until = board.now() + Duration::from_secs_f32(3.0 * SECONDS);
    let mut rows = Vec::new();
    let mut came = Ok(());
    while came.is_ok() && rows.len() < wanted && board.now() < until {
        came = board.rows(Duration::from_millis(50)).map(|new| rows.extend(new));
    }
    // Also where the rows ended in an error: the stream would go on.
    board.stop_stream()?;
    came?;
    Ok(rows)
}

fn findings(board: &mut Board) -> Result<Vec<Finding>, Failure> {
    let mut found = Vec::new();
    let mut tell = |part: &str, verdict, what: String| found.push(Finding { part: part.into(), verdict, what });
    let (details, status, rules) = (board.details()?, board.status()?, board.rules()?);
    let axes = board.device()?.map_or(0, |device| device.axes());
    match &status.fault {
        Some(record) => {
            tell("fault", BAD, format!("{}: {}", fault_alone(record, details.rate_hz), record.fault.remedy()))
        }
        None => tell("fault", OK, "none is latched".into()),
    }
    if axes == 0 {
        tell("encoders and currents", LOOK, "no device is loaded, so none were read: load one first".into());
    } else {
        let before = board.details()?.overruns;
        let rows = at_rest(board)?;
        if rows.is_empty() {
            tell("telemetry", BAD, "no row came within three seconds: try another cable or USB port".into());
        }
        for axis in 0..axes {
            let column = |field| rows.iter().filter_map(|row| row.get(field).get(axis).copied()).collect::<Vec<f64>>();
            let (counts, currents) = (column(Field::Counts), column(Field::Current));
            if let Some((_, spread)) = mean_and_spread(&counts) {
                let what = format!("{spread:.0} counts of motion at rest");
                match spread {
                    ..=1.0 => tell(&format!("encoder {axis}"), OK, what + "; turn the joint by hand to see it count"),
                    _ => tell(
                        &format!("encoder {axis}"),
                        LOOK,
                        what + ": if nobody touched the device, look for noise on its wires",
                    ),
                }
            }
            if let Some((mean, spread)) = mean_and_spread(&currents) {
                let what = format!("mean {mean:.4} A, lowest to highest {spread:.4} A, bridges off");
                match mean.abs().max(spread) {
                    _ if details.unsensed.contains(&Fault::OverCurrent.code()) => {
                        tell(&format!("current {axis}"), UNKNOWN, "this board senses none".into());
                    }
                    size if size <= REST_CURRENT => tell(&format!("current {axis}"), OK, what),
                    _ => tell(
                        &format!("current {axis}"),
                        LOOK,
                        what + ": more than 0.1 A; a leg conducts, or its sensor's zero is off",
                    ),
                }
            }
        }
        let lost = board.losses();
        let overruns = board.details()?.overruns;
        let clean = lost.missing == 0 && lost.garbled == 0;
        tell("link", if clean { OK } else { LOOK }, lost.to_string());
        if overruns > before {
            tell("overruns now", BAD, format!("{} during this second: lower rate_hz", overruns - before));
        }
    }
    let (volts, low, high) = (status.bus_voltage, rules.limits.bus_min, rules.limits.bus_max);
    match volts {
        0.0 => tell("bus", UNKNOWN, "not sensed: measure the supply yourself".into()),
        _ if (low..=high).contains(&volts) => tell("bus", OK, format!("{volts:.2} V of {low} to {high} V")),
        _ => tell("bus", LOOK, format!("{volts:.2} V, outside {low} to {high} V: is the supply on?")),
    }
    match details.damage.as_slice() {
        [] => tell("flash", OK, "every setting stored is sound".into()),
        damaged => {
            let names: Vec<&str> = damaged.iter().map(|(key, _)| key.name()).collect();
            tell("flash", BAD, format!("damaged: {}; load them again and save", names.join(", ")));
        }
    }
    match details.stack_free {
        0 => tell("stack", UNKNOWN, "not measured on this board".into()),
        free if free < SPARE_STACK => tell("stack", BAD, format!("only {free} bytes were never used: report it")),
        free => tell("stack", OK, format!("{free} bytes were never used")),
    }
    let timing = match details.longest_cycles {
        0 => "longest control interrupt not measured".to_string(),
        cycles => format!("longest control interrupt {cycles} cycles"),
    };
    let timing = format!("{timing}, {} overruns since boot", details.overruns);
    tell("timing", if details.overruns == 0 { OK } else { BAD }, timing);
    Ok(found)
}

/// The mean, and the lowest to the highest.
fn mean_and_spread(values: &[f64]) -> Option<(f64, f64)> {
    let low = values.iter().copied().reduce(f64::min)?;
    let high = values.iter().copied().reduce(f64::max)?;
    Some((values.iter().sum::<f64>() / values.len() as f64, high - low))
}

fn page(board: &mut Board, findings: &[Finding]) -> Result<String, Failure> {
    let (info, details, status) = (board.info().clone(), board.details()?, board.status()?);
    let mut page = format!(
        "# Board report\n\nTool {}, firmware {}, protocol {}, board {}, {} axes. State: {}; homed: {}; \
         polarity checked: {}.\n\
         Control {} Hz, carrier {} Hz, delay {} samples.\n\n| part | verdict | what |\n|---|---|---|\n",
        env!("CARGO_PKG_VERSION"),
        on_one_line(&info.firmware),
        info.protocol,
        on_one_line(&info.board),
        details.axes,
        state_in_words(status.state),
        status.homed,
        status.polarity,
        details.rate_hz,
        details.carrier_hz,
        details.delay_samples
    );
    for Finding { part, verdict, what } in findings {
        page += &format!("| {part} | {verdict} | {what} |\n");
    }
    page += "\n## Faults since the board started\n\n";
    let faults = board.faults()?;
    for record in &faults {
        page += &format!("- {}\n", fault_alone(record, details.rate_hz));
    }
    if faults.is_empty() {
        page += "None.\n";
    }
    let unsensed = Fault::ALL.iter().filter(|fault| details.unsensed.contains(&fault.code()));
    unsensed.for_each(|fault| page += &format!("- not sensed: {}\n", fault.what()));
    let mut part = |title: &str, text: Option<String>| {
        page += &format!("\n## {title}\n\n");
        page += &text.map_or("None.\n".into(), |text| format!("```\n{}\n```\n", text.trim()));
    };
    // A name may be anybody's.
    let unnamed =
        |text: String| text.lines().filter(|line| !line.starts_with("name = ")).collect::<Vec<_>>().join("\n");
    part("Device", board.device()?.map(|device| unnamed(to_toml(&[], &running(&device)))));
    part("Scene", board.scene()?.map(|loaded| to_toml(&[], &scene(&loaded))));
    let rules = serde_json::to_value(board.rules()?).map_err(Failure::impossible)?;
    part("Rules", Some(shortest(rules).to_string()));
    Ok(page)
}
