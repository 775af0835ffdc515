//! `haptic range` as other programs use it: JSON, pictures, and refusals.

use crate::common::{Folder, json, output, read, refusal, type_lines};
use serde_json::Value;

const DEVICE: &str = "devices/serial-3r.toml";
const POSE_OPTIONS: [&str; 7] =
    ["--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--rate", "1000", "--cutoff", "20", "--undamped"];
/// Command for the demo's device in the demo's pose, along its wall's normal.
const DEMO_RANGE: [&str; 4] = ["range", "devices/coupled-five-bar.toml", "--q=2.6,1.75", "--normal=0.2588,0.9659"];

fn range(more: &[&str]) -> Value {
    json(&[&["range", DEVICE], &POSE_OPTIONS[..], more].concat())
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn the_document_has_the_documented_keys() {
    let document = range(&[]);
    let keys: Vec<&String> = document.as_object().unwrap().keys().collect();
    let settings = ["cutoff_hz", "delay_samples", "drive", "normals", "options", "q", "rate_hz"];
    let results = keys.iter().filter(|key| !settings.contains(&key.as_str()));
    assert!(results.eq(&["area_ratio", "full", "off", "passive", "w_eff", "w_rr"]), "{keys:?}");
    assert_eq!(keys.len(), settings.len() + 6, "{keys:?}");
    let off: Vec<&String> = document["off"].as_object().unwrap().keys().collect();
    assert_eq!(off, ["area", "boundary", "islands", "kd_max"]);
    let ratio = number(&document["w_rr"]) / number(&document["w_eff"]);
    assert!((number(&document["area_ratio"]) / (ratio * ratio) - 1.0).abs() < 1e-6);
}

#[test]
fn rate_and_cutoff_have_the_defaults_of_measure_range() {
    let pose = ["range", DEVICE, "--q=0.6,0.9,-0.7", "--normal=-1,0.5"];
    assert_eq!(json(&pose), json(&[&pose[..], &["--rate", "1000", "--cutoff", "20"]].concat()));
    type_lines(
        "range --help => [default: 1000] | [default: 20]
        measure-range --help => [default: 1000] | [default: 20]",
        &[],
    );
}

#[test]
fn the_boundary_has_points_at_the_requested_dampings() {
    let document = range(&["--kd", "0.5,0.25", "--washout", "2"]);
    for mode in ["off", "full", "washout"] {
        let kd: Vec<f64> = document[mode]["boundary"].as_array().unwrap().iter().map(|p| number(&p["kd"])).collect();
        assert_eq!(kd, [0.5, 0.25], "{mode}");
    }
}

/// The demo's wall is stable only with the feed-forward.
#[test]
fn the_frequency_of_a_buzzing_wall_is_printed_with_its_limit() {
    let folder = Folder::new();
    let loop_ = ["--rate", "1000", "--cutoff", "100", "--board", "odrive-v3", "--kd", "0,40,200", "--wall", "22000,40"];
    let line = [&DEMO_RANGE[..], &loop_].concat();
    let document = json(&line);
    let hz = |mode: &str, point: usize| document[mode]["boundary"][point]["hz"].as_f64();
    for mode in ["off", "full"] {
        // At 200 N s/m no stiffness is stable, so there is no frequency of a buzz.
        assert!(hz(mode, 0).unwrap() < 6.0 && hz(mode, 2).is_none(), "{mode}");
        assert!((55.0..62.0).contains(&hz(mode, 1).unwrap()), "{document}");
    }
    let swings = &document["ripple"]["wall"]["swings"];
    let grows = |mode: &str| number(&swings[mode]["growth_per_s"]);
    assert!(grows("off") > 10.0 && grows("full") < 0.0 && swings.get("washout").is_none(), "{swings}");
    let text = output(&line);
    assert_eq!((text.contains("buzz Hz"), text.matches("to buzz at 64.8 Hz, growing by").count()), (true, 1), "{text}");
    let wall = "[[wall]]\npoint = [0.0, 0.1]\nnormal = [0.0, 1.0]\nstiffness = 90e3\ndamping = 40.0\n";
    let scene = folder.write("scene.toml", format!("rate_hz = 1000\ncutoff_hz = 100\n{wall}"));
    let check_report = json(&["check", DEMO_RANGE[1], &scene]);
    let hz = number(&check_report["scenes"][0]["contacts"][0]["buzz"]["hz"]);
    let warning = check_report["warnings"][0]["text"].as_str().unwrap();
    assert!(warning.contains(&format!("it will vibrate at about {hz:.0} Hz unless")), "{warning}");
}

#[test]
fn pictures_are_svg_or_png_and_explain_their_symbols() {
    let folder = Folder::new();
    let (svg, png) = (folder.path("range.svg"), folder.path("range.png"));
    let files = ["--washout", "2", "--svg", &svg, "--png", &png];
    let loop_ = ["--rate", "1000", "--cutoff", "20", "--delay", "1"];
    let said = output(&[&["range", DEMO_RANGE[1], "--q=2.6,1.75", "--normal=0.94,-0.34"], &loop_[..], &files].concat());
    let svg = std::fs::read_to_string(svg).unwrap();
    assert!(svg.contains("<title>coupled-five-bar") && std::fs::read(png).unwrap().starts_with(b"\x89PNG"));
    assert!(said.contains("delay 1 sample,") && svg.contains("delay 1 sample,"), "{said}");
    for symbol in ["b = 0.121 N s/m", "fc = ", "Δ = ", "Colgate and Schenkel", "Weff = ", "washout 2 Hz"] {
        assert!(svg.contains(symbol), "{symbol}");
    }
}

#[test]
fn option_why_prints_and_draws_the_cost_of_each_effect() {
    let folder = Folder::new();
    let svg = folder.path("why.svg");
    let document = range(&["--why", "--board", "h-bridge-f405", "--svg", &svg]);
    let effects = document["why"]["effects"].as_array().unwrap();
    let names: Vec<&str> = effects.iter().map(|effect| effect["effect"].as_str().unwrap()).collect();
    assert_eq!(names, ["sampling", "delay", "drive", "filter"]);
    for effect in effects {
        let kp = |limits: &Value| number(&limits["limits"]["off"]["kp_max"]);
        let takes = 1.0 - kp(&document["why"]) / kp(effect);
        assert!((number(&effect["takes"]["off"]) - takes).abs() < 1e-12);
    }
    assert!(std::fs::read_to_string(svg).unwrap().contains("filter: no filter"));
}

#[test]
fn a_wall_rendered_by_a_computer_is_compared_with_the_boards() {
    let folder = Folder::new();
    let svg = folder.path("host.svg");
    let board = ["range", DEVICE, "--q=0.6,0.9,-0.7", "--normal=-1,0.5", "--rate", "20000", "--cutoff", "500"];
    let host = ["--host-rate", "1000", "--host-delay", "0.00101", "--svg", &svg];
    let document = json(&[&board[..], &host, &["--kd", "0"]].concat());
    let host = &document["host"];
    assert_eq!((number(&host["rate_hz"]), number(&host["delay_s"])), (1e3, 1.05e-3));
    // Without damping the velocity does not matter, so this equals a board of 1 kHz with 1.05 samples of delay.
    let slow = json(&[&board[..4], &["--delay", "1.05", "--kd", "0"]].concat());
    let kp = |domain: &Value| number(&domain["boundary"][0]["kp"]);
    assert!((kp(host) / kp(&slow["off"]) - 1.0).abs() < 1e-6, "{document}");
    assert!(number(&document["off"]["area"]) > 100.0 * number(&host["area"]));
    let svg = std::fs::read_to_string(svg).unwrap();
    assert!(svg.contains("computer, 1000 Hz, 1.1 ms late"), "the picture lacks the computer's wall");
    let said = output(&[&board[..], &["--host-rate", "1000"]].concat());
    assert!(said.contains("on a computer, 1000 Hz") && said.contains("forces 1 ms old"), "{said}");
}

#[test]
fn impossible_ranges_are_refused() {
    for options in [
        "--normal 0,0",
        "--normal 1,0,0",
        "--normal 1,0 --cutoff 500",
        "--normal 1,0 --rate -5",
        "--normal 1,0 --delay -1",
        "--normal 1,0 --kd=-1",
        "--normal 1,0 --hand 1,2",
        "--normal 1,0 --hand=1,2,-3",
        "--normal 1,0 --difference-over 65",
        "--normal 1,0 --host-rate 1001",
        "--normal 1,0 --host-rate 500 --host-delay=-1",
        "--normal 1,0 --host-delay 0.001",
        "--normal 1,0 --normal 0,1 --host-rate 500",
        "--normal 1,0 --normal 0,1 --why",
        "--normal 1,0 --cutoff 20 --board odrive-v3",
    ] {
        let words: Vec<&str> = ["range", DEVICE].into_iter().chain(options.split(' ')).collect();
        let error = refusal(2, &words);
        assert!(error.contains("error:"), "{options}: {error}");
    }
    let error = refusal(1, &["range", DEVICE, "--normal", "1,0", "--q", "0,0,0"]);
    assert_eq!(error.lines().count(), 1, "{error}");
    let error = refusal(2, &["range", DEVICE, "--normal=-1,0.5", "--host-rate", "1000", "--host-delay", "1"]);
    assert!(error.contains("a force from the host may be 0 to 0.064 s old") && error.contains("not 1 s"), "{error}");
}

/// The feed-forward, computed for a rigid device, excites the mode of cables of 300 Hz at joints of 3e-4 kg m². Uneven
/// joint damping makes a device creep at every gain; the text must not call this a wall "0.00 times as stiff".
#[test]
fn a_costly_feed_forward_causes_a_warning() {
    let shipped = json(&[&DEMO_RANGE[..], &["--rate", "20000", "--cutoff", "500"]].concat());
    assert!(number(&shipped["area_ratio"]) > 1.2 && shipped.get("warnings").is_none(), "{shipped}");
    let folder = Folder::new();
    let text = read(DEMO_RANGE[1]);
    let cable = |damping: &str| format!("{{ stiffness = 1065.9, damping = {damping} }}");
    let soft_device = text.replacen("\"rigid\"", &cable("0.03694"), 1).replacen("\"rigid\"", &cable("0.02262"), 1);
    let uneven = text.replacen("viscous = 0.001", "viscous = 0.1", 1);
    let uneven = uneven.replacen("viscous = 0.001\n", "viscous = 1.0e-4\n", 1);
    let of = |text: String, rate: &str, cutoff: &str| {
        let device = folder.write("device.toml", text);
        json(&[&["range", &device], &DEMO_RANGE[2..], &["--rate", rate, "--cutoff", cutoff]].concat())
    };
    let found = of(soft_device, "20000", "500");
    assert!(number(&found["area_ratio"]) < 0.7, "{}", found["area_ratio"]);
    assert!(found["warnings"][0]["text"].as_str().unwrap().contains("costs more than it brings"), "{found}");
    let text = of(uneven, "1000", "20")["warnings"].to_string();
    assert!(text.contains("the feed-forward leaves nothing stable here") && !text.contains("0.00 times"), "{text}");
}

/// If Wrr is many times Weff, 2 Hz is no longer far below the frequencies of a loop at 200 Hz.
#[test]
fn a_washout_that_costs_stability_causes_a_warning() {
    let pose = ["--q=2.968991857470883,0.19068693916888918", "--normal=-0.6056607432341015,-0.2794685223955733"];
    let loop_ = ["--rate", "200", "--cutoff", "20", "--delay", "0.5", "--washout", "2"];
    let found = json(&[&["range", "devices/capstan-pantograph.toml"], &pose[..], &loop_].concat());
    let area = |mode: &str| number(&found[mode]["area"]);
    assert!(area("washout") < 0.5 * area("off") && area("full") > 10.0 * area("off"), "{found}");
    let text = found["warnings"].to_string();
    assert!(text.contains("the washout costs more than it") && !text.contains("the feed-forward costs"), "{text}");
    // A washout of 1 Hz leaves 0.85 of the stiffness of the stiffest wall, a washout of 0.5 Hz all of it.
    assert!(text.contains("a corner of 0.5 Hz costs nothing"), "{text}");
}
