//! Regenerates the impedance-range and map figures and their section of docs/results.md, by running the very command
//! lines that the section lists: `cargo xtask figures`. It takes some minutes. With names of cases it runs these and
//! prints their rows.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Where the wall is touched: the normal is that of the largest Wrr/Weff at the pose.
const WHERE: &str = "devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787";
/// What linear theory is about.
const BARE: &str = "--frictionless --ideal-drive --counts 8388608 --torque-limit 2";

/// A measured range: its name, which picture it makes if any, and what is added to `haptic measure-range WHERE`.
struct Case {
    name: &'static str,
    picture: Option<&'static str>,
    rate: &'static str,
    world: &'static str,
}

const fn theory(name: &'static str, rate: &'static str) -> Case {
    Case { name, picture: Some(name), rate, world: BARE }
}

const THEORY: [Case; 5] = [
    theory("range-200hz", "--rate 200 --cutoff 20 --pull 0.1"),
    theory("range-1khz", "--rate 1000 --cutoff 20 --pull 0.1"),
    theory("range-10khz", "--rate 10000 --cutoff 200 --pull 0.3"),
    theory("range-20khz", "--rate 20000 --cutoff 500 --pull 0.3"),
    theory("range-50khz", "--rate 50000 --cutoff 1000 --pull 0.3"),
];

const fn world(name: &'static str, world: &'static str) -> Case {
    Case { name, picture: None, rate: "--rate 1000 --cutoff 20 --points 6 --repeats 2", world }
}

const WORLDS: [Case; 10] = [
    world("nothing", "--frictionless --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 2"),
    world("encoder steps", "--frictionless --ideal-drive --pull 0.1 --torque-limit 2"),
    world("the drive", "--frictionless --counts 8388608 --pull 0.1 --torque-limit 2"),
    world("saturation at 0.02 N m", "--frictionless --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 0.02"),
    world("viscous friction", "--friction viscous --ideal-drive --counts 8388608 --pull 0.1 --torque-limit 2"),
    world("Coulomb friction", "--friction coulomb --ideal-drive --counts 8388608 --pull 2 --torque-limit 2"),
    world("a hand", "--frictionless --ideal-drive --counts 8388608 --grip --pull 0.1 --torque-limit 2"),
    world("a hand and encoder steps", "--frictionless --ideal-drive --grip --pull 0.1 --torque-limit 2"),
    world(
        "a hand and steps a fifth as long",
        "--frictionless --ideal-drive --counts 100000 --grip --pull 0.1 --torque-limit 2",
    ),
    Case {
        picture: Some("range-1khz-world"),
        ..world(
            "a hand, encoder steps, the drive and viscous friction",
            "--friction viscous --grip --pull 0.1 --torque-limit 2",
        )
    },
];

const fn washed(name: &'static str, rate: &'static str) -> Case {
    Case { name, picture: None, rate, world: BARE }
}

const WASHED: [Case; 3] = [
    washed("0.5", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 0.5 --pull 0.1"),
    washed("2", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 2 --pull 0.1"),
    washed("10", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 10 --pull 0.1"),
];
const CORNERS: [&str; 6] = ["0.5", "1", "2", "5", "10", "20"];

/// Devices and normals of the maps.
const MAPS: [(&str, &str); 2] = [("coupled-five-bar", "1,0"), ("phantom-premium-1.5", "1,1,0")];

/// Where the generated section of docs/results.md begins and ends.
const BEGIN: &str = "<!-- impedance range: begin, written by docs/figures/src/main.rs -->";
const END: &str = "<!-- impedance range: end -->";

/// Which line is whose.
const ORDER: &str = "In the order of the tables: the cases, the washout at 0.5, 2 and 10 Hz, what the theory leaves out from \"nothing\" to the last row.";

/// Why no test types the lines.
const DURATION: &str = "a quarter of a minute to minutes each; `cargo xtask figures` runs them all";

/// Processes that run at a time.
const AT_A_TIME: usize = 2;

/// The command line of a case, which keeps what was measured in this file and replaces the published picture.
fn line(case: &Case, progress: &str) -> String {
    let picture = case.picture.map_or(String::new(), |name| format!(" --svg docs/results/{name}.svg --force"));
    format!("haptic measure-range {WHERE} {} {}{picture} --progress {progress}", case.rate, case.world)
}

/// Where a reader keeps what was measured: no two cases share a file.
fn typed_file(case: &Case) -> String {
    let kind = if WASHED.iter().any(|washed| washed.name == case.name) { "washout-" } else { "" };
    format!("{kind}{}.json", case.name.replace([' ', '.'], "-").replace(',', ""))
}

/// The command line of a map.
fn map_line((device, normal): (&str, &str)) -> String {
    format!("haptic map devices/{device}.toml --normal {normal} --png docs/results/map-{device}.png --force")
}

/// What the tool answers to a line in JSON.
fn asked(root: &Path, line: &str) -> Result<Value, Error> {
    let mut command = Command::new(env!("CARGO"));
    command.current_dir(root).args(["run", "--quiet", "--package", "haptic"]);
    if !cfg!(debug_assertions) {
        command.arg("--release");
    }
    let output = command.arg("--").args(line.split_whitespace().skip(1)).arg("--json").output()?;
    if !output.status.success() {
        return Err(format!("{line}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Measures the cases of a group, some at a time.
fn measured(root: &Path, group: &'static [Case], wanted: &[String]) -> Result<Vec<(&'static Case, Value)>, Error> {
    // Relative to the repository: no blank of another path splits a line.
    let folder = format!("target/figures-{}", std::process::id());
    std::fs::create_dir_all(root.join(&folder))?;
    let cases: Vec<&Case> =
        group.iter().filter(|case| wanted.is_empty() || wanted.iter().any(|name| name == case.name)).collect();
    let (next, found) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_A_TIME {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::SeqCst)) {
                    let answer = asked(root, &line(case, &format!("{folder}/{}", typed_file(case))));
                    eprintln!("{}: done", case.name);
                    found.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((*case, answer));
                }
            });
        }
    });
    std::fs::remove_dir_all(root.join(&folder))?;
    let found = found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut found = found.into_iter().map(|(case, answer)| Ok((case, answer?))).collect::<Result<Vec<_>, Error>>()?;
    found.sort_by_key(|(case, _)| group.iter().position(|other| other.name == case.name));
    Ok(found)
}

/// A figure of a mode's area.
fn area(answer: &Value, mode: &str, key: &str) -> Result<f64, Error> {
    let areas = answer["areas"].as_array().ok_or("no areas")?;
    let found = areas.iter().find(|area| area["mode"] == mode).and_then(|area| area[key].as_f64());
    Ok(found.ok_or_else(|| format!("no {key} of {mode}: a boundary was not found"))?)
}

fn main() -> Result<(), Error> {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let mut section = String::from(HEADING);
    let theory = measured(&root, &THEORY, &wanted)?;
    for (case, answer) in &theory {
        let (off, full) = ("off", "full");
        let [cutoff, rate] = ["cutoff_hz", "rate_hz"].map(|key| answer[key].to_string());
        let ratio = |key| Ok::<f64, Error>(area(answer, full, key)? / area(answer, off, key)?);
        let row = format!(
            "| {} Hz, cutoff {} Hz ({}) | {:.2} % | {:.2} % | {:.3} | {:.3} |",
            rate.trim_end_matches(".0"),
            cutoff.trim_end_matches(".0"),
            case.name,
            100.0 * area(answer, off, "furthest")?,
            100.0 * area(answer, full, "furthest")?,
            ratio("theory")?,
            ratio("measured")?
        );
        println!("{row}");
        section.push_str(&row);
        section.push('\n');
    }
    section.push_str(&pictures());
    section.push_str(WASHOUT);
    for corner in CORNERS {
        if !wanted.is_empty() {
            break;
        }
        let _ = write!(section, "| {corner} Hz |");
        for (case, answer) in &theory {
            let rate = case.rate.split(" --pull").next().unwrap_or_default();
            let (place, delay) = (WHERE.replace(" --port sim", ""), &answer["delay_samples"]);
            let line = format!("haptic range {place} {rate} --delay {delay} --undamped --washout {corner}");
            let range = asked(&root, &line)?;
            let area = |mode: &str| range[mode]["area"].as_f64().ok_or("no area");
            let kept = (area("washout")? - area("off")?) / (area("full")? - area("off")?);
            let _ = write!(section, " {:.1} % |", 100.0 * kept);
        }
        section.push('\n');
    }
    section.push_str("\nMeasured at 1000 Hz and a cutoff of 20 Hz:\n\n| corner | kept |\n|---:|---:|\n");
    for (case, answer) in measured(&root, &WASHED, &wanted)? {
        let area = |mode| area(&answer, mode, "measured");
        let kept = (area("washout")? - area("off")?) / (area("full")? - area("off")?);
        let row = format!("| {} Hz | {:.1} % |", case.name, 100.0 * kept);
        println!("{row}");
        let _ = writeln!(section, "{row}");
    }
    section.push_str(WASHOUT_MEANS);
    let worlds = measured(&root, &WORLDS, &wanted)?;
    for (case, answer) in &worlds {
        let bare = &worlds[0].1;
        let share = |mode| Ok::<f64, Error>(area(answer, mode, "measured")? / area(bare, mode, "theory")?);
        let row = match (share("off"), share("full")) {
            (Ok(off), Ok(full)) => format!(
                "| {} | {off:.3} | {full:.3} | {:.3} | {:.0} % |",
                case.name,
                area(answer, "full", "measured")? / area(answer, "off", "measured")?,
                100.0 * area(answer, "off", "spread")?.max(area(answer, "full", "spread")?)
            ),
            (Err(why), _) | (_, Err(why)) => format!("| {} | {why} | | | |", case.name),
        };
        println!("{row}");
        let _ = writeln!(section, "{row}");
    }
    section.push_str(WORLD_MEANS);
    section.push_str(&lines());
    if wanted.is_empty() {
        for map in MAPS {
            asked(&root, &map_line(map))?;
        }
        write_section(&root.join("docs/results.md"), &section)?;
    }
    Ok(())
}

const HEADING: &str = "The device is the shipped coupled-five-bar at q = (2.6, 1.75) rad, the wall along the normal of the \
largest Wrr/Weff there.\nLines are the linear theory of the board's own delay and drive, dots are measured through the \
protocol of a simulated board: the\nmedian of the repeats at 12 dampings, bars from the lowest to the highest. The command line \
of every row is at the end of the section;\n`cargo xtask figures` runs them all.\n\nDeviation: the \
largest distance of a measured median from the line, in percent of the line's highest point. Area ratio: with the\nfeed-forward \
over without. (Wrr/Weff)² = 1.590 is what an undamped device gains.\n\nThese cases hold the theory to account: no friction, \
no hand, torque at once, fine encoders.\n\n| case | deviation off | deviation full | area ratio predicted | measured \
|\n|---|---|---|---|---|\n";

const WASHOUT: &str = "\n### What a washout keeps\n\nThe share of the gained area, (washed out - off) / (full - off), that is \
left when the feed-forward is high-passed so that a resting\nhand feels none of it, predicted by `haptic range --washout`.\n\n| \
corner | 200 Hz, cutoff 20 Hz | 1000 Hz, cutoff 20 Hz | 10000 Hz, cutoff 200 Hz | 20000 Hz, cutoff 500 Hz | 50000 Hz, cutoff \
1000 Hz |\n|---:|---:|---:|---:|---:|---:|\n";

const WASHOUT_MEANS: &str = "\nAt 10 kHz and above 2 Hz keep nearly all of it. A slow loop reacts within the same times as a \
hand, so a washout that a hand does not\nfeel takes the gain away: at 200 Hz or 1 kHz choose 0.5 Hz, or `feed_forward = \
\"full\"`. Below zero the washed-out wall is stable in a\nsmaller area than one without feed-forward.\n\n### What the theory \
leaves out\n\nThe same at 1000 Hz and a cutoff of 20 Hz, with one thing added at a time. Areas of the measured boundaries over \
those of the theory\nof the first row, 6 dampings, medians of 2 repeats; the spread is the widest bar of a damping over its median. \
None of this tests the\ntheory: it says what else there is.\n\n| added | area off | area full | full over off | widest spread \
|\n|---|---:|---:|---:|---:|\n";

const WORLD_MEANS: &str = "\nEncoder steps keep a wall near its boundary vibrating, which counts as not stable where it is \
larger than six of them. The drive (2 ohm\nand 1 mH, 24 V, 120 ns of dead time) makes a current within a carrier period, a \
twentieth of a sample. A torque limit bounds how far\nthe swings grow and not when they begin. Viscous friction adds its damping \
to the wall's. Coulomb friction holds every swing that is\nsmall enough: what is measured is the stiffness from which a pull of \
that length no longer comes to rest, which depends on the pull. A\nhand damps most of all. It loads the other directions as well, \
so what the feed-forward removes is a smaller part of what acts there,\nand what it buys shrinks. A hand and encoder steps \
together say little about the feed-forward: a hand leaves small vibrations near the\nboundary, and those of up to six steps count \
as what the encoders do at rest. How many walls pass for stable then depends on how long\na step is, without feed-forward and with \
it in different measure.\n\n![with what the theory leaves \
out](results/range-1khz-world.svg)\n";

fn pictures() -> String {
    let mut text = String::new();
    for (device, _) in MAPS {
        let _ = write!(text, "\n![inertia over the workspace of {device}](results/map-{device}.png)\n");
    }
    for case in &THEORY {
        let _ = write!(
            text,
            "\n![{}](results/{}.svg)\n",
            case.rate.split(" --pull").next().unwrap_or_default().replace("--", ""),
            case.name
        );
    }
    text
}

/// Every command line of the section.
fn lines() -> String {
    let mut text = format!("\n### The command lines\n\n{ORDER}\n\n```sh no-run: {DURATION}\n");
    for case in THEORY.iter().chain(&WASHED).chain(&WORLDS) {
        let _ = writeln!(text, "{}", line(case, &typed_file(case)));
    }
    for map in MAPS {
        let _ = writeln!(text, "{}", map_line(map));
    }
    text.push_str("```\n");
    text
}

/// Replaces the section between the markers.
fn write_section(path: &Path, section: &str) -> Result<(), Error> {
    let old = std::fs::read_to_string(path)?;
    let (from, to) = (old.find(BEGIN).ok_or("no section")?, old.find(END).ok_or("no end of the section")?);
    std::fs::write(path, format!("{}{BEGIN}\n{section}{}", &old[..from], &old[to..]))?;
    Ok(())
}
