//! `haptic board report`: describes a board's condition on a page to send with a question; the motors stay off.

use super::force::ForceOption;
use super::port::{OnBoard, fault_without_remedy, state_in_words};
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::digits::shorten_all;
use haptic_host::error::{Failure, on_one_line, visible};
use haptic_host::link::{Board, BoardError, Row};
use haptic_host::output;
use haptic_host::read_back::{device_entries, scene, to_toml};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// Examine a board with its motors off, and write a page to send with a question
///
/// The page has encoders and currents at rest, bus, flash, stack and timing, each with a verdict and a remedy; then
/// versions, faults, device, scene and rules. A board that turns its current amplifiers off with the motors shows zero
/// currents. Keep your hands off the device during the measurement of one second. The page has no serial number, no
/// name of board or device, no port and no path. Refused while the motors are on.
#[derive(clap::Args)]
pub struct Args {
    /// File to write (Markdown) [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    on: OnBoard,
}

#[derive(Serialize)]
struct Finding {
    part: String,
    /// One of `OK`, `look at`, `bad` and `not known`.
    verdict: &'static str,
    what: String,
}

const OK: &str = "OK";
const LOOK_AT: &str = "look at";
const BAD: &str = "bad";
const NOT_KNOWN: &str = "not known";

/// Duration of the measurement of encoders and currents, s.
const MEASUREMENT_SECONDS: f32 = 1.0;
/// Rows per second of the measurement of encoders and currents.
const ROWS_PER_SECOND: f32 = 1000.0;
/// Largest accepted current at rest, A: bring-up requires less without torque (docs/bring-up.md, step 8).
const MAX_REST_CURRENT: f64 = 0.1;
/// Smallest accepted amount of never used stack, bytes.
const MIN_FREE_STACK: u32 = 1024;

pub fn run(args: Args) -> Result<(), Failure> {
    args.force.check(&args.output)?;
    let mut board = args.on.open()?;
    if !matches!(board.status()?.state, State::Disarmed | State::Fault) {
        return Err(BoardError::Refused(Refusal::Armed).into());
    }
    let findings = findings(&mut board)?;
    let page = format_page(&mut board, &findings)?;
    if let Some(path) = &args.output {
        output::write(path, visible(&page).as_bytes(), args.force.overwrite())?;
        return args.on.answer(json!({ "findings": findings }), &format!("{}: written\n", path.display()));
    }
    args.on.answer(json!({ "findings": findings, "page": page }), &page)
}

/// Samples encoders, currents and the bus voltage at rest.
fn sample_at_rest(board: &mut Board) -> Result<Vec<Row>, Failure> {
    let rate = board.details()?.rate_hz;
    let divider = (rate / ROWS_PER_SECOND).max(1.0) as u32;
    let count = (MEASUREMENT_SECONDS * rate / divider as f32) as usize;
    board.start_stream(Fields(Field::Current.bit() | Field::Counts.bit() | Field::BusVoltage.bit()), divider)?;
    let deadline = board.now() + Duration::from_secs_f32(3.0 * MEASUREMENT_SECONDS);
    let mut rows = Vec::new();
    let mut received = Ok(());
    while received.is_ok() && rows.len() < count && board.now() < deadline {
        received = board.rows(Duration::from_millis(50)).map(|new| rows.extend(new));
    }
    // Stops the stream also after an error, because the board would continue it.
    board.stop_stream()?;
    received?;
    Ok(rows)
}

fn findings(board: &mut Board) -> Result<Vec<Finding>, Failure> {
    let mut findings = Vec::new();
    let mut add = |part: &str, verdict, what: String| findings.push(Finding { part: part.into(), verdict, what });
    let (details, status, rules) = (board.details()?, board.status()?, board.rules()?);
    let axes = board.device()?.map_or(0, |device| device.axes());
    match &status.fault {
        Some(record) => {
            add("fault", BAD, format!("{}: {}", fault_without_remedy(record, details.rate_hz), record.fault.remedy()))
        }
        None => add("fault", OK, "no fault is latched".into()),
    }
    if axes == 0 {
        add("encoders and currents", LOOK_AT, "not read, because no device is loaded: load one first".into());
    } else {
        let before = board.details()?.overruns;
        let rows = sample_at_rest(board)?;
        if rows.is_empty() {
            add("telemetry", BAD, "no row arrived within three seconds: try another cable or USB port".into());
        }
        for axis in 0..axes {
            let column = |field| rows.iter().filter_map(|row| row.get(field).get(axis).copied()).collect::<Vec<f64>>();
            let (counts, currents) = (column(Field::Counts), column(Field::Current));
            if let Some((_, spread)) = mean_and_spread(&counts) {
                let what = format!("{spread:.0} counts of motion at rest");
                match spread {
                    ..=1.0 => add(&format!("encoder {axis}"), OK, what + "; turn the joint by hand to see it count"),
                    _ => add(
                        &format!("encoder {axis}"),
                        LOOK_AT,
                        what + ": if the device was not touched, check its wires for noise",
                    ),
                }
            }
            if let Some((mean, spread)) = mean_and_spread(&currents) {
                let what = format!("mean {mean:.4} A, lowest to highest {spread:.4} A, bridges off");
                match mean.abs().max(spread) {
                    _ if details.unsensed.contains(&Fault::OverCurrent.code()) => {
                        add(&format!("current {axis}"), NOT_KNOWN, "this board does not sense current".into());
                    }
                    size if size <= MAX_REST_CURRENT => add(&format!("current {axis}"), OK, what),
                    _ => add(
                        &format!("current {axis}"),
                        LOOK_AT,
                        what + ": more than 0.1 A; a half bridge conducts, or the zero of the current sensor is wrong: see docs/bring-up.md",
                    ),
                }
            }
        }
        let lost = board.losses();
        let overruns = board.details()?.overruns;
        let clean = lost.missing == 0 && lost.garbled == 0;
        add("link", if clean { OK } else { LOOK_AT }, lost.to_string());
        if overruns > before {
            add("overruns now", BAD, format!("{} during this second: lower rate_hz", overruns - before));
        }
    }
    let (volts, low, high) = (status.bus_voltage, rules.limits.bus_min, rules.limits.bus_max);
    match volts {
        0.0 => add("bus", NOT_KNOWN, "not sensed: measure the supply yourself".into()),
        _ if (low..=high).contains(&volts) => add("bus", OK, format!("{volts:.2} V of {low} to {high} V")),
        _ => add("bus", LOOK_AT, format!("{volts:.2} V, outside {low} to {high} V: is the supply on?")),
    }
    match details.damage.as_slice() {
        [] => add("flash", OK, "every stored setting is valid".into()),
        damaged => {
            let names: Vec<&str> = damaged.iter().map(|(key, _)| key.name()).collect();
            add("flash", BAD, format!("damaged: {}; load them again and save", names.join(", ")));
        }
    }
    match details.stack_free {
        0 => add("stack", NOT_KNOWN, "not measured on this board".into()),
        free if free < MIN_FREE_STACK => add("stack", BAD, format!("only {free} bytes were never used: report it")),
        free => add("stack", OK, format!("{free} bytes were never used")),
    }
    let timing = match details.longest_cycles {
        0 => "longest control interrupt not measured".to_string(),
        cycles => format!("longest control interrupt {cycles} cycles"),
    };
    let timing = format!("{timing}, {} overruns since boot", details.overruns);
    add("timing", if details.overruns == 0 { OK } else { BAD }, timing);
    Ok(findings)
}

/// Returns the mean, and the difference between the highest and the lowest value; `None` without values.
fn mean_and_spread(values: &[f64]) -> Option<(f64, f64)> {
    let low = values.iter().copied().reduce(f64::min)?;
    let high = values.iter().copied().reduce(f64::max)?;
    Some((values.iter().sum::<f64>() / values.len() as f64, high - low))
}

fn format_page(board: &mut Board, findings: &[Finding]) -> Result<String, Failure> {
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
        page += &format!("- {}\n", fault_without_remedy(record, details.rate_hz));
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
    // Leaves names out, because they may identify a person.
    let unnamed =
        |text: String| text.lines().filter(|line| !line.starts_with("name = ")).collect::<Vec<_>>().join("\n");
    part("Device", board.device()?.map(|device| unnamed(to_toml(&[], &device_entries(&device)))));
    part("Scene", board.scene()?.map(|loaded| to_toml(&[], &scene(&loaded))));
    let rules = serde_json::to_value(board.rules()?).map_err(Failure::impossible)?;
    part("Rules", Some(shorten_all(rules).to_string()));
    Ok(page)
}
