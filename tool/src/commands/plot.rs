//! `haptic plot`: draws pictures of a recording, suitable for a paper.

use super::answer::Pictures;
use super::port::counted;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::render::scene::Scene;
use haptic_host::device_file::DeviceFile;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::link::columns;
use haptic_host::words::short;
use haptic_predict::plausible::scene::contact_limits_at;
use haptic_show::plot::signals::{Analysis, Request, View, draw, panels};
use haptic_show::recorder::Recording;
use haptic_stability::analysis::prediction::Subject;
use std::path::PathBuf;

/// Draw a recording: signals over time, force over penetration, spectrum, phase
///
/// Prints the results in numbers; --svg and --png draw the recording, with --width for a column of a paper. A lost row
/// is a gap in every curve.
#[derive(clap::Args)]
pub struct Args {
    /// Recording: .mcap or .csv
    file: PathBuf,
    /// Views, separated by commas: time, force, spectrum, phase [default: all for which the recording has columns]
    #[arg(long, value_name = "VIEWS", value_parser = parse_views)]
    show: Option<Views>,
    /// Columns to draw over time and as a spectrum, separated by commas [default: rendered_n]
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',')]
    signals: Vec<String>,
    /// Start time in the recording, s
    #[arg(long, value_name = "SECONDS")]
    from: Option<f64>,
    /// End time in the recording, s
    #[arg(long, value_name = "SECONDS")]
    to: Option<f64>,
    /// Device file of the recorded device, for the stiffness that a hand feels behind its transmissions
    #[arg(long, value_name = "FILE")]
    device: Option<PathBuf>,
    /// Print one JSON document: the numbers, and every drawn point
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pictures: Pictures,
}

#[derive(Clone, Debug)]
struct Views(Vec<View>);

fn parse_views(text: &str) -> Result<Views, String> {
    let view = |name: &str| {
        let known = View::ALL.iter().find(|(known, _)| *known == name.trim()).map(|(_, view)| *view);
        known.ok_or_else(|| format!("write one or more of {}", View::ALL.map(|(name, _)| name).join(", ")))
    };
    text.split(',').map(view).collect::<Result<Vec<View>, String>>().map(Views)
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.pictures.check()?;
    let recording = Recording::load(&args.file)?;
    let has_views = args.show.is_some();
    let request = Request {
        views: args.show.map_or(Vec::new(), |views| views.0),
        signals: args.signals,
        from: args.from,
        to: args.to,
    };
    let analysis = panels(&recording, &request)?;
    if args.pictures.is_requested() {
        let value = |word: &str| recording.header_value(word).unwrap_or("unknown");
        let title = format!("{} in contact with a wall, recorded {}", value("device"), value("date"));
        let walls: Vec<String> = recording.about.iter().filter(|line| line.starts_with("wall ")).cloned().collect();
        let mut subtitle = vec![format!("board {}; control rate {}", value("board"), value("control rate"))];
        subtitle.extend(walls.into_iter().take(3));
        let mut drawn = analysis.clone();
        if args.pictures.paper().is_printed() && !has_views {
            // A column of a paper has room for two views.
            drawn.panels.retain(|panel| matches!(panel.view, View::Time | View::Force));
        }
        let picture = draw(&title, &subtitle, &drawn, args.pictures.paper());
        args.pictures.save(&picture)?;
    }
    let device = args.device.as_ref().map(DeviceFile::load).transpose()?;
    let felt = match (&device, analysis.stiffness) {
        (Some(device), Some(stiffness)) => felt_stiffness(&recording, device, stiffness)?,
        _ => None,
    };
    if args.json {
        return print_json(&Document { found: &analysis, felt });
    }
    print(&readable(&recording, &analysis, felt))
}

#[derive(serde::Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    found: &'a Analysis,
    /// Stiffness that a hand at the tip felt, N/m; `None` if no transmission is compliant.
    #[serde(skip_serializing_if = "Option::is_none")]
    felt: Option<f64>,
}

/// Returns the stiffness (N/m) that a hand felt at the mean pose in contact, for a stiffness at the encoders.
fn felt_stiffness(recording: &Recording, file: &DeviceFile, stiffness: f64) -> Result<Option<f64>, Failure> {
    let lacks = |what: &str| {
        Failure::wrong(format!("--device {} does not apply: the recording has no {what}", file.path.display()))
            .remedy("record one wall of that device with haptic record, or leave --device out")
    };
    recording.header_value("device").filter(|name| *name == file.name).ok_or_else(|| lacks(&file.name))?;
    let scene: Option<Scene<f64>> = recording.header_value("scene").and_then(|scene| serde_json::from_str(scene).ok());
    let mut scene = scene.filter(|scene| scene.walls.len() == 1).ok_or_else(|| lacks("scene of one wall"))?;
    scene.walls[0].stiffness = stiffness;
    let column = |name: &str| recording.column(name).ok_or_else(|| lacks(name));
    let distance = column("distance_m")?;
    let touched: Vec<&Vec<f64>> = recording.rows.iter().filter(|row| row[distance] < 0.0).collect();
    let mean = |column: usize| touched.iter().map(|row| row[column]).sum::<f64>() / touched.len() as f64;
    let joints = columns(Fields(Field::Angle.bit()), &file.description.units(), 0);
    let q: Vec<f64> = joints.iter().map(|joint| column(&joint.label).map(mean)).collect::<Result<_, _>>()?;
    let subject = Subject::new(&file.description).map_err(Failure::wrong)?;
    Ok(contact_limits_at(&subject, &scene, 0, &q, &subject.torque_path(scene.rate_hz)).and_then(|contact| contact.felt))
}

fn readable(recording: &Recording, found: &Analysis, felt: Option<f64>) -> String {
    let mut text = format!("{} over {:.3} s", counted(found.rows, "row"), found.seconds);
    if found.missing > 0 {
        text.push_str(&format!(", {} missing between them", counted(found.missing, "row")));
    }
    if recording.torn {
        text.push_str("; the file is cut short after them");
    }
    text.push('\n');
    for panel in &found.panels {
        let curves: Vec<&str> = panel.curves.iter().map(|curve| curve.name.as_str()).collect();
        let note = if panel.note.is_empty() { String::new() } else { format!(": {}", panel.note) };
        text.push_str(&format!("  {} over {}, of {}{note}\n", panel.y.name, panel.x.name, curves.join(", ")));
    }
    match found.stiffness {
        Some(stiffness) => {
            let felt = felt.map_or(String::new(), |felt| format!(" (felt at the tip: {} N/m)", short(felt as f32)));
            text.push_str(&format!("stiffness found: {} N/m{felt}\n", short(stiffness as f32)));
        }
        None if found.contact_rows > 0 => text.push_str("stiffness found: none\n"),
        None => {}
    }
    found.said.iter().for_each(|line| text.extend([line, "\n"]));
    text
}
