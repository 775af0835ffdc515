//! `haptic stream`: shows telemetry on the terminal and counts every loss. `haptic record` uses the same code.

use super::interrupt;
use super::port::{Port, counted, fault_in_words, motors_off_failure, short};
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::Status;
use haptic_bridge::safety::fault::State;
use haptic_host::error::{Failure, print};
use haptic_host::link::{Board, Column, LinkError, Losses, Row, columns, fields};
use haptic_host::output::Overwrite;
use haptic_host::words::{bytes_in_words, nth_step};
use haptic_show::recorder::about::About;
use haptic_show::recorder::{RecordError, RowWriter, Value};
use serde_json::json;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

/// Show telemetry on the terminal
///
/// Losses are counted exactly and shown. `haptic record` writes a file.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Fields, separated by commas: usual, all, or any of the list below
    #[arg(long, value_name = "NAMES", default_value = "usual", value_parser = fields)]
    fields: Fields,
    /// Rows per second, at most the control rate
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = parse_positive)]
    rate: f64,
    /// Switch the motors on when the first rows arrive, and off at the end; an error if a fault turned them off before
    #[arg(long)]
    arm: bool,
    /// Stop after this time on the board's clock [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = parse_positive)]
    seconds: Option<f64>,
    /// Print one JSON document at the end: the rows, and the losses
    #[arg(long)]
    json: bool,
}

pub(super) fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

/// Lists the fields with units and meaning, for the help page.
pub fn list_of_fields() -> String {
    let mut text = "Fields (docs/telemetry.md):\n".to_string();
    for field in Field::ALL {
        text.push_str(&format!("  {:<11}{:<7}{}\n", field.name(), field.unit(), field.meaning()));
    }
    text
}

enum Sink {
    Terminal { since_header: usize },
    Memory(Vec<Vec<Value>>),
    File(Box<RowWriter>),
}

/// Fields to follow, and the destination of their rows.
pub(super) struct Options<'a> {
    pub file: Option<&'a Path>,
    /// True for a CSV file with numbers and names of columns alone.
    pub plain: bool,
    pub overwrite: Overwrite,
    pub fields: Fields,
    pub rate: f64,
    pub arm: bool,
    pub seconds: Option<f64>,
    pub json: bool,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let options = Options {
        file: None,
        plain: false,
        overwrite: Overwrite::Never,
        fields: args.fields,
        rate: args.rate,
        arm: args.arm,
        seconds: args.seconds,
        json: args.json,
    };
    follow(&mut board, &options)
}

/// Streams the board's telemetry to its destination until it ends.
pub(super) fn follow(board: &mut Board, options: &Options<'_>) -> Result<(), Failure> {
    let rate_hz = f64::from(board.details()?.rate_hz);
    let device = board.device()?;
    let sensed = device.as_ref().map_or(0, |device| device.sensed.len());
    let units = device.map(|device| device.mechanism.units()).unwrap_or_default();
    let divider = (rate_hz / options.rate).round().clamp(1.0, f64::from(u32::MAX)) as u32;
    let rows_per_second = rate_hz / f64::from(divider);
    if (rows_per_second - options.rate).abs() > 1e-3 * options.rate {
        haptic_host::tell!(
            "{} rows a second: every {} at {rate_hz} Hz control",
            short(rows_per_second as f32),
            nth_step(divider)
        );
    }
    let columns = columns(options.fields, &units, sensed);
    if columns.is_empty() {
        let reason = "the board's device has no encoders without motors, so there is nothing to stream";
        return Err(Failure::wrong(reason).remedy("choose other --fields"));
    }
    let about = options.file.map(|_| About::read(board, divider)).transpose()?;
    let about = about.map(|about| if options.plain { about.without_comments() } else { about });
    let stop = interrupt::watch();
    board.keep_alive();
    board.start_stream(options.fields, divider)?;
    if options.arm {
        board.arm()?;
    }
    // Creates the file last, so that a refusal of the board neither creates nor replaces a file.
    let sink = match (options.file, about) {
        (Some(path), Some(about)) => match RowWriter::create(path, &about, &columns, options.overwrite) {
            Ok(writer) => Sink::File(Box::new(writer)),
            Err(failure) => {
                if options.arm {
                    board.disarm()?;
                }
                board.stop_stream()?;
                return Err(failure);
            }
        },
        _ if options.json => Sink::Memory(Vec::new()),
        _ => Sink::Terminal { since_header: usize::MAX },
    };
    let mut stream = Stream {
        rate_hz,
        divider,
        columns,
        sink,
        first_step: None,
        last_step: 0,
        rows: 0,
        missing: 0,
        shown: Losses::default(),
        last_note: board.now(),
    };
    let end = loop {
        if stop.is_set() {
            break StreamEnd::Requested;
        }
        match board.rows(Duration::from_millis(200)) {
            Err(error) => break StreamEnd::BoardLost(error),
            Ok(rows) => {
                let mut result = Ok(());
                for record in board.take_reported_faults() {
                    let words = fault_in_words(&record, rate_hz as f32);
                    haptic_host::tell!("fault: {words}");
                    result = result.and(stream.record_event(&words));
                }
                let is_over = result.and_then(|()| stream.pass_rows(&rows, options.seconds));
                match is_over.and_then(|is_over| stream.report_losses(board).map(|()| is_over)) {
                    Ok(false) => {}
                    Ok(true) => break StreamEnd::Requested,
                    Err(RecordError::ReaderGone) => break StreamEnd::ReaderGone,
                    Err(RecordError::Failed(failure)) => break StreamEnd::NoRoom(failure),
                }
            }
        }
    };
    // Turns the motors off first; errors of the file come later.
    let disarmed = match end {
        StreamEnd::BoardLost(_) => Ok(()),
        _ if options.arm => disarm(board, rate_hz as f32),
        _ => Ok(()),
    };
    finish(end, board, stream, options.json).and(disarmed)
}

/// Turns the motors off. Returns an error if a fault turned them off before.
fn disarm(board: &mut Board, rate_hz: f32) -> Result<(), Failure> {
    board.disarm()?;
    match board.status()? {
        Status { state: State::Fault, fault: Some(record), .. } => Err(motors_off_failure(&record, rate_hz)),
        _ => Ok(()),
    }
}

enum StreamEnd {
    Requested,
    ReaderGone,
    BoardLost(LinkError),
    NoRoom(Failure),
}

struct Stream {
    rate_hz: f64,
    divider: u32,
    columns: Vec<Column>,
    sink: Sink,
    first_step: Option<u32>,
    last_step: u32,
    /// Number of rows passed on.
    rows: u64,
    /// Number of rows missing between the passed rows.
    missing: u64,
    shown: Losses,
    last_note: Duration,
}

impl Stream {
    /// Passes rows on to their destination. Returns true if the time is over.
    fn pass_rows(&mut self, rows: &[Row], seconds: Option<f64>) -> Result<bool, RecordError> {
        for row in rows {
            let first = *self.first_step.get_or_insert(row.step);
            let time = f64::from(row.step.wrapping_sub(first)) / self.rate_hz;
            if seconds.is_some_and(|seconds| time >= seconds) {
                return Ok(true);
            }
            if self.rows > 0 {
                let steps = row.step.wrapping_sub(self.last_step);
                self.missing += u64::from((steps / self.divider).saturating_sub(1));
            }
            (self.last_step, self.rows) = (row.step, self.rows + 1);
            self.pass_row(row, time)?;
        }
        Ok(false)
    }

    fn pass_row(&mut self, row: &Row, time: f64) -> Result<(), RecordError> {
        let values = self.columns.iter().zip(&row.values).map(|(column, value)| Value::of(column, *value));
        match &mut self.sink {
            Sink::File(writer) => writer.add_row(row.step, time, &row.values),
            Sink::Memory(rows) => {
                rows.push(
                    [Value::Number(f64::from(row.step)), Value::Number(time)].into_iter().chain(values).collect(),
                );
                Ok(())
            }
            Sink::Terminal { since_header } => {
                let mut text = String::new();
                if *since_header >= 30 {
                    *since_header = 0;
                    text.push_str(&format!("{:>10}", "time_s"));
                    for column in &self.columns {
                        text.push_str(&format!(" {:>13}", column.label));
                    }
                    text.push('\n');
                }
                *since_header += 1;
                text.push_str(&format!("{time:>10.3}"));
                for (column, value) in self.columns.iter().zip(values) {
                    text.push_str(&format!(" {:>13}", format_value(column, value)));
                }
                text.push('\n');
                std::io::stdout().lock().write_all(text.as_bytes()).map_err(|error| match error.kind() {
                    std::io::ErrorKind::BrokenPipe => RecordError::ReaderGone,
                    _ => {
                        RecordError::Failed(Failure::impossible(format!("standard output cannot be written: {error}")))
                    }
                })
            }
        }
    }

    /// Adds an event if rows go to a file.
    fn record_event(&mut self, words: &str) -> Result<(), RecordError> {
        let first = self.first_step.unwrap_or(self.last_step);
        let time = f64::from(self.last_step.wrapping_sub(first)) / self.rate_hz;
        match &mut self.sink {
            Sink::File(writer) => writer.add_event(time, words),
            _ => Ok(()),
        }
    }

    /// Flushes the file and reports new losses, twice a second.
    fn report_losses(&mut self, board: &Board) -> Result<(), RecordError> {
        let now = board.now();
        if now.saturating_sub(self.last_note) < Duration::from_millis(500) {
            return Ok(());
        }
        self.last_note = now;
        let losses = self.losses(board);
        if let Sink::File(writer) = &mut self.sink {
            writer.flush()?;
            if std::io::stderr().is_terminal() {
                let size = bytes_in_words(writer.bytes());
                haptic_host::error::overwrite_line(format_args!("{losses}, {size}   "), false);
            }
        } else if losses.missing > self.shown.missing || losses.garbled > self.shown.garbled {
            haptic_host::tell!("{losses}");
        }
        self.shown = losses;
        Ok(())
    }

    /// Returns the losses among the rows that were passed on.
    fn losses(&self, board: &Board) -> Losses {
        Losses { received: self.rows, missing: self.missing, ..board.losses() }
    }
}

/// Formats a value for the terminal: five decimals, or all digits of counts.
fn format_value(column: &Column, value: Value) -> String {
    match (column.field, value) {
        (Field::Counts | Field::State | Field::Saturated, value) | (_, value @ Value::Word(_)) => value.to_string(),
        (_, Value::Number(number)) => format!("{number:.5}"),
        // Removes the sign of a number that rounds to zero.
        (_, Value::Single(number)) => format!("{:.5}", (1e5 * number).round() / 1e5 + 0.0),
    }
}

fn as_json(value: &Value) -> serde_json::Value {
    match value {
        Value::Number(number) => json!(number),
        Value::Single(_) => json!(value.to_string().parse::<f64>().ok()),
        Value::Word(word) => json!(word),
    }
}

/// Stops the stream and reports the result: the same count in the file, on the terminal and in JSON.
fn finish(end: StreamEnd, board: &mut Board, mut stream: Stream, json: bool) -> Result<(), Failure> {
    let stopped = match end {
        StreamEnd::BoardLost(_) => Ok(()),
        _ => board.stop_stream(),
    };
    if matches!(end, StreamEnd::ReaderGone) {
        return Ok(());
    }
    let losses = stream.losses(board);
    let mut written = Ok(());
    let mut summary = losses.to_string();
    let mut file = None;
    if let Sink::File(recorder) = &mut stream.sink {
        if !matches!(end, StreamEnd::NoRoom(_)) {
            let cut = if matches!(end, StreamEnd::BoardLost(_)) { "cut short: the board was lost; " } else { "" };
            written = recorder.end(&format!("{cut}{losses}"), &losses);
        }
        // Ignores a reader that closes the pipe at the end.
        if matches!((&end, &written), (StreamEnd::Requested, Err(RecordError::ReaderGone))) {
            return Ok(stopped?);
        }
        let verb = if recorder.rows() == 1 { "is" } else { "are" };
        let size = bytes_in_words(recorder.bytes());
        let all = format!("{} {verb} in {}, {size}", counted(recorder.rows(), "row"), recorder.destination());
        let text = losses.to_string();
        let other_losses = text.trim_start_matches(|c: char| c != ',');
        summary = match losses.received.saturating_sub(recorder.rows()) {
            0 => format!("{all}{other_losses}"),
            unwritten if losses.missing == 0 => {
                format!("{all}, {unwritten} received rows could not be written and are lost")
            }
            unwritten => {
                format!("{all}, {unwritten} received rows could not be written and are lost{other_losses} before")
            }
        };
        file = Some((recorder.destination(), recorder.rows(), recorder.bytes()));
        if std::io::stderr().is_terminal() {
            haptic_host::tell!("");
        }
    }
    haptic_host::tell!("{summary}");
    if json {
        let names: Vec<&str> =
            ["step", "time_s"].into_iter().chain(stream.columns.iter().map(|column| column.label.as_str())).collect();
        let mut document = json!({
            "columns": names, "rows": losses.received, "missing": losses.missing,
            "dropped_by_board": losses.dropped_by_board, "batches_lost": losses.batches_lost,
            "frames_garbled": losses.garbled,
        });
        if let Some((place, rows, bytes)) = &file {
            document["file"] = json!(place);
            document["rows"] = json!(rows);
            document["bytes"] = json!(bytes);
        }
        if let Sink::Memory(rows) = &stream.sink {
            document["values"] = rows.iter().map(|row| row.iter().map(as_json).collect::<Vec<_>>()).collect();
        }
        print(&format!("{document}\n"))?;
    }
    match (end, written) {
        (StreamEnd::NoRoom(failure), _) | (_, Err(RecordError::Failed(failure))) => Err(failure),
        (StreamEnd::BoardLost(error), _) if file.is_none() => Err(error.into()),
        (StreamEnd::BoardLost(error), _) => Err(Failure::impossible(error).remedy(summary)),
        _ => Ok(stopped?),
    }
}
