//! Tools that are killed, stopped or interrupted, and full disks: recordings are complete, lost rows are counted, and
//! the motors go off without the tool that turned them on.
#![cfg(unix)]

use crate::common::sim::{Sim, wait_until};
use crate::common::{haptic, send_signal, shipped_path};
use assert_cmd::cargo::cargo_bin;
use haptic_host::link::{Board, SerialWire};
use haptic_predict::measure::earlier_settings::EarlierSettings;
use haptic_predict::measure::progress::Progress;
use haptic_predict::measure::rules_for;
use haptic_show::recorder::Recording;
use haptic_sim::NoisyWire;
use predicates::prelude::*;
use predicates::str::contains;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;
use tempfile::tempdir;

/// Waits until a file has at least this size, bytes.
fn wait_for_size(path: &Path, bytes: u64) {
    wait_until(&path.display().to_string(), || std::fs::metadata(path).is_ok_and(|about| about.len() >= bytes));
}

/// Waits until a tool ends. Returns its exit code and standard error.
fn wait_for_exit(mut child: Child) -> (Option<i32>, String) {
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    (child.wait().unwrap().code(), text)
}

fn kill_tool(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Returns the number of missing rows in a recording of every step.
fn missing_rows(recording: &Recording) -> u64 {
    recording.rows.windows(2).map(|pair| (pair[1][0] - pair[0][0]) as u64 - 1).sum()
}

/// Returns the number before this word.
fn number_before_word(text: &str, word: &str) -> u64 {
    let before = text.split(word).next().unwrap().trim_end();
    before.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap_or_else(|_| panic!("{word} in {text}"))
}

/// Waits until the board accepts another tool after the last one ended.
fn wait_until_board_is_free(sim: &Sim) {
    wait_until("a free board", || haptic(&["info", "--port", &sim.port]).output().unwrap().status.success());
}

/// Loads a scene and sets the rules for a silent host.
fn set_host_rules(sim: &Sim, host: &str, seconds: &str) {
    sim.run(&["scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["rules", "--host", host, "--host-seconds", seconds]).success();
}

#[test]
fn a_killed_recording_is_complete_and_leaves_no_rows_behind() {
    let folder = tempdir().unwrap();
    for sim in [Sim::start(&["--fast"]), Sim::on_pseudo_terminal(&["--fast"])] {
        for bytes in [10_000, 300_000, 700_000] {
            let csv = folder.path().join("killed.csv");
            let to = csv.to_str().unwrap();
            let tool = sim.spawn(&["record", to, "--rate", "20000", "--fields", "counts"]);
            wait_for_size(&csv, bytes);
            kill_tool(tool);
            let before = Recording::load(&csv).unwrap();
            assert!(before.rows.len() > 50, "{}", before.rows.len());
            assert_eq!(missing_rows(&before), 0);
            std::fs::remove_file(&csv).unwrap();
            wait_until_board_is_free(&sim);
            let assert = sim.run(&["record", to, "--seconds", "0.2", "--rate", "200", "--fields", "q,tip"]);
            let message = String::from_utf8_lossy(&assert.success().get_output().stderr).into_owned();
            assert!(message.contains("none lost"), "{message}");
            let next_recording = Recording::load(&csv).unwrap();
            assert_eq!(next_recording.columns.len(), 6, "{:?}", next_recording.columns);
            assert!(next_recording.rows.len() >= 30, "{} rows", next_recording.rows.len());
            for row in &next_recording.rows {
                assert!((0.0..0.2).contains(&row[1]), "a row of the killed recording: {row:?}");
                assert!(row[2..].iter().all(|value| value.abs() < 7.0), "counts instead of angles: {row:?}");
            }
            std::fs::remove_file(&csv).unwrap();
        }
    }
}

/// Runs the tool with files of at most 512 times `blocks` bytes, as on a full disk. Returns the tool's error message.
fn fail_on_full_disk(blocks: u64, arguments: &[&str]) -> String {
    let line = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    let output = Command::new("sh").args(["-c", &line]).arg(cargo_bin("haptic")).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("cannot be written"), "{text}");
    text
}

#[test]
fn no_file_is_left_on_a_disk_without_space() {
    let sim = Sim::start(&["--fast"]);
    let (folder, roomy) = (tempdir().unwrap(), tempdir().unwrap());
    let nothing_is_left = |text: String| {
        assert!(text.contains("free space"), "{text}");
        assert!(!text.contains(".partial"), "the message names the temporary file: {text}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    };
    let csv = folder.path().join("a.csv");
    nothing_is_left(fail_on_full_disk(0, &["record", csv.to_str().unwrap(), "--port", &sim.port]));
    // With this limit the tables of a report fit, but not its larger picture.
    let (one, two) = (shipped_path("hapkit-paddle.toml"), shipped_path("haply-2diy.toml"));
    haptic(&["bench", &one, &two, "--report", roomy.path().to_str().unwrap()]).assert().success();
    let blocks = |name: &str| std::fs::metadata(roomy.path().join(name)).unwrap().len().div_ceil(512);
    let (table, picture) = (blocks("speed-against-error.csv"), blocks("speed-against-error.svg"));
    assert!(table < picture, "{table} and {picture} blocks: choose a limit between table and picture");
    nothing_is_left(fail_on_full_disk(table, &["bench", &one, &two, "--report", folder.path().to_str().unwrap()]));
}

#[test]
fn rows_that_a_stopped_tool_missed_are_counted_exactly() {
    let sim = Sim::on_pseudo_terminal(&[]);
    let folder = tempdir().unwrap();
    let csv = folder.path().join("gaps.csv");
    let tool = sim.spawn(&["record", csv.to_str().unwrap(), "--rate", "20000", "--fields", "all"]);
    wait_for_size(&csv, 100_000);
    // Stop the tool again and again until a stop is longer than the buffers last.
    wait_until("a gap", || {
        send_signal(&tool, "STOP");
        sleep(Duration::from_secs(1));
        let before = std::fs::metadata(&csv).unwrap().len();
        send_signal(&tool, "CONT");
        wait_for_size(&csv, before + 1_000_000);
        missing_rows(&Recording::load(&csv).unwrap()) > 0
    });
    send_signal(&tool, "INT");
    let (code, text) = wait_for_exit(tool);
    assert_eq!(code, Some(0), "{text}");
    let recording = Recording::load(&csv).unwrap();
    assert_eq!(number_before_word(&text, "lost ("), missing_rows(&recording), "{text}");
    assert_eq!(number_before_word(&text, "rows are in"), recording.rows.len() as u64, "{text}");
    let dropped = number_before_word(&text, "dropped by the board");
    assert_eq!(dropped, missing_rows(&recording), "not all rows are reported as dropped by the board: {text}");
}

#[test]
fn an_interrupted_recording_is_complete_and_obeys_the_rules() {
    let sim = Sim::start(&[]);
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (rule, seconds, how, state) in
        [("ignore", "0.5", "INT", "Armed"), ("disarm", "60", "INT", "Disarmed"), ("disarm", "0.5", "KILL", "Fault")]
    {
        sim.run(&["disarm"]).success();
        set_host_rules(&sim, rule, seconds);
        let csv = path(&format!("{rule}-{how}.csv"));
        let mut stream = vec!["record", csv.to_str().unwrap(), "--rate", "1000"];
        if rule == "ignore" {
            sim.run(&["arm"]).success().stdout(contains("does not watch its host"));
        } else {
            stream.push("--arm");
        }
        let tool = sim.spawn(&stream);
        wait_for_size(&csv, 5_000);
        send_signal(&tool, how);
        let (code, text) = wait_for_exit(tool);
        if how == "INT" {
            assert_eq!(code, Some(0), "{text}");
            assert!(!Recording::load(&csv).unwrap().torn && text.contains("rows are in"), "{text}");
        }
        if rule == "ignore" {
            // Wait for a second of the board's time, after which the board must still be armed.
            sim.run(&["record", path("later.csv").to_str().unwrap(), "--seconds", "1"]).success();
        }
        wait_until_board_is_free(&sim);
        sim.wait_for_state(|now| now == state);
    }
    sim.run(&["faults"]).success().stdout(contains("host"));
}

#[test]
fn arming_a_board_that_watches_its_host_lasts_until_ctrl_c() {
    let sim = Sim::start(&[]);
    for (how, seconds, state) in [("INT", "60", "Disarmed"), ("KILL", "0.3", "Fault")] {
        set_host_rules(&sim, "disarm", seconds);
        let mut tool = Command::new(cargo_bin("haptic"));
        let tool = tool.args(["arm", "--port", &sim.port]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut tool = tool.spawn().unwrap();
        let mut armed = String::new();
        BufReader::new(tool.stdout.as_mut().unwrap()).read_line(&mut armed).unwrap();
        assert!(armed.contains("Ctrl-C turns the motors off"), "{armed}");
        sim.run(&["info"]).code(1).stderr(contains("another tool"));
        assert_eq!(tool.try_wait().unwrap(), None, "the tool must run as long as the motors are on");
        send_signal(&tool, how);
        let (code, text) = wait_for_exit(tool);
        assert!(how == "KILL" || code == Some(0), "{text}");
        wait_until_board_is_free(&sim);
        sim.wait_for_state(|now| now == state);
        sim.run(&["faults", "--clear"]).success();
    }
}

#[test]
fn a_fault_while_armed_is_reported_with_its_remedy_once() {
    let sim = Sim::start(&["--hand", "loop"]);
    set_host_rules(&sim, "disarm", "60");
    sim.run(&["rules", "--speed", "0.05,0.05"]).success();
    let ended = sim.run(&["arm"]).code(1);
    let text = String::from_utf8_lossy(&ended.get_output().stderr).into_owned();
    assert!(text.contains("SpeedLimit"), "{text}");
    let faults = sim.json(&["faults"]);
    let remedy = faults["faults"][0]["remedy"].as_str().unwrap();
    assert_eq!(text.matches(remedy).count(), 1, "{text}");
}

/// Returns the command line of a measurement at these dampings.
fn measurement_line<'a>(device: &'a str, kd: &'a str, progress: &'a Path) -> Vec<&'a str> {
    let to = progress.to_str().unwrap();
    let fixed = ["--normal=0.6,0.8", "--repeats=1", "--pull=2", "--feed-forward=off"];
    [&["measure-range", device, kd, "--progress", to][..], &fixed].concat()
}

/// Starts a measurement and waits for its first result. Starts again if the tool was silent too long.
fn start_measurement(sim: &Sim, line: &[&str], progress: &Path) -> Child {
    let measured = || Progress::read(progress).is_ok_and(|found| found.is_some_and(|found| !found.is_empty()));
    loop {
        let _ = std::fs::remove_file(progress);
        let mut tool = sim.spawn(line);
        wait_until("a result", || measured() || tool.try_wait().unwrap().is_some());
        if measured() && tool.try_wait().unwrap().is_none() {
            return tool;
        }
        let errors = wait_for_exit(tool).1;
        wait_until_board_is_free(sim);
        assert!(sim.output(&["faults"]).contains("latched  HostLost"), "{errors}");
        sim.run(&["faults", "--clear"]).success();
    }
}

#[test]
fn an_interrupted_measurement_turns_the_motors_off() {
    let sim = Sim::start(&["--fast"]);
    let before = sim.output(&["rules"]);
    let folder = tempdir().unwrap();
    let (device, progress) = (shipped_path("coupled-five-bar.toml"), folder.path().join("progress.json"));
    let tool = start_measurement(&sim, &measurement_line(&device, "--kd=5,10,15,20,25", &progress), &progress);
    send_signal(&tool, "INT");
    let (code, text) = wait_for_exit(tool);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("motors are off") && text.contains("to continue where it stopped"), "{text}");
    sim.run(&["info", "--json"]).success().stdout(contains("\"Disarmed\""));
    assert_eq!(sim.output(&["rules"]), before, "the rules are restored");
}

#[test]
fn the_measurement_after_a_killed_one_restores_the_scene() {
    let sim = Sim::start(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/tracing.toml")]);
    let board_state = || {
        let info = sim.json(&["info"]);
        (["walls", "rate_hz", "device"].map(|key| info[key].clone()), sim.output(&["rules"]))
    };
    let before = board_state();
    let folder = tempdir().unwrap();
    let (one, other) = (folder.path().join("one.json"), folder.path().join("other.json"));
    let device = shipped_path("coupled-five-bar.toml");
    let first = measurement_line(&device, "--kd=5,15,25", &one);
    kill_tool(start_measurement(&sim, &first, &one));
    wait_until_board_is_free(&sim);
    sim.wait_for_state(|state| state != "Armed");
    let state_after_kill = board_state();
    assert_ne!(state_after_kill.0, before.0, "the killed measurement had not changed the scene");
    assert_ne!(state_after_kill.1, before.1, "the killed measurement had not changed the rules");
    sim.run(&["faults", "--clear"]).success();
    // A measurement with another file cannot restore the scene.
    let (_, text) = wait_for_exit(sim.spawn(&measurement_line(&device, "--kd=15", &other)));
    assert!(text.contains("left by an interrupted measurement") && text.contains("load your scene again"), "{text}");
    wait_until_board_is_free(&sim);
    assert_ne!(board_state().0, before.0);
    // If the device has not moved, the same command line continues the measurement and restores the scene.
    let (_, text) = wait_for_exit(sim.spawn(&first));
    assert!(text.contains("the earlier scene is restored") && !text.contains("are not restored"), "{text}");
    assert!(text.contains("of 3 repeats are in"), "{text}");
    wait_until_board_is_free(&sim);
    assert_eq!(board_state(), before);
    assert!(!std::fs::read_to_string(&one).unwrap().contains("before"));
}

#[test]
fn the_measurement_after_a_killed_one_restores_the_rules() {
    let sim = Sim::start(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]);
    let before = sim.output(&["rules"]);
    let folder = tempdir().unwrap();
    let note = folder.path().join("note.json");
    {
        let mut board = Board::open(&sim.port.parse().unwrap()).unwrap();
        let saved_before = EarlierSettings::of(&mut board).unwrap();
        let measuring = rules_for(saved_before.rules(), 1.0);
        let mut progress = Progress::new("any");
        progress.before = saved_before.restore_point(&board.info().serial, &measuring);
        progress.save(&note).unwrap();
        board.set_rules(&measuring).unwrap();
    }
    assert_ne!(sim.output(&["rules"]), before);
    // The next measurement fails, because this board holds another device.
    let (device, note) = (shipped_path("haply-2diy.toml"), note.display().to_string());
    let words = ["measure-range", &device, "--normal=0.6,0.8", "--anew", "--progress", &note];
    sim.run(&words).code(1).stderr(contains("the rules on the board were left by an interrupted measurement"));
    assert_eq!(sim.output(&["rules"]), before);
    sim.run(&words).code(1).stderr(contains("were left").not());
    // Rules that the user has set since then are kept.
    sim.run(&["rules", "--torque", "0.5,0.5"]).success();
    sim.run(&words).code(1).stderr(contains("were left").not());
    sim.run(&["rules"]).success().stdout(contains("0.5, 0.5 N m"));
}

#[test]
fn damaged_frames_on_a_pseudo_terminal_stop_no_motor() {
    let sim = Sim::on_pseudo_terminal(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]);
    NoisyWire::check_telemetry(Box::new(SerialWire::open(&sim.port).unwrap()), 60 * 20_000);
}
