//! `haptic range` as other programs see it: its JSON, its pictures, its refusals.

use assert_cmd::Command;
use serde_json::Value;

const DEVICE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/serial-3r.toml");

fn haptic(arguments: &[&str]) -> assert_cmd::assert::Assert {
    Command::cargo_bin("haptic").unwrap().args(arguments).assert()
}

fn json(arguments: &[&str]) -> Value {
    let done = haptic(arguments).success();
    serde_json::from_slice(&done.get_output().stdout).unwrap()
}

const POSE: [&str; 8] =
    ["--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--rate", "1000", "--cutoff", "20", "--json", "--undamped"];

#[test]
fn the_document_has_the_documented_keys() {
    let document = json(&[&["range", DEVICE], &POSE[..]].concat());
    let keys: Vec<&String> = document.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["area_ratio", "full", "off", "w_eff", "w_rr"]);
    let off: Vec<&String> = document["off"].as_object().unwrap().keys().collect();
    assert_eq!(off, ["area", "boundary", "islands", "kd_max"]);
    let ratio = document["w_rr"].as_f64().unwrap() / document["w_eff"].as_f64().unwrap();
    assert!((document["area_ratio"].as_f64().unwrap() / (ratio * ratio) - 1.0).abs() < 1e-6);
}

#[test]
fn rate_and_cutoff_have_the_defaults_that_measure_range_has() {
    let pose = ["--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--json"];
    let said = json(&[&["range", DEVICE], &pose[..]].concat());
    assert_eq!(said, json(&[&["range", DEVICE, "--rate", "1000", "--cutoff", "20"], &pose[..]].concat()));
    for command in ["range", "measure-range"] {
        let help = haptic(&[command, "--help"]).success().get_output().stdout.clone();
        let help = String::from_utf8(help).unwrap();
        assert!(help.contains("[default: 1000]") && help.contains("[default: 20]"), "{command}: {help}");
    }
}

#[test]
fn asked_for_dampings_are_answered_exactly() {
    let document = json(&[&["range", DEVICE, "--kd", "0.5,0.25", "--washout", "2"], &POSE[..]].concat());
    for mode in ["off", "full", "washout"] {
        let kd: Vec<f64> =
            document[mode]["boundary"].as_array().unwrap().iter().map(|p| p["kd"].as_f64().unwrap()).collect();
        assert_eq!(kd, [0.5, 0.25], "{mode}");
    }
}

#[test]
fn a_picture_is_written_as_svg_and_png() {
    let folder = tempfile::tempdir().unwrap();
    let (svg, png) = (folder.path().join("range.svg"), folder.path().join("range.png"));
    let files = ["--svg", svg.to_str().unwrap(), "--png", png.to_str().unwrap()];
    haptic(&[&["range", DEVICE], &POSE[..], &files[..]].concat()).success();
    assert!(std::fs::read_to_string(svg).unwrap().contains("<title>serial-3r"));
    assert!(std::fs::read(png).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn the_picture_says_what_its_symbols_stand_for() {
    let folder = tempfile::tempdir().unwrap();
    let svg = folder.path().join("range.svg");
    let device = DEVICE.replace("serial-3r", "coupled-five-bar");
    let at = ["--q=2.6,1.75", "--normal=0.94,-0.34", "--rate", "1000", "--cutoff", "20", "--delay", "1"];
    let said =
        haptic(&[&["range", &device, "--washout", "2", "--svg", svg.to_str().unwrap()], &at[..]].concat()).success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    let drawn = std::fs::read_to_string(svg).unwrap();
    assert!(said.contains("delay 1 sample,") && drawn.contains("delay 1 sample,"), "{said}");
    // Colgate and Schenkel: kp < b/(T (1/2 + d)), here 80.72 N/m and 1.5 ms.
    for symbol in ["b = 0.121 N s/m", "fc = ", "Δ = ", "T: control period", "d: delay", "Weff, Wrr:", "washout 2 Hz"] {
        assert!(drawn.contains(symbol), "{symbol}");
    }
}

#[test]
fn why_says_what_each_effect_takes_in_numbers_and_as_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let svg = folder.path().join("why.svg");
    let asked = ["--why", "--board", "h-bridge-f405", "--svg", svg.to_str().unwrap()];
    let document = json(&[&["range", DEVICE], &POSE[..], &asked[..]].concat());
    let effects = document["why"]["effects"].as_array().unwrap();
    let names: Vec<&str> = effects.iter().map(|effect| effect["effect"].as_str().unwrap()).collect();
    assert_eq!(names, ["sampling", "delay", "drive", "filter"]);
    for effect in effects {
        let (with, without) = (&document["why"]["limits"]["off"], &effect["limits"]["off"]);
        let takes = 1.0 - with["kp_max"].as_f64().unwrap() / without["kp_max"].as_f64().unwrap();
        assert!((effect["takes"]["off"].as_f64().unwrap() - takes).abs() < 1e-12);
    }
    assert!(std::fs::read_to_string(svg).unwrap().contains("filter: no filter"));
    haptic(&["range", DEVICE, "--normal", "1,0", "--normal", "0,1", "--rate", "1000", "--cutoff", "20", "--why"])
        .code(2);
    haptic(&["range", DEVICE, "--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--board", "odrive-v3"]).code(2);
}

#[test]
fn what_is_wrong_is_refused_with_one_line() {
    for (change, code) in [
        (vec!["--normal", "0,0", "--rate", "1000", "--cutoff", "20"], 2),
        (vec!["--normal", "1,0,0", "--rate", "1000", "--cutoff", "20"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "500"], 2),
        (vec!["--normal", "1,0", "--rate", "-5", "--cutoff", "20"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--delay", "-1"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--kd=-1"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--hand", "1,2"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--hand=1,2,-3"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--difference-over", "65"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--q", "0,0,0"], 1),
    ] {
        let done = haptic(&[&["range", DEVICE], &change[..]].concat()).code(code);
        let error = String::from_utf8(done.get_output().stderr.clone()).unwrap();
        assert!(done.get_output().stdout.is_empty());
        assert!(code == 2 && error.contains("error:") || error.lines().count() == 1, "{change:?}: {error}");
    }
}
