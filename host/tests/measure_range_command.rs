//! `haptic measure-range` on the simulated board that ships: friction, encoders and drive as they are.

use assert_cmd::Command;
use serde_json::Value;

const DEVICE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/coupled-five-bar.toml");

/// A rate at which friction and encoder steps let the tip come to rest before every trial.
const SLOW: [&str; 4] = ["--rate", "1000", "--cutoff", "20"];

fn measure(progress: &std::path::Path, rate: &[&str], more: &[&str]) -> assert_cmd::assert::Assert {
    let fixed = ["measure-range", DEVICE, "--port", "sim", "--normal", "0.6,0.8", "--kd", "15", "--json"];
    let mut command = Command::cargo_bin("haptic").unwrap();
    command.args(fixed).args(rate).args(more).arg("--progress").arg(progress).assert()
}

#[test]
fn a_measurement_is_reported_kept_and_continued() {
    let folder = tempfile::tempdir().unwrap();
    let progress = folder.path().join("progress.json");
    let first = measure(&progress, &SLOW, &["--feed-forward", "off", "--repeats", "1", "--pull", "2"]).success();
    let document: Value = serde_json::from_slice(&first.get_output().stdout).unwrap();
    let point = &document["points"][0];
    assert_eq!((point["mode"].as_str(), point["kd"].as_f64()), (Some("off"), Some(15.0)));
    let once = point["kp"].as_f64().unwrap();
    assert!(once > 1e3, "{once}");

    // The second run keeps the first repeat and adds one.
    let second = measure(&progress, &SLOW, &["--feed-forward", "off", "--repeats", "2", "--pull", "2"]).success();
    let document: Value = serde_json::from_slice(&second.get_output().stdout).unwrap();
    let repeats = document["points"][0]["repeats"].as_array().unwrap();
    assert_eq!((repeats.len(), repeats[0].as_f64()), (2, Some(once)));

    // What was measured at one rate is not mixed with another.
    measure(&progress, &["--rate", "10000", "--cutoff", "200"], &["--feed-forward", "off", "--pull", "2"]).code(2);
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let progress = folder.path().join("progress.json");
    measure(&progress, &SLOW, &["--torque-limit", "0"]).code(2);
    measure(&progress, &SLOW, &["--pull", "50"]).code(2);
    assert!(!progress.exists());
}
