//! Properties of all command lines: help, closed pipes, signed numbers, JSON, and the manual.

use crate::common::sim::Sim;
use crate::common::{Folder, refusal, shipped_path, type_lines};
use std::process::Command;

#[cfg(unix)]
#[test]
fn a_closed_pipe_ends_a_command_silently() {
    let program = assert_cmd::cargo::cargo_bin("haptic");
    let program = program.to_str().unwrap();
    let device = shipped_path("coupled-five-bar.toml");
    for command in [
        "stream --port sim --rate 1000".to_string(),
        "record - --port sim --rate 1000".to_string(),
        // Standard error goes to the closed pipe, too.
        "record - --port sim --rate 1e9 --seconds 0.05 2>&1".to_string(),
        // All rows are written after the reader has ended.
        "record - --port sim --seconds 0.1".to_string(),
        format!("map {device} --normal 0,1 --json"),
        "help".to_string(),
    ] {
        // Read only one byte, because a document may be one long line.
        let line = format!("set -o pipefail; timeout 600 \"$0\" {command} | head -c 1 > /dev/null");
        let output = Command::new("bash").args(["-c", &line, program]).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 141)), "{command}: {:?} {text}", output.status);
        assert!(!text.contains("error") && !text.contains("pipe") && !text.contains("lost"), "{command}: {text}");
    }
}

#[test]
fn wrong_numbers_are_refused_with_a_remedy() {
    for rate in ["-5", "0", "199", "1e12"] {
        let line = format!("2: range devices/coupled-five-bar.toml --normal 0,1 --cutoff 20 --rate {rate}");
        type_lines(&format!("{line} => 200 to 50000 Hz"), &[]);
    }
    for (line, wanted) in [
        ("range --rate=fast", "'fast' for '--rate <HZ>': write a number, such as"),
        ("range --difference-over=-3", "'-3' for '--difference-over <SAMPLES>': write a whole"),
        ("measure-range --points=1.5", "'1.5' for '--points <N>': write a whole number"),
        ("tune --wall=", "write a whole number, such as"),
        ("range --share=1,2", "--share has 2 numbers for 1 wall ("),
    ] {
        let (command, option) = line.split_once(' ').unwrap();
        let text = refusal(2, &[command, "devices/coupled-five-bar.toml", "--normal=0,1", option]);
        assert!(text.contains(wanted), "{line}: {text}");
        assert!(!text.contains("invalid digit") && !text.contains("literal") && !text.contains("1 numbers"), "{text}");
    }
}

#[test]
fn every_board_command_prints_json() {
    let sim = Sim::start(&["--fast"]);
    let folder = Folder::new();
    let (device, scene) = (shipped_path("coupled-five-bar.toml"), shipped_path("scenes/coupled-five-bar/wall.toml"));
    let json = |line: &str| sim.json(&line.split(' ').collect::<Vec<_>>());
    let none = serde_json::json!([]);
    let loaded = json(&format!("device {device}"));
    assert_eq!((&loaded["device"], &loaded["warnings"]), (&"coupled-five-bar".into(), &none));
    let loaded = json(&format!("scene {scene}"));
    assert_eq!((loaded["scene"]["walls"].as_array().unwrap().len(), &loaded["warnings"]), (1, &none));
    assert_eq!(json("home")["homed"], true);
    let gains = json("gains --stiffness 300");
    assert_eq!((&gains["stiffness"], &gains["warnings"]), (&300.0.into(), &none));
    let beyond = json("gains --stiffness 1e9");
    assert!(beyond["warnings"][0]["text"].as_str().unwrap().contains("predicted stable"), "{beyond}");
    json("gains --stiffness 300");
    assert_eq!(json("rules --torque 0.5,0.4 --host ignore")["torque"].as_array().unwrap().len(), 2);
    assert_eq!(json("polarity")["polarity_checked"], true);
    assert_eq!(json("board save")["saved"], true);
    let backup = folder.path("b.json");
    assert!(json(&format!("board backup {backup}"))["settings"].as_array().unwrap().len() > 3);
    assert!(!json(&format!("board restore {backup}"))["restored"].as_array().unwrap().is_empty());
    assert_eq!(json("arm")["state"], "Armed");
    assert_eq!(json("disarm")["state"], "Disarmed");
    assert_eq!(json("faults --clear")["cleared"], serde_json::Value::Null);
}

#[test]
fn the_boot_loader_needs_confirmation_with_motors_on() {
    Sim::start(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]).type_lines(
        "rules --host ignore
        arm
        1: board dfu => the motors are on | --yes
        info => armed | !disarmed
        board dfu --yes",
    );
}

#[test]
fn the_manual_has_a_page_for_every_command() {
    let folder = Folder::new();
    type_lines(&format!("completions --man {}\ncompletions --man => .SH", folder.path("man1")), &[]);
    let page = |name: &str| std::fs::read_to_string(folder.path(&format!("man1/{name}.1")));
    let main = page("haptic").unwrap();
    let mut reference_count = 0;
    for reference in main.split("haptic\\-").skip(1) {
        let name = reference.split("(1)").next().unwrap().replace('\\', "");
        if reference.contains("(1)") && !name.contains(char::is_whitespace) && name != "help" {
            reference_count += 1;
            assert!(page(&format!("haptic-{name}")).is_ok(), "haptic(1) names haptic-{name}(1), which is missing");
        }
    }
    assert!(reference_count > 20, "haptic(1) names only {reference_count} commands");
    let page = page("haptic-model").unwrap();
    for section in ["EXIT STATUS", "EXAMPLES", "FILES"] {
        assert!(page.contains(section), "{section} in {page}");
    }
}

#[test]
fn existing_files_are_overwritten_only_with_force() {
    let folder = Folder::new();
    let device = "devices/hapkit-paddle.toml";
    for (line, name) in [
        (format!("check {device} --svg"), "a.svg"),
        (format!("check {device} --png"), "a.png"),
        (format!("report {device} --without tune,map,design --out"), "a.html"),
        ("new paddle -o".into(), "a.toml"),
    ] {
        let path = folder.write(name, "mine");
        type_lines(&format!("1: {line} {path} => exists | --force"), &[]);
        assert_eq!(std::fs::read(&path).unwrap(), b"mine", "{line}");
        type_lines(&format!("{line} {path} --force"), &[]);
        assert_ne!(std::fs::read(&path).unwrap(), b"mine", "{line}");
    }
}

#[test]
fn wrong_paths_are_refused_before_anything_starts() {
    let folder = Folder::new();
    let (wrong, progress) = (folder.path("x.png"), folder.path("missing/p.json"));
    let missing = "/nonexistent does not exist; make the folder first";
    type_lines(&format!("1: view --port sim --listen 127.0.0.1:0 --record-to /nonexistent => {missing}"), &[]);
    let line = "devices/coupled-five-bar.toml --normal 0,1";
    type_lines(&format!("2: range {line} --rate 1000 --cutoff 20 --svg {wrong} => extension | --png"), &[]);
    let line =
        ["measure-range", "devices/coupled-five-bar.toml", "--port=sim", "--normal=0,1", "--progress", &progress];
    let message = refusal(1, &line);
    assert!(message.contains("there is no such folder") && message.matches("p.json").count() == 1, "{message}");
    assert!(!std::path::Path::new(&wrong).exists());
}
