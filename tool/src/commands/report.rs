//! `haptic report`: everything about a device on one page, each number with the command that prints it.

use super::arguments::{self, Numbers};
use super::continued::Continue;
use super::force::ForceOption;
use haptic_bridge::render::scene::{DEFAULT_RATE_HZ, FeedForward};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Failure, print};
use haptic_host::output;
use haptic_host::scene_file::{DEFAULT_CUTOFF_HZ, SceneFile};
use haptic_predict::design::place::directions;
use haptic_predict::plausible::scene::{default_hand, file_warnings};
use haptic_stability::analysis::control_loop::{Loop, TorquePath};
use haptic_stability::analysis::prediction::{self, Prediction};
use haptic_stability::analysis::sampled::LinearEstimator;
use haptic_stability::analysis::several::Member;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Write one page with everything about a device: its model, the walls that it renders, possible improvements
///
/// The page has the description of the file, the largest force, the model, the map, the range of stable walls and its
/// limiting effects, velocity estimators, the best place, direction and links, and the best settings. It is one HTML
/// file without other files, to read offline or to print. Its numbers are the output of this tool's own commands, and
/// each output has its command line above it. With SCENE the wall is the first wall of the scene. Takes a minute or
/// two; Ctrl-C ends it, and with --continue the same command continues from there.
#[derive(clap::Args)]
pub struct Args {
    /// Device file (TOML)
    device: PathBuf,
    /// Scene file (TOML)
    scene: Option<PathBuf>,
    /// File for the page
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// Joint angles in rad, such as 2.4,0.7 [default: where the scene's wall is touched, or the device file's home]
    #[arg(long, value_name = "A,B,..", allow_hyphen_values = true)]
    q: Option<Numbers>,
    /// Normal of the wall, of any length [default: the scene's, or the direction with the largest benefit of the
    /// feed-forward at the pose]
    #[arg(long, value_name = "X,Y,..", allow_hyphen_values = true)]
    normal: Option<Numbers>,
    /// Leave these parts out; estimators and tune take longest
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
    /// Velocity estimators
    Estimators,
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
    /// Sentence about the subject of the section.
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
    done: bool,
}

struct Values {
    q: String,
    normal: String,
    rate: String,
    cutoff: String,
    washout: Option<String>,
    /// Options with which `haptic range DEVICE` predicts the wall in its scene.
    options: String,
    /// Stiffness and damping of the scene's wall, in the form of `--wall`.
    wall: Option<String>,
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
    let failed = outputs.iter().filter(|output| !output.done).count();
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
    let path = TorquePath::usual(rate);
    let in_scene = scene.as_ref().and_then(|scene| Prediction::in_scene(&device, scene, wall, &path));
    let prediction = in_scene.unwrap_or_else(|| {
        // Shows the usual estimator in place of one without a linear analysis.
        Prediction::new(device.clone(), Loop::with_torque_path(&path, rate, LinearEstimator::Butterworth(cutoff)))
    });
    let rounded = |values: &[f64]| values.iter().map(|value| (value * 1e6).round() / 1e6 + 0.0).collect::<Vec<_>>();
    let (q, normal) = (rounded(&q), rounded(&normal));
    Ok(Values {
        options: prediction.options(&q, &[Member::new(normal.clone(), 1.0)]),
        wall: wall.map(|wall| format!("{},{}", wall.stiffness, wall.damping)),
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
    let Values { q, normal, rate, cutoff, washout, options, wall } = values;
    let (q, normal) = (format!("--q={q}"), format!("--normal={normal}"));
    let mut sections = Vec::new();
    let mut add = |title, about, picture, words: &[&str]| {
        sections.push(Section { title, about, picture, words: words.iter().map(|word| (*word).to_string()).collect() });
    };
    let mut check = vec!["check", &device];
    check.extend(scene.as_deref());
    add(
        "The description of the file, and the largest force",
        "Reach, weight and inertia; force and energy at the tip; what is missing before a real board arms.",
        Some("device.svg"),
        &check,
    );
    add(
        "The model at the pose",
        "Inertia that a wall meets at the pose, and joint torques for a force of 1 N, without and with the feed-forward.",
        None,
        &["model", &device, &q, &normal, "--force", "1"],
    );
    if !args.without.contains(&Part::Map) {
        add(
            "The map",
            "Inertia along the normal over the workspace, and the benefit of the feed-forward.",
            Some("map.svg"),
            &["map", &device, &normal],
        );
    }
    let mut range = vec!["range", &device];
    range.extend(options.split(' '));
    if let Some(washout) = washout {
        range.extend(["--washout", washout]);
    }
    add(
        "The range of stable walls",
        "Predicted with a board's drive and delay: without the feed-forward, with it, and washed out. Friction makes the \
         measured range larger.",
        Some("range.svg"),
        &range,
    );
    let hand = default_hand();
    let hand = format!("{},{},{}", hand.mass, hand.damping, hand.stiffness);
    let mut in_hand = range.clone();
    // A hand with compensated damping cannot be predicted.
    let has_hand = !options.contains("--damping-compensation");
    if has_hand {
        in_hand.extend(["--hand", &hand]);
    }
    in_hand.extend(wall.iter().flat_map(|wall| ["--wall", wall.as_str()]));
    if has_hand || wall.is_some() {
        add(
            "The wall in a hand",
            "Effect of a hand on the range: behind cables it makes the range smaller. With a scene also the ripple of its wall.",
            None,
            &in_hand,
        );
    }
    range.push("--why");
    add(
        "Limiting effects of the range",
        "The same loop without one effect, for each effect in turn.",
        Some("why.svg"),
        &range,
    );
    if !args.without.contains(&Part::Estimators) {
        let mut words = vec!["tune", "estimators", &device, &q, &normal, "--rate", rate, "--cutoff", cutoff];
        words.extend(wall.iter().flat_map(|wall| ["--wall", wall.as_str()]));
        add("Velocity estimators", "Simulated with the device's own encoder steps and friction.", None, &words);
    }
    if !args.without.contains(&Part::Design) {
        add(
            "The best place, direction and links",
            "Searched by the inertia that a wall meets; the stiffest walls are predicted as above.",
            Some("design.svg"),
            &["design", &device, &q, &normal, "--rate", rate, "--cutoff", cutoff],
        );
    }
    if !args.without.contains(&Part::Tune) {
        let mut tune = vec!["tune", &device, &q, &normal];
        if let Some(scene) = &scene {
            tune.extend(["--scene", scene]);
        }
        add(
            "The best settings",
            "The stiffest wall within margins and a ripple: stability predicted, ripple simulated.",
            None,
            &tune,
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
            let _ = write!(line, " --svg {picture}");
        }
        line
    }

    fn run(&self, tool: &Path) -> Output {
        let folder = tempfile::tempdir().ok();
        let picture = folder.as_ref().zip(self.picture).map(|(folder, name)| folder.path().join(name));
        let mut command = Command::new(tool);
        command.args(&self.words).stdin(Stdio::null()).env(haptic_stability::sweep::QUIET_VARIABLE, "1");
        if let Some(picture) = &picture {
            command.arg("--svg").arg(picture);
        }
        match command.output() {
            Ok(output) => Output {
                text: String::from_utf8_lossy(&output.stdout).into_owned(),
                notes: String::from_utf8_lossy(&output.stderr).into_owned(),
                picture: picture.and_then(|path| std::fs::read_to_string(path).ok()),
                done: output.status.success(),
            },
            Err(error) => Output { notes: error.to_string(), ..Output::default() },
        }
    }
}

fn escape_html(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Converts an SVG document for a page with several pictures: with unique ids and without a namespace declaration.
fn inline_svg(svg: &str, number: usize) -> String {
    svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "")
        .replace("id=\"clip", &format!("id=\"p{number}clip"))
        .replace("url(#clip", &format!("url(#p{number}clip"))
}

const PAGE_STYLE: &str = "body{font-family:sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}\
    h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2.2rem;border-top:1px solid #ccc;padding-top:.8rem}\
    pre{font-size:.72rem;overflow-x:auto;background:#f6f6f6;padding:.6rem;white-space:pre}\
    code.line{display:block;background:#eef3f8;padding:.4rem .6rem;font-size:.78rem;overflow-wrap:anywhere}\
    svg{max-width:100%;height:auto}p.notes{font-size:.8rem;color:#7a3b00;white-space:pre-line}li{margin:.15rem 0}\
    @media print{body{margin:0;max-width:none}pre{white-space:pre-wrap;font-size:.6rem}h2{break-after:avoid}\
    section{break-inside:auto}svg{break-inside:avoid}}";

fn page(name: &str, args: &Args, sections: &[Section], outputs: &[Output]) -> String {
    let mut page = String::new();
    let name = escape_html(name);
    let scene = args.scene.as_ref().map_or(String::new(), |scene| format!(" with {}", scene.display()));
    let about = escape_html(&format!(
        "{}{scene}, by haptic {}, {}",
        args.device.display(),
        env!("CARGO_PKG_VERSION"),
        output::date()
    ));
    let _ = write!(
        page,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<title>{name}</title>\n\
         <meta name=\"viewport\" content=\"width=device-width\"/>\n<style>{PAGE_STYLE}</style>\n</head>\n<body>\n\
         <h1>{name}</h1>\n<p>{about}</p>\n\
         <p>Every number on this page is the output of the command above it, run where the page was made. Predictions are for the \
         device in the file; nothing was measured on a real device.</p>\n<ol>\n"
    );
    for section in sections {
        let _ = writeln!(page, "<li>{}</li>", escape_html(section.title));
    }
    page.push_str("</ol>\n");
    for (number, (section, output)) in sections.iter().zip(outputs).enumerate() {
        let _ = write!(
            page,
            "<section>\n<h2>{}. {}</h2>\n<p>{}</p>\n<code class=\"line\">{}</code>\n",
            number + 1,
            escape_html(section.title),
            escape_html(section.about),
            escape_html(&section.line())
        );
        if !output.notes.trim().is_empty() {
            let _ = writeln!(page, "<p class=\"notes\">{}</p>", escape_html(output.notes.trim()));
        }
        if let Some(picture) = &output.picture {
            let _ = writeln!(page, "<figure>\n{}</figure>", inline_svg(picture, number + 1));
        }
        if !output.text.trim().is_empty() {
            let _ = writeln!(page, "<pre>{}</pre>", escape_html(output.text.trim_end()));
        }
        page.push_str("</section>\n");
    }
    page.push_str("</body>\n</html>\n");
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
        assert!(lines > 35, "{lines}");
    }

    #[test]
    fn words_with_shell_characters_are_quoted() {
        let words = vec!["check".into(), "my device's.toml".into()];
        let section = Section { title: "", about: "", words, picture: None };
        assert_eq!(section.line(), r"haptic check 'my device'\''s.toml'");
    }
}
