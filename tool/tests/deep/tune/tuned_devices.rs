//! docs/results/tuned.csv: results of `haptic tune` for a wall of each shipped device.
//!
//! `UPDATE_DOCS=1 cargo test --release --locked -p haptic --test deep tuned_devices -- --ignored` updates the table.

use crate::common::{document, json};
use serde_json::Value;
use std::fmt::Write;

/// Devices, each with a scene whose first wall is tuned.
const SCENES: [(&str, &str); 9] = [
    ("coupled-five-bar", "wall"),
    ("fictive-five-bar-turret", "ball"),
    ("hapkit-paddle", "wall"),
    ("haply-2diy", "wall-stiff"),
    ("phantom-premium-1.5", "table"),
    ("woodenhaptics", "room"),
    ("serial-3r", "wall"),
    ("pantograph-mk2", "corner"),
    ("capstan-pantograph", "wall"),
];

const HEADER: &str = "\
device,scene,scene (N/m),tuned (N/m),times,limited by,rule of thumb (N/m),with (4) (N/m),ripple with (4) (N),\
ripple before (N),ripple after (N),on the board before (N),on the board after (N),struck at rest up to before (N/m),\
struck at rest up to after (N/m)
";

fn tune(device: &str, scene: &str) -> Value {
    let device_file = format!("devices/{device}.toml");
    let scene_file = format!("devices/scenes/{device}/{scene}.toml");
    json(&["tune", &device_file, "--scene", &scene_file, "--measure"])
}

fn table_row(device: &str, scene: &str, report: &Value) -> String {
    let rounded = |value: &Value| value.as_f64().map_or("-".into(), |value| format!("{value:.0}"));
    let newtons = |value: &Value| value.as_f64().map_or("-".into(), |value| format!("{value:.3}"));
    let times = |value: &Value| value.as_f64().map_or("-".into(), |value| format!("{value:.2}"));
    let rest = |measured: &Value| {
        let open = if measured["open"].is_null() { "" } else { "≥ " };
        format!("{open}{}", rounded(&measured["stiffness"]))
    };
    let washout = &report["feed_forwards"][0];
    let rule = report["limits"].as_array().unwrap().last().unwrap();
    format!(
        "{device},{scene},{},{},{},{},{},{},{},{},{},{},{},{},{}",
        rounded(&report["scene"]["stiffness"]),
        rounded(&report["best"]["stiffness"]),
        times(&report["times"]),
        report["active"].as_str().unwrap(),
        rounded(&rule["stiffness"]),
        rounded(&washout["best"]["stiffness"]),
        newtons(&washout["ripple_n"]),
        newtons(&report["ripple_limit_n"]),
        newtons(&report["best"]["ripple_n"]),
        newtons(&report["scene_measured"]["ripple_n"]),
        newtons(&report["measured"]["ripple_n"]),
        rest(&report["scene_measured"]),
        rest(&report["measured"]),
    )
}

#[test]
#[ignore = "takes minutes: measures nine devices on simulated boards for docs/results/tuned.csv"]
fn the_table_holds_the_results_of_the_command() {
    let mut table = String::from(HEADER);
    for (device, scene) in SCENES {
        let report = tune(device, scene);
        let best = report["best"]["stiffness"].as_f64().unwrap();
        for other in report["others"].as_array().unwrap() {
            assert!(other["stiffness"].as_f64().unwrap() <= 1.03 * best, "{device}: {other} beats {best} N/m");
        }
        let _ = writeln!(table, "{}", table_row(device, scene, &report));
        println!("{}", table.lines().last().unwrap());
    }
    let remedy = "run UPDATE_DOCS=1 cargo test --release -p haptic --test deep tuned_devices -- --ignored";
    assert_eq!(document("docs/results/tuned.csv", &table), table, "{remedy}");
}
