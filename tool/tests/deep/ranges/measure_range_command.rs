//! `haptic measure-range` on the shipped simulated board with its friction, encoders and drive.

use crate::common::sim::Sim;
use crate::common::{Folder, haptic, read, shipped_path};
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;

const DEVICE: &str = "devices/coupled-five-bar.toml";

/// Options for a rate at which the tip comes to rest before every trial despite friction and encoder steps.
const SLOW_LOOP: [&str; 4] = ["--rate", "1000", "--cutoff", "20"];

fn measure(progress: &str, rate: &[&str], more: &[&str]) -> assert_cmd::assert::Assert {
    let fixed = ["measure-range", DEVICE, "--port", "sim", "--normal", "0.6,0.8", "--kd", "15", "--json"];
    haptic(&fixed).args(rate).args(more).arg("--progress").arg(progress).assert()
}

#[test]
fn a_measurement_is_reported_kept_and_continued() {
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let first = measure(&progress, &SLOW_LOOP, &["--feed-forward", "off", "--repeats", "1", "--pull", "2"]).success();
    let document: Value = serde_json::from_slice(&first.get_output().stdout).unwrap();
    let point = &document["points"][0];
    assert_eq!((point["mode"].as_str(), point["kd"].as_f64()), (Some("off"), Some(15.0)));
    let once = point["kp"].as_f64().unwrap();
    assert!(once > 1e3, "{once}");
    // The second run keeps the first repeat and adds one.
    let second = measure(&progress, &SLOW_LOOP, &["--feed-forward", "off", "--repeats", "2", "--pull", "2"]).success();
    let document: Value = serde_json::from_slice(&second.get_output().stdout).unwrap();
    let repeats = document["points"][0]["repeats"].as_array().unwrap();
    assert_eq!((repeats.len(), repeats[0].as_f64()), (2, Some(once)));
    // A third run measures nothing and prints the date of the first measurement.
    let date = document["date"].as_str().unwrap().to_string();
    let third = measure(&progress, &SLOW_LOOP, &["--feed-forward", "off", "--repeats", "2", "--pull", "2"]).success();
    let third = third.stderr(contains("none is measured now").and(contains("--anew")).and(contains(&*date)));
    let third_report: Value = serde_json::from_slice(&third.get_output().stdout).unwrap();
    assert_eq!((&third_report["date"], &third_report["points"]), (&document["date"], &document["points"]));
    // Another damping is measured in addition, and only its result is reported.
    let other_damping = ["--kd", "16", "--feed-forward", "off", "--repeats", "1", "--pull", "2"];
    let fixed = ["measure-range", DEVICE, "--port", "sim", "--normal", "0.6,0.8", "--json"];
    let fourth = haptic(&fixed).args(SLOW_LOOP).args(other_damping).arg("--progress").arg(&progress).assert().success();
    let report: Value = serde_json::from_slice(&fourth.get_output().stdout).unwrap();
    let dampings: Vec<f64> = report["points"].as_array().unwrap().iter().map(|p| p["kd"].as_f64().unwrap()).collect();
    assert_eq!((dampings, report["theory"].as_str().unwrap().contains("--kd 15")), (vec![16.0], false));
    let date = report["date"].as_str().unwrap().to_string();
    // Results at different rates are not mixed.
    measure(&progress, &["--rate", "10000", "--cutoff", "200"], &["--feed-forward", "off", "--pull", "2"])
        .code(2)
        .stderr(contains("holds another measurement").and(contains("--anew")).and(contains(&*date)))
        .stderr(contains("coupled-five-bar along (0.6, 0.8) at 1000 Hz"));
    // With --anew the old results are replaced.
    let new_run =
        measure(&progress, &SLOW_LOOP, &["--feed-forward=off", "--repeats=1", "--pull=1", "--anew"]).success();
    let new_run = new_run.stderr(contains("already").not());
    let document: Value = serde_json::from_slice(&new_run.get_output().stdout).unwrap();
    assert_eq!(document["points"][0]["repeats"].as_array().unwrap().len(), 1);
}

#[test]
fn impossible_measurements_are_refused_at_once() {
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let one = |option: &str, other: &str| contains(format!("{option} is ")).and(contains(other.to_string()).not());
    measure(&progress, &SLOW_LOOP, &["--torque-limit", "0"]).code(2).stderr(one("--torque-limit", "--pull"));
    measure(&progress, &SLOW_LOOP, &["--pull", "20"]).code(2).stderr(one("--pull", "--torque-limit"));
    let nowhere = folder.path("missing/p.json");
    let elsewhere = ["measure-range", DEVICE, "--port", "/dev/no-such-port", "--normal", "0.6,0.8", "--progress"];
    haptic(&elsewhere).arg(&nowhere).assert().code(1).stderr(contains("no such folder"));
    assert!(!std::path::Path::new(&progress).exists());
}

/// Returns the arguments of a document's command line, with an absolute path of the device file.
fn line_arguments(line: &str) -> Vec<String> {
    let mut words = line.split('#').next().unwrap().split_whitespace();
    assert_eq!(words.next(), Some("haptic"), "{line}");
    words.map(|word| word.strip_prefix("devices/").map_or(word.to_string(), shipped_path)).collect()
}

/// Runs a command line with more arguments in a temporary folder.
fn run_line(line: &str, more: &[&str]) -> assert_cmd::assert::Assert {
    let folder = tempfile::tempdir().unwrap();
    haptic(&[]).current_dir(&folder).args(line_arguments(line)).args(more).assert()
}

fn parse_json(assert: assert_cmd::assert::Assert) -> Value {
    serde_json::from_slice(&assert.success().get_output().stdout).unwrap()
}

/// Returns the command lines of measurements in a document.
fn measurement_lines(document: &str) -> Vec<String> {
    let text = read(document);
    let lines = text.lines().map(|line| line.trim().trim_matches('`'));
    lines.filter(|line| line.starts_with("haptic measure-range ")).map(str::to_string).collect()
}

#[test]
fn the_readmes_line_measures_its_numbers_near_theory() {
    let lines = measurement_lines("README.md");
    let [line] = lines.as_slice() else { panic!("{lines:?}") };
    let document = parse_json(run_line(line, &["--json"]));
    let points = document["points"].as_array().unwrap();
    assert_eq!(points.len(), 4);
    for point in points {
        assert_eq!((point["repeats"].as_array().unwrap().len(), point["pulls"].as_array().unwrap().len()), (6, 2));
        // At the largest damping, the lower of the two pulls' results is 3.4 % below theory.
        let share = point["kp"].as_f64().unwrap() / point["theory_kp"].as_f64().unwrap();
        assert!((0.96..1.05).contains(&share), "{point}");
    }
    let readme = read("README.md").replace('\n', " ");
    let kilonewtons = |i: usize| points[i]["kp"].as_f64().unwrap() / 1e3;
    let stiffnesses = format!(
        "{:.2} kN/m with the feed-forward and {:.2} kN/m without: **{:.2} times**",
        kilonewtons(3),
        kilonewtons(1),
        kilonewtons(3) / kilonewtons(1)
    );
    assert!(readme.contains(&stiffnesses), "README.md lacks this text: {stiffnesses}");
    // docs/results.md has the same command line with its results.
    let results = read("docs/results.md");
    let row = results.lines().find(|row| row.contains(&format!("`{line}`"))).expect("a row with this line");
    let table_cell = |key: &str| {
        let two = |mode: &str| {
            let of: Vec<String> = points
                .iter()
                .filter(|point| point["mode"] == mode)
                .map(|point| format!("{:.2}", point[key].as_f64().unwrap() / 1e3))
                .collect();
            format!("{mode} {}", of.join(" and "))
        };
        format!("| {}, {} kN/m |", two("off"), two("full"))
    };
    for key in ["kp", "theory_kp"] {
        assert!(row.contains(&table_cell(key)), "{}: {row}", table_cell(key));
    }
}

#[test]
fn the_defaults_succeed_and_explain_friction() {
    let line = format!("haptic measure-range {DEVICE} --port sim --normal 0,1 --points 2 --repeats 1");
    run_line(&line, &[]).success().stdout(contains("Coulomb friction").and(contains("haptic range")));
}

#[test]
fn the_printed_line_computes_the_printed_theory() {
    let line = format!(
        "haptic measure-range {DEVICE} --port sim --q 2.6,1.75 --normal 0.94,-0.34 --kd 15,4.123456789 --repeats 1 \
         --pull 0.1 --feed-forward all --frictionless --counts 8388608"
    );
    let measured = parse_json(run_line(&line, &["--json"]));
    let theory = measured["theory"].as_str().unwrap();
    let predicted = parse_json(run_line(theory, &["--json"]));
    let points = measured["points"].as_array().unwrap();
    assert_eq!(points.len(), 6);
    for point in points {
        let boundary = predicted[point["mode"].as_str().unwrap()]["boundary"].as_array().unwrap();
        assert_eq!(boundary.len(), 2);
        assert!(boundary.iter().any(|other| other["kp"] == point["theory_kp"]), "{point}: {boundary:?}");
        assert!((point["kp"].as_f64().unwrap() / point["theory_kp"].as_f64().unwrap() - 1.0).abs() < 0.025, "{point}");
    }
    assert!(measured["drive"].as_str().unwrap().contains("current"), "{measured}");
    // The text output contains all these numbers, too.
    let read = run_line(theory, &[]).success();
    let text = String::from_utf8_lossy(&read.get_output().stdout).into_owned();
    for point in points {
        let kp = format!("{:.2}", point["theory_kp"].as_f64().unwrap());
        assert!(text.lines().any(|line| line.contains(&kp)), "{kp}: {text}");
    }
}

#[test]
fn coarse_encoders_are_reported_with_the_stable_part() {
    let line = format!(
        "haptic measure-range {} --port sim --normal 0.6,0.8,0 --rate 5000 --cutoff 200 --kd 20 --frictionless --repeats 1",
        shipped_path("phantom-premium-1.5.toml")
    );
    run_line(&line, &[])
        .code(1)
        .stdout(contains("> ").and(contains("times the counts")))
        .stderr(contains("too weak for these encoders").and(contains("--counts")));
    // If the motors are too weak even for a soft hold, the device is not moved.
    let line = format!("haptic measure-range {DEVICE} --port sim --normal 0,1 --rate 20000 --cutoff 500");
    run_line(&line, &[]).code(1).stdout("").stderr(contains("too weak for these encoders"));
}

#[test]
fn simulation_options_are_refused_for_other_ports() {
    run_line(&format!("haptic measure-range {DEVICE} --port tcp:127.0.0.1:1 --normal 0,1 --frictionless"), &[])
        .code(2)
        .stderr(contains("--port sim"));
}

#[test]
fn a_hand_that_holds_the_tip_is_named() {
    let sim = Sim::start(&["--fast", "--hand", "loop", &shipped_path("coupled-five-bar.toml")]);
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let fixed = ["measure-range", DEVICE, "--normal=0,1", "--kd=15", "--repeats=1", "--feed-forward=off", "--pull=2"];
    sim.run(&[&fixed[..], &["--progress", &progress]].concat())
        .failure()
        .stderr(contains("a hand or a stop holds the tip: a pull of 2.0 mm makes 0.584 N, and friction is 0.083 N"));
}

#[test]
fn a_board_with_another_device_needs_load_and_is_restored() {
    let sim = Sim::start(&["--fast", "--frictionless", &shipped_path("coupled-five-bar.toml")]);
    sim.type_lines("device devices/haply-2diy.toml\nscene devices/scenes/haply-2diy/wall-stiff.toml");
    let board_state = || {
        let info = sim.json(&["info"]);
        (["device", "walls", "rate_hz", "state"].map(|key| info[key].clone()), sim.output(&["rules"]))
    };
    let before = board_state();
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let fixed = ["measure-range", DEVICE, "--normal=0,1", "--kd=15", "--repeats=1", "--feed-forward=off", "--pull=2"];
    let arguments = [&fixed[..], &["--progress", &progress]].concat();
    sim.run(&arguments)
        .code(1)
        .stderr(contains("the board holds haply-2diy, the file is coupled-five-bar").and(contains("--load")));
    assert!(!std::path::Path::new(&progress).exists());
    assert_eq!(board_state(), before);
    // With --fast the simulated time does not run ahead of the tool.
    sim.run(&[&arguments[..], &["--load"]].concat()).success().stdout(contains("off"));
    assert_eq!(board_state(), before);
}
