//! The command line as a whole: help, pipes that close, numbers with a sign, JSON, the manual.

use crate::common::sim::{HANG, Sim};
use crate::common::{file, haptic};
use predicates::prelude::*;
use predicates::str::contains;
use std::process::Command;

#[test]
fn help_explains_the_tool_and_each_command_in_every_spelling() {
    haptic(&["help"]).assert().success().stdout(contains("Start here").and(contains("haptic demo")));
    for words in [["help", "model"], ["model", "--help"]] {
        haptic(&words).assert().success().stdout(contains("--normal").and(contains("Examples:")));
    }
    haptic(&["help", "stream"]).assert().success().stdout(contains("rendered").and(contains("N m")));
    haptic(&["help", "modle"]).assert().code(2).stderr(contains("modle"));
}

#[cfg(unix)]
#[test]
fn a_pipe_that_closes_ends_a_command_silently() {
    let program = assert_cmd::cargo::cargo_bin("haptic");
    let program = program.to_str().unwrap();
    let device = file("coupled-five-bar.toml");
    for command in [
        "stream --port sim --rate 1000".to_string(),
        "record - --port sim --rate 1000".to_string(),
        // What is told beside the rows has no reader any more either.
        "record - --port sim --rate 1e9 --seconds 0.05 2>&1".to_string(),
        // Rows that all come after the reader has gone.
        "record - --port sim --seconds 0.1".to_string(),
        format!("map {device} --normal 0,1 --json"),
        "help".to_string(),
    ] {
        // A byte is read, then nobody reads: a document may be one long line.
        let line = format!("set -o pipefail; timeout 600 \"$0\" {command} | head -c 1 > /dev/null");
        let output = Command::new("bash").args(["-c", &line, program]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 141)), "{command}: {:?} {said}", output.status);
        assert!(!said.contains("error") && !said.contains("pipe") && !said.contains("lost"), "{command}: {said}");
    }
}

#[test]
fn numbers_that_cannot_be_are_refused_for_what_they_are() {
    let device = file("coupled-five-bar.toml");
    for rate in ["-5", "0", "199", "1e12"] {
        haptic(&["range", &device, "--normal", "0,1", "--cutoff", "20", "--rate", rate])
            .assert()
            .code(2)
            .stderr(contains("200 to 50000 Hz"));
    }
    haptic(&["stream", "--port", "sim", "--seconds", "-5"]).assert().code(2).stderr(contains("greater than zero"));
    haptic(&["rules", "--port", "sim", "--torque", "-1,2"]).assert().code(2).stderr(contains("greater than zero"));
}

#[test]
fn what_cannot_be_read_is_answered_with_what_to_type() {
    let device = file("coupled-five-bar.toml");
    let refused = |arguments: &[&str]| {
        let done = haptic(arguments).assert().code(2);
        String::from_utf8_lossy(&done.get_output().stderr).into_owned()
    };
    for (arguments, wanted) in [
        (["range", &device, "--normal=0,1", "--rate=fast"], "'fast' for '--rate <HZ>': write a number, such as"),
        (
            ["range", &device, "--normal=0,1", "--difference-over=-3"],
            "'-3' for '--difference-over <SAMPLES>': write a whole",
        ),
        (["measure-range", &device, "--normal=0,1", "--points=1.5"], "'1.5' for '--points <N>': write a whole number"),
        (["tune", &device, "--normal=0,1", "--wall="], "write a whole number, such as"),
        (["model", &device, "--normal=0,1", "--q=1"], "--q has 1 number, but"),
        (["range", &device, "--normal=0,1", "--share=1,2"], "--share has 2 numbers for 1 wall ("),
    ] {
        let said = refused(&arguments);
        assert!(said.contains(wanted), "{arguments:?}: {said}");
        assert!(!said.contains("invalid digit") && !said.contains("literal") && !said.contains("1 numbers"), "{said}");
    }
}

#[test]
fn every_answer_of_a_board_comes_as_json_as_well() {
    let sim = Sim::start(&["--fast"]);
    let folder = tempfile::tempdir().unwrap();
    let backup = folder.path().join("b.json");
    let (device, scene) = (file("coupled-five-bar.toml"), file("scenes/coupled-five-bar/wall.toml"));
    let json = |words: &[&str]| -> serde_json::Value {
        let done = sim.run(&[words, &["--json"]].concat()).success();
        serde_json::from_slice(&done.get_output().stdout).unwrap_or_else(|error| panic!("{words:?}: {error}"))
    };
    let loaded = json(&["device", &device]);
    assert_eq!((&loaded["device"], &loaded["warnings"]), (&"coupled-five-bar".into(), &serde_json::json!([])));
    let loaded = json(&["scene", &scene]);
    assert_eq!(loaded["scene"]["walls"].as_array().unwrap().len(), 1);
    assert_eq!(loaded["warnings"], serde_json::json!([]));
    assert_eq!(json(&["home"])["homed"], true);
    let gains = json(&["gains", "--stiffness", "300"]);
    assert_eq!((&gains["stiffness"], &gains["warnings"]), (&300.0.into(), &serde_json::json!([])));
    let beyond = json(&["gains", "--stiffness", "1e9"]);
    assert!(beyond["warnings"][0]["text"].as_str().unwrap().contains("predicted stable"), "{beyond}");
    json(&["gains", "--stiffness", "300"]);
    assert_eq!(json(&["rules", "--torque", "0.5,0.4", "--host", "ignore"])["torque"].as_array().unwrap().len(), 2);
    assert_eq!(json(&["polarity"])["polarity_checked"], true);
    assert_eq!(json(&["board", "save"])["saved"], true);
    assert!(json(&["board", "backup", backup.to_str().unwrap()])["settings"].as_array().unwrap().len() > 3);
    assert!(!json(&["board", "restore", backup.to_str().unwrap()])["restored"].as_array().unwrap().is_empty());
    assert_eq!(json(&["arm"])["state"], "Armed");
    assert_eq!(json(&["disarm"])["state"], "Disarmed");
    assert_eq!(json(&["faults", "--clear"])["cleared"], serde_json::Value::Null);
    sim.run(&["faults", "--clear"]).success().stdout(contains("no fault was latched"));
}

#[test]
fn a_boot_loader_is_not_entered_under_motors_that_are_on_unasked() {
    let sim = Sim::start(&["--fast", "--scene", &file("scenes/coupled-five-bar/wall.toml")]);
    sim.run(&["rules", "--host", "ignore"]).success();
    sim.run(&["arm"]).success();
    sim.run(&["board", "dfu"]).code(1).stderr(contains("the motors are on").and(contains("--yes")));
    sim.run(&["info"]).success().stdout(contains("armed").and(contains("disarmed").not()));
    sim.run(&["board", "save"]).code(1).stderr(contains("haptic disarm").and(contains("writing flash").not()));
    sim.run(&["board", "dfu", "--yes"]).success();
}

#[test]
fn the_manual_has_a_page_for_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man1");
    haptic(&["completions", "--man", pages.to_str().unwrap()]).assert().success();
    haptic(&["completions", "--man"]).assert().success().stdout(contains(".SH"));
    let main = std::fs::read_to_string(pages.join("haptic.1")).unwrap();
    let mut named = 0;
    for reference in main.split("haptic\\-").skip(1) {
        let name = reference.split("(1)").next().unwrap().replace('\\', "");
        if reference.contains("(1)") && !name.contains(char::is_whitespace) && name != "help" {
            named += 1;
            assert!(pages.join(format!("haptic-{name}.1")).exists(), "haptic-{name}(1) is named and not there");
        }
    }
    assert!(named > 20, "{named} commands are named");
    let page = std::fs::read_to_string(pages.join("haptic-model.1")).unwrap();
    for section in ["EXIT STATUS", "EXAMPLES", "FILES"] {
        assert!(page.contains(section), "{section} in {page}");
    }
}

#[test]
fn what_cannot_be_is_refused_before_anything_starts() {
    let device = file("coupled-five-bar.toml");
    let folder = tempfile::tempdir().unwrap();
    let wrong = folder.path().join("x.png");
    let wrong = wrong.to_str().unwrap();
    haptic(&["range", &device, "--normal", "0,1", "--rate", "1000", "--cutoff", "20", "--svg", wrong])
        .assert()
        .code(2)
        .stderr(contains("extension").and(contains("--png")));
    let progress = folder.path().join("missing").join("p.json");
    let progress = progress.to_str().unwrap();
    haptic(&["measure-range", &device, "--port", "sim", "--normal", "0,1", "--progress", progress])
        .assert()
        .code(1)
        .stderr(contains("there is no such folder").and(contains("p.json").count(1)));
    assert!(!std::path::Path::new(wrong).exists());
    haptic(&["sim", "--axes", "1"]).timeout(HANG).assert().code(2).stderr(contains("2 joints"));
    haptic(&["info", "--port", "SIM0001"]).assert().code(1).stderr(contains("serial number"));
}

#[test]
fn a_check_says_that_the_device_does_not_reach_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    let wall = "[[wall]]\npoint = [0.0, 100.0]\nnormal = [0.0, -1.0]\nstiffness = 300.0\ndamping = 1.0\n";
    std::fs::write(&scene, wall).unwrap();
    let planned =
        haptic(&["check", &file("coupled-five-bar.toml"), scene.to_str().unwrap(), "--json"]).assert().success();
    let output = planned.stderr(contains("out of reach")).get_output().stdout.clone();
    let json: serde_json::Value = serde_json::from_slice(&output).unwrap();
    assert!(json["warnings"][0]["text"].as_str().unwrap().contains("out of reach"), "{json}");
}
