//! Regenerates the figures and tables of stable ranges and maps in docs/results.md: `cargo xtask figures` (some
//! minutes). Runs the command lines that it writes into docs/results/ranges.sh. With names of cases as arguments, runs
//! only these cases and prints their rows.

use haptic_host::output::csv_line;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Device, pose and normal of the wall; the normal has the largest Wrr/Weff at the pose.
const SETUP: &str = "devices/coupled-five-bar.toml --port sim --q 2.6,1.75 --normal 0.94702228,-0.32116787";
/// Options of `haptic measure-range` for the idealised device of the linear theory.
const IDEAL_OPTIONS: &str = "--frictionless --ideal-drive --counts 8388608 --torque-limit 2";

/// A range to measure.
struct Case {
    name: &'static str,
    /// Name of the picture, if the case has a picture.
    picture: Option<&'static str>,
    /// Options of `haptic measure-range` for rate and estimator.
    rate: &'static str,
    /// Options of `haptic measure-range` for the simulated device.
    world: &'static str,
}

/// Returns a case of the idealised device with a picture.
const fn theory(name: &'static str, rate: &'static str) -> Case {
    Case { name, picture: Some(name), rate, world: IDEAL_OPTIONS }
}

/// Rates and cutoffs at which the measurement is compared with the theory.
const THEORY: [Case; 5] = [
    theory("range-200hz", "--rate 200 --cutoff 20 --pull 0.1"),
    theory("range-1khz", "--rate 1000 --cutoff 20 --pull 0.1"),
    theory("range-10khz", "--rate 10000 --cutoff 200 --pull 0.3"),
    theory("range-20khz", "--rate 20000 --cutoff 500 --pull 0.3"),
    theory("range-50khz", "--rate 50000 --cutoff 1000 --pull 0.3"),
];

/// Returns a case at 1 kHz without a picture.
const fn world(name: &'static str, world: &'static str) -> Case {
    Case { name, picture: None, rate: "--rate 1000 --cutoff 20 --points 6 --repeats 2", world }
}

/// Deviations of a simulated device from the theory, which are measured one by one.
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

/// Returns a case of the idealised device without a picture.
const fn washout(name: &'static str, rate: &'static str) -> Case {
    Case { name, picture: None, rate, world: IDEAL_OPTIONS }
}

/// Names of the cases are the washout corners, Hz.
const WASHOUTS: [Case; 3] = [
    washout("0.5", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 0.5 --pull 0.1"),
    washout("2", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 2 --pull 0.1"),
    washout("10", "--rate 1000 --cutoff 20 --points 6 --repeats 2 --feed-forward all --washout 10 --pull 0.1"),
];
/// Corner frequencies of the washouts for which the theory is evaluated, Hz.
const CORNERS_HZ: [&str; 6] = ["0.5", "1", "2", "5", "10", "20"];

const MAPS: [(&str, &str); 2] = [("coupled-five-bar", "1,0"), ("phantom-premium-1.5", "1,1,0")];

const PARALLEL_RUNS: usize = 2;

/// Returns the command line of a case, which stores the measurement in the file `progress` and replaces the published
/// picture.
fn command_line(case: &Case, progress: &str) -> String {
    let picture = case.picture.map_or(String::new(), |name| format!(" --svg docs/results/{name}.svg --force"));
    format!("haptic measure-range {SETUP} {} {}{picture} --progress {progress}", case.rate, case.world)
}

/// Returns the name of the file for the measurement of a case, which is different for every case.
fn progress_file(case: &Case) -> String {
    let kind = if WASHOUTS.iter().any(|washed| washed.name == case.name) { "washout-" } else { "" };
    format!("{kind}{}.json", case.name.replace([' ', '.'], "-").replace(',', ""))
}

fn map_line((device, normal): (&str, &str)) -> String {
    format!("haptic map devices/{device}.toml --normal {normal} --png docs/results/map-{device}.png --force")
}

/// Runs this command line with `--json` and returns the parsed output.
fn run_json(root: &Path, line: &str) -> Result<Value, Error> {
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

/// Measures the cases of a group, [`PARALLEL_RUNS`] at a time.
fn measure(root: &Path, group: &'static [Case], wanted: &[String]) -> Result<Vec<(&'static Case, Value)>, Error> {
    // Uses a path relative to the repository, because blanks in the absolute path would split the command line.
    let folder = format!("target/figures-{}", std::process::id());
    std::fs::create_dir_all(root.join(&folder))?;
    let cases: Vec<&Case> =
        group.iter().filter(|case| wanted.is_empty() || wanted.iter().any(|name| name == case.name)).collect();
    let (next, found) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..PARALLEL_RUNS {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::SeqCst)) {
                    let answer = run_json(root, &command_line(case, &format!("{folder}/{}", progress_file(case))));
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

/// Reads a value of the stable area of a feed-forward mode.
fn area(answer: &Value, mode: &str, key: &str) -> Result<f64, Error> {
    let areas = answer["areas"].as_array().ok_or("no areas")?;
    let found = areas.iter().find(|area| area["mode"] == mode).and_then(|area| area[key].as_f64());
    Ok(found.ok_or_else(|| format!("no {key} of {mode}, because a boundary was not found"))?)
}

fn main() -> Result<(), Error> {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let theory = measure(&root, &THEORY, &wanted)?;
    let mut cases = csv_line(["case", "deviation off (%)", "deviation full (%)", "area ratio predicted", "measured"]);
    for (_, answer) in &theory {
        let (off, full) = ("off", "full");
        let [cutoff, rate] = ["cutoff_hz", "rate_hz"].map(|key| answer[key].to_string());
        let ratio = |key| Ok::<f64, Error>(area(answer, full, key)? / area(answer, off, key)?);
        add_row(
            &mut cases,
            &[
                format!("{} Hz, cutoff {} Hz", rate.trim_end_matches(".0"), cutoff.trim_end_matches(".0")),
                format!("{:.2}", 100.0 * area(answer, off, "furthest")?),
                format!("{:.2}", 100.0 * area(answer, full, "furthest")?),
                format!("{:.3}", ratio("theory")?),
                format!("{:.3}", ratio("measured")?),
            ],
        );
    }
    let washed = measure(&root, &WASHOUTS, &wanted)?;
    let mut washout =
        csv_line(["corner (Hz)", "200 Hz", "1000 Hz", "10000 Hz", "20000 Hz", "50000 Hz", "1000 Hz measured"]);
    for corner in CORNERS_HZ {
        let mut cells = vec![corner.to_owned()];
        for (case, answer) in theory.iter().filter(|_| wanted.is_empty()) {
            let rate = case.rate.split(" --pull").next().unwrap_or_default();
            let (place, delay) = (SETUP.replace(" --port sim", ""), &answer["delay_samples"]);
            let line = format!("haptic range {place} {rate} --delay {delay} --undamped --washout {corner}");
            let range = run_json(&root, &line)?;
            cells.push(washout_share(|mode| Ok(range[mode]["area"].as_f64().ok_or("no area")?))?);
        }
        let measured = washed.iter().find(|(case, _)| case.name == corner);
        let measured = measured.map(|(_, answer)| washout_share(|mode| area(answer, mode, "measured"))).transpose()?;
        cells.push(measured.unwrap_or_default());
        add_row(&mut washout, &cells);
    }
    let worlds = measure(&root, &WORLDS, &wanted)?;
    let mut added = csv_line(["added", "area off", "area full", "full over off", "widest spread (%)"]);
    for (case, answer) in &worlds {
        let bare = &worlds[0].1;
        let share = |mode| Ok::<f64, Error>(area(answer, mode, "measured")? / area(bare, mode, "theory")?);
        let cells = match (share("off"), share("full")) {
            (Ok(off), Ok(full)) => [
                format!("{off:.3}"),
                format!("{full:.3}"),
                format!("{:.3}", area(answer, "full", "measured")? / area(answer, "off", "measured")?),
                format!("{:.0}", 100.0 * area(answer, "off", "spread")?.max(area(answer, "full", "spread")?)),
            ],
            (Err(why), _) | (_, Err(why)) => [why.to_string(), String::new(), String::new(), String::new()],
        };
        add_row(&mut added, &[&[case.name.to_owned()], &cells[..]].concat());
    }
    if wanted.is_empty() {
        for map in MAPS {
            run_json(&root, &map_line(map))?;
        }
        let results = root.join("docs/results");
        for (name, text) in [
            ("range-cases.csv", cases),
            ("range-washout.csv", washout),
            ("range-added.csv", added),
            ("ranges.sh", all_command_lines()),
        ] {
            std::fs::write(results.join(name), text)?;
        }
    }
    Ok(())
}

fn add_row(table: &mut String, cells: &[String]) {
    let row = csv_line(cells);
    print!("{row}");
    table.push_str(&row);
}

/// Returns the share of the feed-forward's additional stable area that remains with a washout, %.
fn washout_share(area: impl Fn(&str) -> Result<f64, Error>) -> Result<String, Error> {
    Ok(format!("{:.1}", 100.0 * (area("washout")? - area("off")?) / (area("full")? - area("off")?)))
}

/// Returns the text of ranges.sh with every command line.
fn all_command_lines() -> String {
    let mut text = String::from(
        "# The command line of every row of \"The impedance range\" in docs/results.md, and of the maps, as `cargo xtask\n\
         # figures` writes and runs them: each takes a quarter of a minute to minutes.\n",
    );
    let groups: [(&str, &[Case]); 3] =
        [("the cases", &THEORY), ("washouts, measured", &WASHOUTS), ("what the theory leaves out", &WORLDS)];
    for (what, cases) in groups {
        let _ = writeln!(text, "\n# {what}");
        cases.iter().for_each(|case| text += &(command_line(case, &progress_file(case)) + "\n"));
    }
    text.push_str("\n# the maps\n");
    MAPS.into_iter().for_each(|map| text += &(map_line(map) + "\n"));
    text
}
