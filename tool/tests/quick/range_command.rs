//! `haptic range` as other programs see it: its JSON, its pictures, its refusals.

use crate::common::{self, file, json};
use serde_json::Value;

const DEVICE: &str = "devices/serial-3r.toml";

fn haptic(arguments: &[&str]) -> assert_cmd::assert::Assert {
    common::haptic(arguments).assert()
}

const POSE: [&str; 7] = ["--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--rate", "1000", "--cutoff", "20", "--undamped"];

#[test]
fn the_document_has_the_documented_keys() {
    let document = json(&[&["range", DEVICE], &POSE[..]].concat());
    let keys: Vec<&String> = document.as_object().unwrap().keys().collect();
    let asked = ["cutoff_hz", "delay_samples", "drive", "normals", "options", "q", "rate_hz"];
    let answer = keys.iter().filter(|key| !asked.contains(&key.as_str()));
    assert!(answer.eq(&["area_ratio", "full", "off", "passive", "w_eff", "w_rr"]), "{keys:?}");
    assert_eq!(keys.len(), asked.len() + 6, "{keys:?}");
    let off: Vec<&String> = document["off"].as_object().unwrap().keys().collect();
    assert_eq!(off, ["area", "boundary", "islands", "kd_max"]);
    let ratio = document["w_rr"].as_f64().unwrap() / document["w_eff"].as_f64().unwrap();
    assert!((document["area_ratio"].as_f64().unwrap() / (ratio * ratio) - 1.0).abs() < 1e-6);
}

#[test]
fn a_host_that_is_too_late_is_told_in_its_own_seconds() {
    let host = ["--host-rate", "1000", "--host-delay", "1"];
    let failed = haptic(&[&["range", DEVICE], &POSE[..], &host].concat()).failure().get_output().stderr.clone();
    let failed = String::from_utf8(failed).unwrap();
    assert!(failed.contains("a force from the host may be 0 to 0.064 s old") && failed.contains("not 1 s"), "{failed}");
}

#[test]
fn rate_and_cutoff_have_the_defaults_that_measure_range_has() {
    let pose = ["--q=0.6,0.9,-0.7", "--normal=-1,0.5"];
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

/// The demo's wall: stable with the feed-forward alone.
#[test]
fn the_frequency_at_which_a_wall_buzzes_stands_beside_its_limit() {
    let folder = tempfile::tempdir().unwrap();
    let device = file("coupled-five-bar.toml");
    let asked = ["range", &device, "--q=2.6,1.75", "--normal=0.2588,0.9659", "--rate", "1000", "--cutoff", "100"];
    let wall = ["--board", "odrive-v3", "--kd", "0,40,200", "--wall", "22000,40"];
    let document = json(&[&asked[..], &wall].concat());
    let hz = |mode: &str, point: usize| document[mode]["boundary"][point]["hz"].as_f64();
    for mode in ["off", "full"] {
        assert!(hz(mode, 0).unwrap() < 6.0 && hz(mode, 2).is_none(), "{mode}: nothing is stable at 200 N s/m");
        assert!((55.0..62.0).contains(&hz(mode, 1).unwrap()), "{document}");
    }
    let swings = &document["ripple"]["wall"]["swings"];
    let grows = |mode: &str| swings[mode]["growth_per_s"].as_f64().unwrap();
    assert!(grows("off") > 10.0 && grows("full") < 0.0 && swings.get("washout").is_none(), "{swings}");
    let said = haptic(&[&asked[..], &wall].concat()).success().get_output().stdout.clone();
    let said = String::from_utf8(said).unwrap();
    assert!(
        said.contains("buzz Hz") && said.matches("predicted to buzz at 64.8 Hz, growing by").count() == 1,
        "{said}"
    );

    let scene = folder.path().join("scene.toml");
    let wall = "[[wall]]\npoint = [0.0, 0.1]\nnormal = [0.0, 1.0]\nstiffness = 90e3\ndamping = 40.0\n";
    std::fs::write(&scene, format!("rate_hz = 1000\ncutoff_hz = 100\n{wall}")).unwrap();
    let checked = json(&["check", &device, scene.to_str().unwrap()]);
    let hz = checked["scenes"][0]["contacts"][0]["buzz"]["hz"].as_f64().unwrap();
    let doubt = checked["warnings"][0]["text"].as_str().unwrap();
    assert!(doubt.contains(&format!("it will vibrate at about {hz:.0} Hz unless")), "{doubt}");
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
    let device = file("coupled-five-bar.toml");
    let at = ["--q=2.6,1.75", "--normal=0.94,-0.34", "--rate", "1000", "--cutoff", "20", "--delay", "1"];
    let said =
        haptic(&[&["range", &device, "--washout", "2", "--svg", svg.to_str().unwrap()], &at[..]].concat()).success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    let drawn = std::fs::read_to_string(svg).unwrap();
    assert!(said.contains("delay 1 sample,") && drawn.contains("delay 1 sample,"), "{said}");
    for symbol in ["b = 0.121 N s/m", "fc = ", "Δ = ", "Colgate and Schenkel", "Weff, Wrr:", "washout 2 Hz"] {
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
fn a_wall_that_a_computer_renders_stands_beside_the_boards_in_numbers_words_and_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let svg = folder.path().join("host.svg");
    let board = ["range", DEVICE, "--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--rate", "20000", "--cutoff", "500"];
    let host = ["--host-rate", "1000", "--host-delay", "0.00101", "--svg", svg.to_str().unwrap()];
    let document = json(&[&board[..], &host, &["--kd", "0"]].concat());
    assert_eq!(
        (document["host"]["rate_hz"].as_f64(), document["host"]["delay_s"].as_f64()),
        (Some(1e3), Some(1.05e-3))
    );
    // At no damping no velocity acts, so this is a board of 1 kHz with 1.05 samples of delay.
    let slow = ["--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--delay", "1.05", "--kd", "0"];
    let slow = json(&[&["range", DEVICE], &slow[..]].concat());
    let kp = |domain: &Value| domain["boundary"][0]["kp"].as_f64().unwrap();
    assert!((kp(&document["host"]) / kp(&slow["off"]) - 1.0).abs() < 1e-6, "{document}");
    assert!(document["off"]["area"].as_f64().unwrap() > 100.0 * document["host"]["area"].as_f64().unwrap());
    let drawn = std::fs::read_to_string(svg).unwrap();
    assert!(drawn.contains("rendered by a computer at 1000 Hz, 1.1 ms late"), "the picture names it");
    let said = haptic(&[&board[..], &["--host-rate", "1000"]].concat()).success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    assert!(said.contains("on a computer, 1000 Hz") && said.contains("forces 1 ms old"), "{said}");
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
        (vec!["--normal", "1,0", "--host-rate", "1001"], 2),
        (vec!["--normal", "1,0", "--host-rate", "500", "--host-delay=-1"], 2),
        (vec!["--normal", "1,0", "--host-delay", "0.001"], 2),
        (vec!["--normal", "1,0", "--normal", "0,1", "--host-rate", "500"], 2),
        (vec!["--normal", "1,0", "--rate", "1000", "--cutoff", "20", "--q", "0,0,0"], 1),
    ] {
        let done = haptic(&[&["range", DEVICE], &change[..]].concat()).code(code);
        let error = String::from_utf8(done.get_output().stderr.clone()).unwrap();
        assert!(done.get_output().stdout.is_empty());
        assert!(code == 2 && error.contains("error:") || error.lines().count() == 1, "{change:?}: {error}");
    }
}

#[test]
fn a_feed_forward_that_costs_more_than_it_brings_is_warned_of() {
    // Cables of 300 Hz for a joint of 3e-4 kg m²: the feed-forward, made for a rigid device, drives their mode.
    let text = std::fs::read_to_string(file("coupled-five-bar.toml")).unwrap();
    let soft = text.replacen("\"rigid\"", "{ stiffness = 1065.9, damping = 0.03694 }", 1).replacen(
        "\"rigid\"",
        "{ stiffness = 1065.9, damping = 0.02262 }",
        1,
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("soft.toml");
    std::fs::write(&path, soft).unwrap();
    let of = |device: &str| {
        let pose = ["--q=2.6,1.75", "--normal=0.2588,0.9659", "--rate", "20000", "--cutoff", "500"];
        json(&[&["range", device], &pose[..]].concat())
    };
    let found = of(path.to_str().unwrap());
    assert!(found["area_ratio"].as_f64().unwrap() < 0.7, "{}", found["area_ratio"]);
    assert!(found["warnings"][0]["text"].as_str().unwrap().contains("costs more than it brings"), "{found}");
    let rigid = of("devices/coupled-five-bar.toml");
    assert!(rigid["area_ratio"].as_f64().unwrap() > 1.2 && rigid.get("warnings").is_none(), "{}", rigid["area_ratio"]);
}

/// Uneven joint damping makes it creep at every gain: that is no wall "0.00 times as stiff".
#[test]
fn a_feed_forward_with_which_nothing_is_stable_is_said_to_be_so() {
    let text = std::fs::read_to_string(file("coupled-five-bar.toml")).unwrap();
    let uneven =
        text.replacen("viscous = 0.001", "viscous = 0.1", 1).replacen("viscous = 0.001\n", "viscous = 1.0e-4\n", 1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("uneven.toml");
    std::fs::write(&path, uneven).unwrap();
    let pose = ["--q=2.6,1.75", "--normal=0.2588,0.9659", "--rate", "1000", "--cutoff", "20"];
    let found = json(&[&["range", path.to_str().unwrap()], &pose[..]].concat());
    let said = found["warnings"].to_string();
    assert!(said.contains("the feed-forward leaves nothing stable here") && !said.contains("0.00 times"), "{said}");
}

#[test]
fn a_washout_that_costs_is_doubted_where_the_feed_forward_in_full_brings_much() {
    // Where Wrr is many times Weff, 2 Hz are no longer far below what a loop at 200 Hz does.
    let found = json(&[
        "range",
        "devices/capstan-pantograph.toml",
        "--q=2.968991857470883,0.19068693916888918",
        "--normal=-0.6056607432341015,-0.2794685223955733",
        "--rate",
        "200",
        "--cutoff",
        "20",
        "--delay",
        "0.5",
        "--washout",
        "2",
    ]);
    let number = |of: &str| found[of]["area"].as_f64().unwrap();
    assert!(number("washout") < 0.5 * number("off") && number("full") > 10.0 * number("off"), "{found}");
    let said = found["warnings"].to_string();
    assert!(
        said.contains("the washout costs more than it brings") && !said.contains("the feed-forward costs"),
        "{said}"
    );
    // 1 Hz leaves 0.85 of the stiffest wall, half of that more than twice as stiff a one.
    assert!(said.contains("a corner of 0.5 Hz costs nothing"), "{said}");
}
