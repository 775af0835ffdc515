//! `haptic plot`: pictures of a recording, fit for a paper.

use super::answer::Pictures;
use super::port::counted;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::words::short;
use haptic_show::plot::signals::{Found, Request, View, draw, panels};
use haptic_show::recorder::Recording;
use std::path::PathBuf;

/// Draw a recording: signals over time, force over penetration, spectrum, phase
///
/// Prints what the recording says in numbers; --svg and --png draw it, with --width for a column of a paper. A row that
/// was lost is a gap in every curve.
#[derive(clap::Args)]
pub struct Args {
    /// A recording: .mcap or .csv
    file: PathBuf,
    /// What to draw, separated by commas: time, force, spectrum, phase [default: what the recording has the columns
    /// for]
    #[arg(long, value_name = "VIEWS", value_parser = views)]
    show: Option<Views>,
    /// Columns to draw over time and as a spectrum, separated by commas [default: rendered_n]
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',')]
    signals: Vec<String>,
    /// From this time of the recording on, s
    #[arg(long, value_name = "SECONDS")]
    from: Option<f64>,
    /// To this time, s
    #[arg(long, value_name = "SECONDS")]
    to: Option<f64>,
    /// Print one JSON document: the numbers, and every point that is drawn
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(Clone, Debug)]
struct Views(Vec<View>);

fn views(text: &str) -> Result<Views, String> {
    let view = |name: &str| {
        let known = View::ALL.iter().find(|(known, _)| *known == name.trim()).map(|(_, view)| *view);
        known.ok_or_else(|| format!("write some of {}", View::ALL.map(|(name, _)| name).join(", ")))
    };
    text.split(',').map(view).collect::<Result<Vec<View>, String>>().map(Views)
}

/// Reads, prints and draws.
pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let recording = Recording::load(&args.file)?;
    let request = Request {
        views: args.show.map_or(Vec::new(), |views| views.0),
        signals: args.signals,
        from: args.from,
        to: args.to,
    };
    let found = panels(&recording, &request)?;
    if args.pictures.asked() {
        let told = |word: &str| recording.told(word).unwrap_or("unknown");
        let title = format!("{}, {}", told("device"), told("date"));
        let walls: Vec<String> = recording.about.iter().filter(|line| line.starts_with("wall ")).cloned().collect();
        let mut subtitle = vec![format!("board {}; control rate {}", told("board"), told("control rate"))];
        subtitle.extend(walls.into_iter().take(3));
        let picture = draw(&title, &subtitle, &found, args.pictures.paper());
        args.pictures.save(&picture)?;
    }
    if args.json {
        return print_json(&found);
    }
    print(&readable(&recording, &found))
}

fn readable(recording: &Recording, found: &Found) -> String {
    let mut text = format!("{} over {:.3} s", counted(found.rows, "row"), found.seconds);
    if found.missing > 0 {
        text.push_str(&format!(", {} missing between them", counted(found.missing, "row")));
    }
    if recording.torn {
        text.push_str("; the file is cut short behind them");
    }
    text.push('\n');
    for panel in &found.panels {
        let of: Vec<&str> = panel.curves.iter().map(|curve| curve.name.as_str()).collect();
        let note = if panel.note.is_empty() { String::new() } else { format!(": {}", panel.note) };
        text.push_str(&format!("  {} over {}, of {}{note}\n", panel.y.name, panel.x.name, of.join(", ")));
    }
    match found.stiffness {
        Some(stiffness) => text.push_str(&format!("stiffness that was there: {} N/m\n", short(stiffness as f32))),
        None if found.contact_rows > 0 => text.push_str("stiffness that was there: none\n"),
        None => {}
    }
    found.said.iter().for_each(|line| text.extend([line, "\n"]));
    text
}
