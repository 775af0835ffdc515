//! `haptic replay` computes the same torques from a recording's counts, bit for bit, and reports the first difference.

use crate::common::sim::Sim;
use crate::common::{Folder, haptic, shipped_path, type_lines};
use haptic_show::recorder::Recording;
use predicates::prelude::*;
use predicates::str::contains;
use std::path::Path;

fn record_and_load(path: &Path, arguments: &[&str], wall: &str, more: &[&str]) -> Recording {
    let scene = shipped_path(wall);
    let sim = Sim::start(&[arguments, &["--fast", "--hand", "loop", "--scene", &scene]].concat());
    sim.run(&[&["record", path.to_str().unwrap()], more].concat()).success();
    Recording::load(path).unwrap()
}

fn replay(path: &Path) -> assert_cmd::assert::Assert {
    haptic(&["replay", path.to_str().unwrap()]).assert()
}

#[test]
fn every_device_replays_the_same_torques_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    for (device, wall, name) in [
        ("coupled-five-bar.toml", "scenes/coupled-five-bar/wall.toml", "a.mcap"),
        ("haply-2diy.toml", "scenes/haply-2diy/disc.toml", "a.csv"),
        ("phantom-premium-1.5.toml", "scenes/phantom-premium-1.5/table.toml", "b.mcap"),
    ] {
        let path = folder.path().join(name);
        let recording = record_and_load(&path, &[&shipped_path(device)], wall, &["--arm", "--seconds", "2.5"]);
        let force = recording.column("force_n").unwrap();
        let contact_rows = recording.rows.iter().filter(|row| row[force] > 0.1).count();
        assert!(contact_rows > 1_000, "{device}: a wall is pressed in only {contact_rows} rows");
        replay(&path).success().stdout(contains("the same torques, to the bit"));
    }
}

#[test]
fn the_first_difference_is_named_with_its_step_and_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    let more = ["--arm", "--seconds", "1", "--fields", "q,torque,counts,state"];
    let recording = record_and_load(&path, &[], "scenes/coupled-five-bar/wall.toml", &more);
    let text = std::fs::read_to_string(&path).unwrap();
    replay(&path).success();
    let (torque, counts, step) = (
        recording.column("torque0_n_m").unwrap(),
        recording.column("counts1").unwrap(),
        recording.column("step").unwrap(),
    );
    // In the row with the largest torque the wall is pressed. The last row is left out: without it no row is missing.
    let row = (0..recording.rows.len() - 1)
        .max_by(|a, b| recording.rows[*a][torque].abs().total_cmp(&recording.rows[*b][torque].abs()))
        .unwrap();
    let head = text.lines().position(|line| line.starts_with("step,")).unwrap();
    let change_cell = |row: usize, column: usize, change: &dyn Fn(&str) -> String| {
        let lines = text.lines().enumerate().map(|(index, line)| {
            let mut fields: Vec<String> = line.split(',').map(Into::into).collect();
            if index == head + 1 + row {
                fields[column] = change(&fields[column]);
                return fields.join(",");
            }
            line.to_string()
        });
        std::fs::write(&path, lines.collect::<Vec<_>>().join("\n") + "\n").unwrap();
    };
    let number = recording.rows[row][step] as u64;
    let bit = |torque: &str| f32::from_bits(torque.parse::<f32>().unwrap().to_bits() ^ 1).to_string();
    change_cell(row, torque, &bit);
    let text_of_step = format!("first difference: step {number}, ");
    replay(&path)
        .code(1)
        .stdout(contains(&text_of_step).and(contains("joint 0")).and(contains("(1 step of single precision)")))
        .stderr(contains("the torques differ in 1 of "));
    // A wrong count changes the torques from that step on.
    change_cell(row, counts, &|count| (count.parse::<i64>().unwrap() + 40).to_string());
    replay(&path).code(1).stdout(contains(&text_of_step)).stderr(contains("the torques differ in "));
    // Missing rows end the replay.
    let mut lines: Vec<&str> = text.lines().collect();
    lines.remove(head + 1 + row);
    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
    replay(&path).code(1).stderr(contains(format!("1 row missing before step {}; played up to there", number + 1)));
}

#[test]
fn unplayable_recordings_are_refused() {
    let folder = Folder::new();
    let path = folder.path("a.mcap");
    let sim = Sim::start(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]);
    let record = |options: &str, words: &str| {
        sim.type_lines(&format!("record {path} --force --seconds 0.1 {options}"));
        type_lines(&format!("2: replay {path} => {words}"), &[]);
    };
    record("--rate 1000", "one control step in 20");
    record("--fields usual", "no column counts0");
    sim.type_lines("arm");
    record("", "the motors are on in the first row");
    folder.write("a.mcap", "step,time_s\n1,2\n");
    type_lines(&format!("2: replay {path} => does not have the board's settings"), &[]);
}
