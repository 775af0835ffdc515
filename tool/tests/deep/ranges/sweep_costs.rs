//! What long sweeps cost: the tables of docs/results.md, in seconds of one core, which other work on the computer
//! hardly changes.
//!
//! `cargo test --release --locked -p haptic --test deep sweep_costs -- --ignored --nocapture` prints them.
#![cfg(target_os = "linux")]

use crate::common::haptic;

/// Seconds of one core that the children of this process have used so far: clock ticks, which Linux shows as
/// hundredths.
fn used() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    // Behind the name, which may have blanks: user and system time of children are fields 16 and 17 of all.
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    fields[13..15].iter().map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
}

fn cost(arguments: &[&str]) -> f64 {
    let before = used();
    haptic(arguments).assert().success();
    used() - before
}

#[test]
#[ignore = "minutes: it prints tables of docs/results.md"]
fn they_are_printed() {
    let devices = [("hapkit-paddle", "1"), ("coupled-five-bar", "0.6,0.8"), ("phantom-premium-1.5", "0.6,0.8,0")];
    println!("| seconds of one core | 1 joint | 2 joints | 3 joints |\n|---|--:|--:|--:|");
    let row = |what: &str, arguments: &dyn Fn(&str, &str) -> Vec<String>| {
        let costs = devices.map(|(device, normal)| {
            let arguments = arguments(&format!("devices/{device}.toml"), normal);
            format!("{:.2}", cost(&arguments.iter().map(String::as_str).collect::<Vec<_>>()))
        });
        println!("| {what} | {} |", costs.join(" | "));
    };
    let words = |words: &[&str]| words.iter().map(ToString::to_string).collect::<Vec<String>>();
    for points in ["2000", "20000", "200000"] {
        row(&format!("`map --points {points}`"), &|device, normal| {
            words(&["map", device, "--normal", normal, "--points", points])
        });
    }
    for points in ["300", "3000"] {
        row(&format!("`design --points {points}`"), &|device, normal| {
            words(&["design", device, "--normal", normal, "--points", points])
        });
    }
    row("`estimators`", &|device, normal| words(&["tune", "estimators", device, "--normal", normal]));
    for rates in ["5000", "1000,5000,10000,20000"] {
        row(&format!("`tune --rates {rates}`"), &|device, normal| {
            words(&["tune", device, "--normal", normal, "--rates", rates])
        });
    }
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("page.html");
    row("`report`, without the estimators and tune", &|device, _| {
        words(&["report", device, "--without", "estimators,tune", "--force", "--out", page.to_str().unwrap()])
    });
}
