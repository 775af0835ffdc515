//! `haptic report`: a device on two pages, each number with the command that prints it.

use super::answer::DOCUMENT;
use super::arguments::{self, Numbers};
use super::continued::Continue;
use super::force::ForceOption;
use haptic_bridge::render::scene::{DEFAULT_RATE_HZ, FeedForward};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Failure, print};
use haptic_host::output;
use haptic_host::scene_file::{DEFAULT_CUTOFF_HZ, SceneFile};
use haptic_host::words::{percent, with_unit};
use haptic_predict::design::place::directions;
use haptic_predict::plausible::scene::file_warnings;
use haptic_stability::analysis::control_loop::Loop;
use haptic_stability::analysis::prediction::{self, Prediction};
use haptic_stability::analysis::range::WORTHWHILE_RATIO;
use haptic_stability::analysis::sampled::LinearEstimator;
use haptic_stability::analysis::several::Member;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Write a report about a device: the stiffest wall, its limits, the benefit of the feed-forward, improvements
///
/// The first page answers these questions, with a picture of the device and the command that prints each number. The
/// second page has the pictures. On a screen the complete output of each command unfolds. It is one HTML file without
/// other files, to read offline or to print on two pages. Predictions and simulations are for the device in the file.
/// With SCENE the wall is the first wall of the scene. Ctrl-C ends it, and with --continue the same command continues
/// from there.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Scene file (TOML)
    scene: Option<PathBuf>,
    /// File for the page
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// Joint angles in rad, travels in m, such as 2.4,0.7 [default: where the scene's wall is touched, or the device
    /// file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
    /// Normal of the wall, of any length [default: the scene's, or the direction with the largest benefit of the
    /// feed-forward at the pose]
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Option<Numbers>,
    /// Leave these parts out; tune takes longest
    #[arg(long, value_name = "PART", value_delimiter = ',')]
    without: Vec<Part>,
    #[command(flatten)]
    continued: Continue,
    #[command(flatten)]
    force: ForceOption,
}

/// A part of the page that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// The best settings
    Tune,
    /// The best place, direction and links
    Design,
    /// The map
    Map,
}

/// A section of the page: one command and its output.
#[derive(Clone, Debug)]
struct Section {
    title: &'static str,
    /// Caption of the picture.
    about: &'static str,
    words: Vec<String>,
    /// File name of the picture, if the command draws one.
    picture: Option<&'static str>,
}

#[derive(Clone, Debug, Default, Deserialize, Serialize)]
struct Output {
    text: String,
    notes: String,
    picture: Option<String>,
    /// The result as JSON; null if the command failed.
    document: Value,
}

struct Values {
    q: String,
    normal: String,
    rate: String,
    cutoff: String,
    washout: Option<String>,
    /// Options with which `haptic range DEVICE` predicts the wall in its scene.
    options: String,
}

pub fn run(args: Args) -> Result<(), Failure> {
    output::check(&args.out, args.force.overwrite())?;
    let file = DeviceFile::load(&args.device)?;
    let values = page_values(&args, &file)?;
    let sections = sections(&args, &values);
    let scene = args.scene.as_ref().map(|path| SceneFile::load(path, file.spec().task)).transpose()?;
    let scene = scene.map(|file| file.scene);
    let lines: Vec<_> = sections.iter().map(Section::line).collect();
    let question = format!("{lines:?} {:?} {scene:?}", file.description);
    let sweep = args.continued.sweep("report", &question)?;
    let tool = std::env::current_exe().map_err(Failure::impossible)?;
    let outputs = sweep.map("parts", &sections, |section| Ok(section.run(&tool)))?;
    let page = page(&file.name, &args, &sections, &outputs);
    output::write(&args.out, page.as_bytes(), args.force.overwrite())?;
    let failed = outputs.iter().filter(|output| output.document.is_null()).count();
    let failures = if failed > 0 { format!(", {failed} of them failed") } else { String::new() };
    print(&format!("{}: {} parts{failures}\n", args.out.display(), sections.len()))?;
    sweep.finish();
    Ok(())
}

/// Formats numbers with up to six decimals, without trailing zeros.
fn option_value(values: &[f64]) -> String {
    let rounded = values.iter().map(|value| (value * 1e6).round() / 1e6 + 0.0);
    rounded.map(|value| value.to_string()).collect::<Vec<_>>().join(",")
}

fn page_values(args: &Args, file: &DeviceFile) -> Result<Values, Failure> {
    let spec = file.spec();
    let scene = args.scene.as_ref().map(|path| SceneFile::load(path, spec.task)).transpose()?.map(|file| file.scene);
    let device = prediction::Subject::new(&file.description).map_err(Failure::wrong)?;
    let touched = scene.as_ref().and_then(|scene| {
        let (_, contacts) = file_warnings(&device, scene);
        contacts.into_iter().find(|contact| contact.wall == 0)
    });
    let q = match (&args.q, &touched) {
        (None, Some(contact)) => contact.q.clone(),
        (q, _) => arguments::pose(q.as_ref(), file)?,
    };
    let normal = match (&args.normal, &touched) {
        (Some(normal), _) => normal.unit(spec.task, "--normal")?,
        (None, Some(contact)) => contact.normal.clone(),
        (None, None) => directions(&file.description, &q, Default::default())?.feed_forward_buys_most.normal,
    };
    let wall = scene.as_ref().and_then(|scene| scene.walls.first());
    let rate = scene.as_ref().map_or(DEFAULT_RATE_HZ, |scene| scene.rate_hz);
    let cutoff = scene.as_ref().map_or(DEFAULT_CUTOFF_HZ, |scene| scene.cutoff_hz);
    let path = device.torque_path(rate);
    let in_scene = scene.as_ref().and_then(|scene| Prediction::in_scene(&device, scene, wall, &path));
    let prediction = in_scene.unwrap_or_else(|| {
        // Shows the usual estimator in place of one without a linear analysis.
        Prediction::new(device.clone(), Loop::with_torque_path(&path, rate, LinearEstimator::Butterworth(cutoff)))
    });
    let rounded = |values: &[f64]| values.iter().map(|value| (value * 1e6).round() / 1e6 + 0.0).collect::<Vec<_>>();
    let (q, normal) = (rounded(&q), rounded(&normal));
    Ok(Values {
        options: prediction.options(&q, &[Member::new(normal.clone(), 1.0)]),
        q: option_value(&q),
        normal: option_value(&normal),
        rate: option_value(&[rate]),
        cutoff: option_value(&[cutoff]),
        washout: wall
            .filter(|wall| wall.feed_forward == FeedForward::Washout)
            .map_or(Some("2".into()), |wall| Some(option_value(&[wall.washout_hz]))),
    })
}

fn sections(args: &Args, values: &Values) -> Vec<Section> {
    let device = args.device.display().to_string();
    let scene = args.scene.as_ref().map(|scene| scene.display().to_string());
    let Values { q, normal, rate, cutoff, washout, options } = values;
    let (q, normal) = (format!("--q={q}"), format!("--normal={normal}"));
    let mut sections = Vec::new();
    let mut add = |title, about, picture, words: &[&str]| {
        sections.push(Section { title, about, picture, words: words.iter().map(|word| (*word).to_string()).collect() });
    };
    let mut check = vec!["check", &device];
    check.extend(scene.as_deref());
    add("Device", "The device at home.", Some("device.svg"), &check);
    if !args.without.contains(&Part::Tune) {
        let tune = ["tune", &device, &q, &normal, "--rates", rate];
        add("Stiffest wall", "Stability is predicted, ripple is simulated.", None, &tune);
    }
    let mut range = vec!["range", &device];
    range.extend(options.split(' '));
    if let Some(washout) = washout {
        range.extend(["--washout", washout]);
    }
    add(
        "Stable walls",
        "Walls below a line are predicted stable, with a board's drive and delay. Friction makes the measured range larger.",
        Some("range.svg"),
        &range,
    );
    range.push("--why");
    add("Limits", "The stiffest wall without one effect, for each effect in turn.", Some("why.svg"), &range);
    if !args.without.contains(&Part::Map) {
        add("Workspace", "Share of the inertia that coupling takes.", Some("map.svg"), &["map", &device, &normal]);
    }
    if !args.without.contains(&Part::Design) {
        add(
            "Improvements",
            "Inertia by direction, and the motion after a push.",
            Some("design.svg"),
            &["design", &device, &q, &normal, "--rate", rate, "--cutoff", cutoff],
        );
    }
    sections
}

impl Section {
    fn line(&self) -> String {
        let quoted = |word: &String| match word.chars().all(|c| c.is_ascii_alphanumeric() || "-_./=,+:".contains(c)) {
            true => word.clone(),
            false => format!("'{}'", word.replace('\'', "'\\''")),
        };
        let mut line = format!("haptic {}", self.words.iter().map(quoted).collect::<Vec<_>>().join(" "));
        if let Some(picture) = self.picture {
            let _ = write!(line, " --svg {picture} --width {COLUMN_MM}");
        }
        line
    }

    fn run(&self, tool: &Path) -> Output {
        let folder = match tempfile::tempdir() {
            Ok(folder) => folder,
            Err(error) => return Output { notes: error.to_string(), ..Output::default() },
        };
        let picture = self.picture.map(|name| folder.path().join(name));
        let document = folder.path().join("document.json");
        let mut command = Command::new(tool);
        command.args(&self.words).stdin(Stdio::null()).env(haptic_stability::sweep::QUIET_VARIABLE, "1");
        command.env(DOCUMENT, &document);
        if let Some(picture) = &picture {
            command
                .arg("--svg")
                .arg(picture)
                .args(["--width", COLUMN_MM])
                .arg("--caption")
                .arg(folder.path().join("caption"));
        }
        match command.output() {
            Ok(output) => Output {
                text: String::from_utf8_lossy(&output.stdout).into_owned(),
                notes: String::from_utf8_lossy(&output.stderr).into_owned(),
                picture: picture.and_then(|path| std::fs::read_to_string(path).ok()),
                document: std::fs::read_to_string(document)
                    .ok()
                    .filter(|_| output.status.success())
                    .and_then(|text| serde_json::from_str(&text).ok())
                    .unwrap_or_default(),
            },
            Err(error) => Output { notes: error.to_string(), ..Output::default() },
        }
    }
}

/// Width of a picture, mm: two columns fit on a page.
const COLUMN_MM: &str = "85";

/// Escapes text for HTML.
fn escape_html(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Converts an SVG document for a page with several pictures: with unique ids and without a namespace declaration.
fn inline_svg(svg: &str, number: usize) -> String {
    svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "")
        .replace("id=\"clip", &format!("id=\"p{number}clip"))
        .replace("url(#clip", &format!("url(#p{number}clip"))
}

const PAGE_STYLE: &str = ":root{color-scheme:light dark}body{font:1rem/1.4 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}\
    h1{font-size:1.5rem;margin:0}h2{font-size:1.05rem;margin:.2rem 0}p{margin:.3rem 0}figure{margin:.5rem 0}\
    svg{width:100%;height:auto;background:#fff}.device{max-width:26rem}table{border-collapse:collapse}\
    th,td{text-align:left;vertical-align:top;padding:.35rem .8rem .35rem 0;border-top:1px solid #8888}th{width:11rem}\
    main{display:grid;grid-template-columns:repeat(auto-fit,minmax(20rem,1fr));gap:1rem 2rem;margin-top:2rem}\
    pre{font-size:.7rem;overflow-x:auto}code{font-size:.75rem;overflow-wrap:anywhere}\
    @media print{body{margin:0;max-width:none;font-size:10pt}main{grid-template-columns:1fr 1fr;break-before:page;margin:0;gap:.5rem 2rem}\
    section{break-inside:avoid}figure{margin:0}code{font-size:7pt}details{display:none}.device{max-width:100mm}}";

/// Returns the answers of the first page, each with its question and the title of the section that has the details.
fn answers(sections: &[Section], outputs: &[Output]) -> Vec<(&'static str, String, &'static str)> {
    let output = |title: &str| sections.iter().zip(outputs).find(|(section, _)| section.title == title);
    let document = |title: &str| output(title).map(|(_, output)| &output.document);
    let number = |title: &str, place: &str| document(title)?.pointer(place)?.as_f64();
    let words = |title: &str, place: &str| document(title)?.pointer(place)?.as_str();
    let stiff = |title: &str, place: &str| number(title, place).map(|kp| with_unit(kp, "N/m"));
    let mut answers = Vec::new();
    let mut add = |question, answer: Option<String>, title| answers.extend(answer.map(|text| (question, text, title)));
    let force = |end: &str| number("Device", &format!("/summary/force_at_home/{end}"));
    add(
        "Force",
        force("low").zip(force("high")).map(|(low, high)| {
            format!(
                "At home the motors make {} to {} at the tip, by direction.",
                with_unit(low, "N"),
                with_unit(high, "N")
            )
        }),
        "Device",
    );
    let felt = stiff("Stiffest wall", "/best/felt").map_or(String::new(), |felt| format!(" (felt at the tip: {felt})"));
    add("Stiffest wall", stiff("Stiffest wall", "/best/stiffness").and_then(|stiffness| {
        Some(format!(
            "{stiffness}{felt} with {} at {:.0} Hz, feed-forward {}, ripple {} rms. A stiffer wall is limited by: {}.",
            with_unit(number("Stiffest wall", "/best/damping")?, "N s/m"),
            number("Stiffest wall", "/best/rate_hz")?,
            words("Stiffest wall", "/best/feed_forward")?,
            with_unit(number("Stiffest wall", "/best/ripple_n")?, "N"),
            words("Stiffest wall", "/active")?
        ))
    }), "Stiffest wall");
    add(
        "The scene's wall",
        stiff("Device", "/scenes/0/contacts/0/stiffness").and_then(|stiffness| {
            let ripple = number("Device", "/scenes/0/contacts/0/ripple_n");
            let ripple = ripple
                .map_or(String::new(), |ripple| format!(" In a hand it ripples by {} rms.", with_unit(ripple, "N")));
            let to = stiff("Device", "/scenes/0/contacts/0/stable_to")?;
            Some(format!("{stiffness}, predicted stable up to {to} with its damping.{ripple}"))
        }),
        "Device",
    );
    let effects = document("Limits").and_then(|limits| limits.pointer("/why/effects")?.as_array());
    let taken = |effect: &Value| effect.pointer("/takes/off").and_then(Value::as_f64).unwrap_or(0.0);
    let worst = effects.and_then(|all| all.iter().max_by(|a, b| taken(a).total_cmp(&taken(b))));
    add("Limit of stability", stiff("Limits", "/why/limits/off/kp_max").zip(worst).and_then(|(stiffness, effect)| {
        Some(format!(
            "Without ripple and margins, walls are stable up to {stiffness}. Most of all it is limited by: {}, which takes {} \
             of the stiffness ({}).",
            effect["effect"].as_str()?,
            percent(taken(effect), 0, false),
            effect["instead"].as_str()?
        ))
    }), "Limits");
    let everywhere = output("Workspace").and_then(|(_, output)| output.text.lines().last());
    add(
        "Feed-forward",
        number("Stable walls", "/area_ratio").map(|ratio| {
            let here = format!("At this pose and normal it makes the stable area {ratio:.2} times as large");
            let worth = if ratio < WORTHWHILE_RATIO { ": leave it off here" } else { "" };
            let place = number("Improvements", "/places/feed_forward_buys_most/w_rr")
                .zip(number("Improvements", "/places/feed_forward_buys_most/w_eff"));
            let most = place.map_or(String::new(), |(with, without)| {
                format!(" Where it gains most, a wall meets {:.2} times the inertia.", with / without)
            });
            format!("{here}{worth}. Over the workspace: {}{most}", everywhere.unwrap_or("not mapped."))
        }),
        "Workspace",
    );
    add(
        "Improve first",
        words("Improvements", "/buys_most/0/part").and_then(|part| {
            let more = document("Improvements")?.pointer("/buys_most/0/more")?.as_bool()?;
            let gain = percent(number("Improvements", "/buys_most/0/effect/off")? - 1.0, 1, true);
            let more = if more { "more" } else { "less" };
            Some(format!("A tenth {more} {part}: {gain} for the stiffest wall without the feed-forward."))
        }),
        "Improvements",
    );
    answers
}

fn page(name: &str, args: &Args, sections: &[Section], outputs: &[Output]) -> String {
    let scene = args.scene.as_ref().map_or(String::new(), |scene| format!(" with {}", scene.display()));
    let device = &outputs[0].document;
    let mechanism = device["mechanism"].as_str().map_or(String::new(), |kind| format!("a {kind}: "));
    let about = format!(
        "{mechanism}{}{scene}, by haptic {}, {}. Predicted and simulated: nothing was measured on a real device.",
        args.device.display(),
        env!("CARGO_PKG_VERSION"),
        output::date()
    );
    let anchor = |title: &str| title.to_lowercase().replace(' ', "-");
    let figure = |index: usize| {
        outputs[index]
            .picture
            .as_ref()
            .map_or(String::new(), |svg| format!("<figure>{}</figure>\n", inline_svg(svg, index)))
    };
    let name = escape_html(name);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<title>{name}</title>\n\
         <meta name=\"viewport\" content=\"width=device-width\"/>\n<style>{PAGE_STYLE}</style>\n</head>\n<body>\n\
         <h1>{name}</h1>\n<p>{}</p>\n<div class=\"device\">{}</div>\n<table>\n",
        escape_html(&about),
        figure(0)
    );
    for (question, answer, title) in answers(sections, outputs) {
        let (answer, to) = (escape_html(&answer), anchor(title));
        let _ = writeln!(page, "<tr><th>{question}</th><td>{answer} <a href=\"#{to}\">{title}</a></td></tr>");
    }
    page.push_str("</table>\n<main>\n");
    for (index, (section, output)) in sections.iter().zip(outputs).enumerate() {
        let _ = write!(
            page,
            "<section id=\"{}\">\n<h2>{}</h2>\n{}<p>{}</p>\n<code>{}</code>\n",
            anchor(section.title),
            section.title,
            if index == 0 { String::new() } else { figure(index) },
            section.about,
            escape_html(&section.line())
        );
        let _ = writeln!(
            page,
            "<details><summary>All numbers</summary><pre>{}{}</pre></details>",
            escape_html(&output.notes),
            escape_html(&output.text)
        );
        page.push_str("</section>\n");
    }
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::help;
    use clap::Parser;

    #[derive(clap::Parser)]
    struct CommandLine {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn every_command_line_on_the_page_parses() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut lines = 0;
        for (device, scene) in [
            ("haply-2diy", Some("wall-stiff")),
            ("phantom-premium-1.5", Some("ramp")),
            ("hapkit-paddle", None),
            ("serial-3r", None),
            ("fictive-five-bar-turret", Some("ball")),
        ] {
            let path = |name: String| root.join(name).display().to_string();
            let mut words = vec!["haptic".to_string(), path(format!("devices/{device}.toml"))];
            words.extend(scene.map(|scene| path(format!("devices/scenes/{device}/{scene}.toml"))));
            let args = CommandLine::parse_from(words).args;
            let file = DeviceFile::load(&args.device).unwrap();
            let values = page_values(&args, &file).unwrap();
            for section in sections(&args, &values) {
                // Splits as a shell does, because no path here needs quotes.
                let line = section.line();
                if let Err(error) = help::command().try_get_matches_from(line.split(' ')) {
                    panic!("{}: {error}", section.line());
                }
                lines += 1;
            }
        }
        assert!(lines == 30, "{lines}");
    }

    #[test]
    fn words_with_shell_characters_are_quoted() {
        let words = vec!["check".into(), "my device's.toml".into()];
        let section = Section { title: "", about: "", words, picture: None };
        assert_eq!(section.line(), r"haptic check 'my device'\''s.toml'");
    }
}
