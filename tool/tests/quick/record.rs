//! `haptic record` writes complete or cut files that the library of the format can open.

use crate::common::shipped_path;
use crate::common::sim::{Sim, wait_until};
use haptic_show::recorder::{Recording, protobuf};
use mcap::MessageStream;
use mcap::read::Options;
use predicates::prelude::*;
use predicates::str::contains;
use std::io::Read;
use std::path::Path;
use std::process::Command;

/// Returns a board with a wall, and a hand that presses the wall again and again while the motors are on.
fn pressed_board() -> Sim {
    Sim::start(&["--fast", "--hand", "loop", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")])
}

/// Reads rows up to the last complete record with the library of the format. Returns log times and numbers by schema.
fn read_rows(bytes: &[u8]) -> Vec<(u64, Vec<f64>)> {
    let options = Options::IgnoreEndMagic | Options::ValidateChunkCrcs;
    let messages = MessageStream::new_with_options(bytes, options).unwrap();
    let mut found = Vec::new();
    for message in messages.map_while(Result::ok) {
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("protobuf", "protobuf"));
        if message.channel.topic == "/rows" {
            assert_eq!(schema.name, "haptic.Row");
            let row = protobuf::find_message(&schema.data, &schema.name).unwrap();
            found.push((message.log_time, protobuf::decode_numbers(&row, &message.data)));
        }
    }
    found
}

fn missing_rows(steps: impl Iterator<Item = f64>) -> u64 {
    let steps: Vec<f64> = steps.collect();
    steps.windows(2).map(|pair| (pair[1] - pair[0]) as u64 - 1).sum()
}

#[test]
fn both_formats_contain_every_step_and_a_description() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["run.csv", "run.mcap"] {
        let sim = pressed_board();
        let path = folder.path().join(name);
        let path = path.to_str().unwrap();
        let recorded = ["record", path, "--seconds", "0.5"];
        sim.run(&[&recorded[..], &["--arm"]].concat())
            .success()
            .stderr(contains(format!("10000 rows are in {path}, ")).and(contains("none lost")));
        let recording = Recording::load(Path::new(path)).unwrap();
        assert_eq!((recording.rows.len(), recording.torn, recording.rate_hz()), (10_000, false, Some(20_000.0)));
        assert_eq!(missing_rows(recording.rows.iter().map(|row| row[0])), 0);
        let column = |name: &str| recording.column(name).unwrap_or_else(|| panic!("{name}: {:?}", recording.columns));
        let last = recording.rows.last().unwrap();
        assert!((last[column("time_s")] - 9_999.0 / 20e3).abs() < 1e-9);
        assert_eq!(last[column("state")], 1.0, "armed");
        assert!(last[column("counts0")] != 0.0 && last[column("counts0")].fract() == 0.0);
        // The shipped five-bar's home is at 2.3 rad.
        assert!((last[column("q0_rad")] - 2.3).abs() < 0.3, "{}", last[column("q0_rad")]);
        let about = recording.about.join("\n");
        for part in ["date 20", "board simulated", "device coupled-five-bar", "wall 0: plane", "scene {", "rules {"] {
            assert!(about.contains(part), "{part} in {about}");
        }
        let rules = recording.about.iter().find_map(|line| line.strip_prefix("rules ")).unwrap();
        let rules: serde_json::Value = serde_json::from_str(rules).unwrap();
        for list in [&rules["limits"]["torque"], &rules["limits"]["speed"], &rules["index_period"]] {
            assert_eq!(list.as_array().unwrap().len(), 2, "one number per joint: {rules}");
        }
        assert_eq!(recording.about.last().unwrap(), "10000 rows, none lost");
        sim.run(&recorded).code(1).stderr(contains("exists").and(contains("--force")));
        let json = sim.json(&[&recorded[..], &["--force", "--rate", "100"]].concat());
        assert_eq!((&json["rows"], json["missing"].as_u64()), (&serde_json::json!(50), Some(0)));
        assert_eq!(json["bytes"].as_u64(), Some(std::fs::metadata(path).unwrap().len()));
    }
    let sim = pressed_board();
    let path = folder.path().join("run.txt");
    sim.run(&["record", path.to_str().unwrap()]).code(2).stderr(contains(".mcap"));
    // Another program can read channels, counts, times and metadata.
    let bytes = std::fs::read(folder.path().join("run.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.metadata_count, statistics.channel_count), (50, 2, 2));
    let head = mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap().metadata;
    for (name, value) in [
        ("device", "coupled-five-bar"),
        ("rate_hz", "20000"),
        ("divider", "200"),
        ("firmware", env!("CARGO_PKG_VERSION")),
        ("delay_samples", "0.5"),
    ] {
        assert_eq!(head[name], value, "{name}");
    }
    let end = mcap::read::metadata(&bytes, &summary.metadata_indexes[1]).unwrap().metadata;
    assert_eq!((end["rows"].as_str(), end["missing"].as_str()), ("50", "0"));
    let rows = read_rows(&bytes);
    assert!(rows.windows(2).all(|pair| pair[1].0 - pair[0].0 == 10_000_000), "10 ms between rows");
    assert!(rows[0].0 > 1_700_000_000_000_000_000, "since 1970");
}

#[test]
fn a_plain_recording_is_one_line_of_names_and_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.csv");
    let words = ["record", path.to_str().unwrap(), "--plain", "--seconds", "0.1"];
    pressed_board().run(&[&words[..], &["--arm"]].concat()).success();
    let text = std::fs::read_to_string(&path).unwrap();
    let (head, rows) = text.split_once('\n').unwrap();
    let number = |field: &str| field.parse::<f64>().unwrap_or_else(|_| panic!("{field} in\n{}", &text[..300]));
    let rows: Vec<Vec<f64>> = rows.lines().map(|row| row.split(',').map(number).collect()).collect();
    let names: Vec<&str> = head.split(',').collect();
    assert_eq!((rows.len(), names[..2].to_vec()), (2_000, vec!["step", "time_s"]));
    assert!(rows.iter().all(|row| row.len() == names.len()));
    let state = names.iter().position(|name| *name == "state").unwrap();
    assert_eq!(rows[1_999][state], 1.0, "armed");
    let words = ["record", "plain.mcap", "--plain"];
    pressed_board().run(&words).code(2).stderr(contains("--plain applies to CSV"));
}

#[test]
#[cfg(unix)]
fn a_killed_recording_is_readable_to_its_last_full_chunk() {
    let sim = pressed_board();
    let folder = tempfile::tempdir().unwrap();
    for (round, least) in [10_000, 2_000_000].into_iter().enumerate() {
        let path = folder.path().join(format!("{round}.mcap"));
        let mut tool = sim.spawn(&["record", path.to_str().unwrap()]);
        wait_until("bytes on disk", || std::fs::metadata(&path).is_ok_and(|about| about.len() >= least));
        tool.kill().unwrap();
        tool.wait().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        // The rows before the cut are readable, at any place of the cut.
        for end in [bytes.len(), bytes.len() - 7, bytes.len() * 2 / 3] {
            let found = read_rows(&bytes[..end]);
            assert_eq!(missing_rows(found.iter().map(|(_, row)| row[0])), 0);
            let cut = folder.path().join("cut.mcap");
            std::fs::write(&cut, &bytes[..end]).unwrap();
            let recording = Recording::load(&cut).unwrap();
            assert!(recording.torn);
            assert_eq!(recording.rows, found.into_iter().map(|(_, row)| row).collect::<Vec<_>>());
            assert!(recording.rows.len() > 1_000 || least < 1_000_000, "{}", recording.rows.len());
            assert!(recording.header_value("device").is_some());
        }
        // The board has noticed the loss and accepts the next tool.
        sim.wait_for_state(|state| state == "Disarmed");
    }
}

#[test]
#[cfg(unix)]
fn a_full_disk_ends_the_recording_with_a_counted_loss() {
    let sim = pressed_board();
    let folder = tempfile::tempdir().unwrap();
    let program = assert_cmd::cargo::cargo_bin("haptic");
    for (name, blocks) in [("full.csv", 600), ("full.mcap", 6000)] {
        let path = folder.path().join(name);
        // With its signal ignored, a limit on the size of files (in blocks of 512 bytes) acts like a full disk.
        let line = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" record \"$@\" --rate 20000");
        let arguments = ["-c", &line, program.to_str().unwrap(), path.to_str().unwrap(), "--port", &sim.port];
        let output = Command::new("sh").args(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        let recording = Recording::load(&path).unwrap();
        assert_eq!((output.status.code(), recording.torn), (Some(1), name == "full.mcap"), "{text}");
        let count = recording.rows.len();
        assert!(text.contains(&format!("{name} cannot be written")) && text.contains(&format!("{count} rows are in")));
        assert!(text.contains("could not be written and are lost"), "{text}");
        assert!(count > 500 && !text.contains("none lost"), "{count}: {text}");
        assert_eq!(missing_rows(recording.rows.iter().map(|row| row[0])), 0);
    }
}

#[test]
fn a_lost_board_leaves_a_complete_recording() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["cut.csv", "cut.mcap"] {
        let mut sim = Sim::start(&[]);
        let path = folder.path().join(name);
        let mut tool = sim.spawn(&["record", path.to_str().unwrap(), "--fields", "q,state"]);
        wait_until("bytes on disk", || std::fs::metadata(&path).is_ok_and(|about| about.len() >= 100_000));
        sim.process.child.kill().unwrap();
        let mut errors = String::new();
        tool.stderr.take().unwrap().read_to_string(&mut errors).unwrap();
        assert_eq!(tool.wait().unwrap().code(), Some(1));
        assert!(errors.contains("unplugged or the connection was lost") && errors.contains("rows are in"), "{errors}");
        let recording = Recording::load(&path).unwrap();
        assert!(!recording.torn && recording.rows.len() > 100);
        let last = recording.about.last().unwrap();
        assert!(last.starts_with("cut short: the board was lost") && last.contains(" rows"), "{last}");
    }
}
