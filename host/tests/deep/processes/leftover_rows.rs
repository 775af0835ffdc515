//! Rows that a killed tool left on the link never reach the next recording, and no count of losses wraps.
#![cfg(unix)]

use crate::common::sim;

use haptic::device_file::DeviceFile;
use haptic::link::{Board, fields};
use haptic::recorder::Recording;
use haptic::sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
use sim::Sim;
use std::path::Path;
use std::process::Child;
use std::thread::sleep;
use std::time::Duration;

#[test]
fn what_is_left_of_another_tools_stream_is_no_row_of_this_one() {
    let device = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    let shared = SharedBoard::new(ready_board(&device, BoardOptions::default()).unwrap());
    let mut killed = Board::over(shared.wire(), "sim").unwrap();
    killed.start_stream(fields("counts").unwrap(), 1).unwrap();
    shared.lock().run(0.2);
    // It read nothing of it and says no good-bye; the next one finds the port as it was left.
    drop(killed);
    let mut next = Board::over(shared.wire(), "sim").unwrap();
    next.start_stream(fields("q,tip").unwrap(), 20).unwrap();
    let mut rows = Vec::new();
    while rows.len() < 100 {
        rows.extend(next.rows(Duration::from_millis(100)).unwrap());
    }
    assert!(rows.iter().all(|row| row.values.len() == 4), "{:?}", rows[0]);
    assert!(rows.windows(2).all(|pair| pair[1].step - pair[0].step == 20));
    let losses = next.losses();
    assert_eq!((losses.missing, losses.batches_lost, losses.garbled), (0, 0, 0));
}

fn wait_for_bytes(path: &Path, tool: &mut Child) {
    for _ in 0..2_000 {
        if std::fs::metadata(path).is_ok_and(|about| about.len() > 20_000) {
            return;
        }
        sleep(Duration::from_millis(10));
    }
    let _ = tool.kill();
    panic!("{} never grew", path.display());
}

#[test]
fn a_recording_after_a_killed_one_holds_only_its_own_rows() {
    let folder = tempfile::tempdir().unwrap();
    for (name, sim) in [("pty", Sim::on_pseudo_terminal(&[])), ("tcp", Sim::start(&[]))] {
        for round in 0..4 {
            let killed = folder.path().join(format!("{name}-killed-{round}.csv"));
            let mut tool =
                sim.spawn(&["stream", "--csv", killed.to_str().unwrap(), "--fields", "counts", "--rate", "20000"]);
            wait_for_bytes(&killed, &mut tool);
            // SIGKILL.
            tool.kill().unwrap();
            tool.wait().unwrap();
            let csv = folder.path().join(format!("{name}-{round}.csv"));
            let next = ["stream", "--seconds", "0.2", "--rate", "200", "--fields", "q,tip", "--csv"];
            let said = sim.run(&[&next[..], &[csv.to_str().unwrap()]].concat()).success();
            let said = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
            let recording = Recording::parse(&std::fs::read_to_string(&csv).unwrap()).unwrap();
            assert_eq!(recording.columns.len(), 6, "{name}: {:?}", recording.columns);
            assert!(recording.rows.len() >= 30, "{name}: {} rows", recording.rows.len());
            for row in &recording.rows {
                assert!((0.0..0.2).contains(&row[1]), "{name}: a row of another time: {row:?}");
                assert!(row[2..].iter().all(|value| value.abs() < 7.0), "{name}: counts are no angles: {row:?}");
            }
            assert!(!said.contains("42949672"), "{name}: {said}");
        }
    }
}
