//! `haptic stream`: telemetry to the terminal or to a CSV file, with every loss counted and shown.

use super::port::{Port, fault_in_words};
use haptic::error::Failure;
use haptic::interrupt;
use haptic::link::{Board, Column, LinkError, Losses, Row, columns, fields};
use haptic::recorder::Recorder;
use haptic_bridge::board::telemetry::Fields;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

/// Show telemetry, or record it to a CSV file
///
/// Fields: usual, all, or any of q, qd, tip, torque, current, duty, distance, velocity, force, shaping, energy,
/// passivity, bus, counts, state. Losses are counted exactly and shown. A recording that is cut short (unplugged,
/// killed, disk full) is whole up to its last line.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Record to this CSV file instead of the terminal
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Fields, separated by commas
    #[arg(long, value_name = "NAMES", default_value = "usual", value_parser = fields)]
    fields: Fields,
    /// Rows per second, at most the control rate [default: 10 on the terminal, 1000 to a file]
    #[arg(long, value_name = "HZ", value_parser = positive)]
    rate: Option<f64>,
    /// Switch the motors on once rows come, and off at the end
    #[arg(long)]
    arm: bool,
    /// Stop after so many seconds of the board's time [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    seconds: Option<f64>,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) => Err("must be greater than zero".into()),
        Err(_) => Err("not a number".into()),
    }
}

/// Where rows go.
enum Sink {
    Terminal { columns: Vec<Column>, since_header: usize },
    File(Box<Recorder>),
}

/// Streams until the time is over, Ctrl-C, or the board goes away.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let details = board.details()?;
    let axes = board.device()?.map_or(0, |device| device.axes());
    let rate_hz = f64::from(details.rate_hz);
    let wanted = args.rate.unwrap_or(if args.csv.is_some() { 1000.0 } else { 10.0 });
    let divider = (rate_hz / wanted).round().clamp(1.0, f64::from(u32::MAX)) as u32;
    let columns = columns(args.fields, axes);
    let mut sink = match &args.csv {
        None => Sink::Terminal { columns, since_header: usize::MAX },
        Some(path) => {
            let about = format!(
                "haptic-bridge recording\nboard {} {}\ndevice {}\ncontrol rate {rate_hz} Hz, every {divider}th step",
                board.info().board,
                board.info().serial,
                details.device.as_deref().unwrap_or("none"),
            );
            let mut names = vec!["step".to_string(), "time_s".to_string()];
            names.extend(columns.into_iter().map(|column| column.label));
            Sink::File(Box::new(Recorder::create(path, &about, &names)?))
        }
    };
    let stop = interrupt::watch();
    board.keep_alive();
    board.start_stream(args.fields, divider)?;
    if args.arm {
        board.arm()?;
    }
    let mut follow = Follow { rate_hz, first_step: None, shown: Losses::default(), last_note: board.now() };
    let ended = loop {
        if stop.is_set() {
            break Ended::AsAsked;
        }
        match board.rows(Duration::from_millis(200)) {
            Err(error) => break Ended::BoardLost(error),
            Ok(rows) => {
                for record in board.take_reported_faults() {
                    eprintln!("fault: {}", fault_in_words(&record, details.rate_hz));
                }
                let over = follow.take(&rows, &mut sink, args.seconds);
                match over.and_then(|over| follow.note(&board, &mut sink).map(|()| over)) {
                    Ok(false) => {}
                    Ok(true) => break Ended::AsAsked,
                    Err(failure) => break Ended::NoRoom(failure),
                }
            }
        }
    };
    // Motors first: what may go wrong with a file comes after that.
    let disarmed = match ended {
        Ended::BoardLost(_) => Ok(()),
        _ if args.arm => board.disarm(),
        _ => Ok(()),
    };
    finish(ended, board, sink, args.csv).and(disarmed.map_err(Failure::from))
}

/// How the stream came to its end.
enum Ended {
    AsAsked,
    BoardLost(LinkError),
    NoRoom(Failure),
}

/// The stream as it goes by.
struct Follow {
    rate_hz: f64,
    first_step: Option<u32>,
    shown: Losses,
    last_note: Duration,
}

impl Follow {
    /// Passes rows on; true when the time is over.
    fn take(&mut self, rows: &[Row], sink: &mut Sink, seconds: Option<f64>) -> Result<bool, Failure> {
        for row in rows {
            let first = *self.first_step.get_or_insert(row.step);
            let time = f64::from(row.step.wrapping_sub(first)) / self.rate_hz;
            if seconds.is_some_and(|seconds| time >= seconds) {
                return Ok(true);
            }
            sink.row(row, time)?;
        }
        Ok(false)
    }

    /// Twice a second: what is recorded is put on disk, and new losses are said.
    fn note(&mut self, board: &Board, sink: &mut Sink) -> Result<(), Failure> {
        let now = board.now();
        if now.saturating_sub(self.last_note) < Duration::from_millis(500) {
            return Ok(());
        }
        self.last_note = now;
        let losses = board.losses();
        if let Sink::File(recorder) = sink {
            recorder.flush()?;
            if std::io::stderr().is_terminal() {
                eprint!("\r{losses}   ");
            }
        } else if losses.missing > self.shown.missing || losses.garbled > self.shown.garbled {
            eprintln!("{losses}");
        }
        self.shown = losses;
        Ok(())
    }
}

impl Sink {
    fn row(&mut self, row: &Row, time: f64) -> Result<(), Failure> {
        match self {
            Self::File(recorder) => {
                let mut values = vec![f64::from(row.step), time];
                values.extend(&row.values);
                recorder.row(&values)
            }
            Self::Terminal { columns, since_header } => {
                let mut text = String::new();
                if *since_header >= 30 {
                    *since_header = 0;
                    text.push_str(&format!("{:>10}", "time_s"));
                    for column in columns.iter() {
                        text.push_str(&format!(" {:>13}", column.label));
                    }
                    text.push('\n');
                }
                *since_header += 1;
                text.push_str(&format!("{time:>10.3}"));
                for value in &row.values {
                    // Counts and states are whole numbers, everything else is shown to five digits.
                    let shown = if value.fract() == 0.0 && value.abs() >= 1.0 {
                        format!("{value:.0}")
                    } else {
                        format!("{value:.5}")
                    };
                    text.push_str(&format!(" {shown:>13}"));
                }
                text.push('\n');
                let written = std::io::stdout().lock().write_all(text.as_bytes());
                written.map_err(|error| Failure::impossible(format!("standard output cannot be written: {error}")))
            }
        }
    }
}

/// Stops the stream and says what came of it.
fn finish(ended: Ended, mut board: Board, sink: Sink, csv: Option<PathBuf>) -> Result<(), Failure> {
    let stopped = match ended {
        Ended::BoardLost(_) => Ok(()),
        _ => board.stop_stream(),
    };
    let losses = board.losses();
    let mut kept = String::new();
    let mut written = Ok(());
    if let (Sink::File(mut recorder), Some(path)) = (sink, csv) {
        written = recorder.flush();
        kept = format!("{} rows are in {}", recorder.rows(), path.display());
        if std::io::stderr().is_terminal() {
            eprintln!();
        }
        eprintln!("{kept}");
    }
    eprintln!("received {losses}");
    match ended {
        Ended::NoRoom(failure) => Err(failure),
        Ended::BoardLost(error) if kept.is_empty() => Err(error.into()),
        Ended::BoardLost(error) => Err(Failure::impossible(error).remedy(kept)),
        Ended::AsAsked => written.and(stopped.map_err(Failure::from)),
    }
}
