//! What is cut short: tools that are killed, stopped or interrupted, disks that are full, boards that two tools want.
//! What was recorded is whole, what was lost is counted, and motors that a tool turned on do not stay on without it.
#![cfg(unix)]

use crate::common::sim;

use haptic::analysis::several::Member;
use haptic::device_file::DeviceFile;
use haptic::link::{Board, encode};
use haptic::measure::before::Before;
use haptic::measure::progress::Progress;
use haptic::measure::{Law, MeasureError, MeasurementSetup, PreparedBoard, rules_for};
use haptic::recorder::Recording;
use haptic::scene_file::SceneFile;
use haptic::sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
use haptic_bridge::board::protocol::Disarm;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::{Fault, State};
use postcard_rpc::Endpoint as _;
use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
use predicates::prelude::*;
use predicates::str::contains;
use sim::{Sim, file, haptic};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::Duration;

fn signal(child: &Child, name: &str) {
    let sent = Command::new("sh").args(["-c", &format!("kill -{name} {}", child.id())]).status().unwrap();
    assert!(sent.success());
}

/// Waits until a file holds so many bytes.
fn grown(path: &Path, bytes: u64) {
    for _ in 0..6_000 {
        if std::fs::metadata(path).is_ok_and(|about| about.len() >= bytes) {
            return;
        }
        sleep(Duration::from_millis(10));
    }
    panic!("{} never held {bytes} bytes", path.display());
}

fn said(child: &mut Child) -> String {
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    text
}

fn recording(path: &Path) -> Recording {
    Recording::parse(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Rows that are missing between the first and the last of a recording of every step.
fn gaps(recording: &Recording) -> u64 {
    recording.rows.windows(2).map(|pair| (pair[1][0] - pair[0][0]) as u64 - 1).sum()
}

/// The number before this word.
fn number_before(text: &str, word: &str) -> u64 {
    let before = text.split(word).next().unwrap().trim_end();
    before.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap_or_else(|_| panic!("{word} in {text}"))
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

#[test]
fn a_recording_whose_tool_is_killed_is_readable_to_its_last_full_row() {
    let sim = Sim::start(&["--fast"]);
    let folder = Folder::new();
    for (round, bytes) in [10_000, 300_000, 700_000].into_iter().enumerate() {
        let csv = folder.path(&format!("{round}.csv"));
        let mut tool = sim.spawn(&["stream", "--rate", "20000", "--csv", csv.to_str().unwrap()]);
        grown(&csv, bytes);
        tool.kill().unwrap();
        tool.wait().unwrap();
        let recording = recording(&csv);
        assert!(recording.rows.len() > 50, "{}", recording.rows.len());
        assert_eq!(gaps(&recording), 0);
        // The board has noticed, and takes the next tool.
        sleep(Duration::from_millis(200));
        sim.run(&["info"]).success();
    }
}

#[test]
fn a_disk_that_fills_up_ends_the_recording_with_whole_rows_and_says_how_many() {
    let sim = Sim::start(&["--fast"]);
    let folder = Folder::new();
    let csv = folder.path("full.csv");
    let program = assert_cmd::cargo::cargo_bin("haptic");
    // A limit on the size of files is a disk that is full, once its signal is ignored. Blocks of 512 bytes: 300 KB.
    let line = "trap '' XFSZ; ulimit -f 600; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args(["-c", line, program.to_str().unwrap(), "stream", "--rate", "20000", "--csv", csv.to_str().unwrap()])
        .args(["--port", &sim.port])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("full.csv cannot be written"), "{text}");
    let recording = recording(&csv);
    assert!(!recording.torn && recording.rows.len() > 500);
    assert_eq!(number_before(&text, "rows are in"), recording.rows.len() as u64);
    assert!(number_before(&text, "that came could not be written and are lost") > 0 && !text.contains("none lost"));
    assert_eq!(gaps(&recording), 0);
    sim.run(&["info"]).success();
}

#[test]
fn where_not_even_the_beginning_fits_no_file_is_left() {
    let folder = Folder::new();
    let sim = Sim::start(&["--fast"]);
    let program = assert_cmd::cargo::cargo_bin("haptic");
    let limited = |blocks: u32, arguments: &[&str]| {
        let line = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
        let output =
            Command::new("sh").args(["-c", &line, program.to_str().unwrap()]).args(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("cannot be written") && text.contains("free space"), "{text}");
        assert!(!text.contains(".partial"), "a name that nobody knows: {text}");
        assert_eq!(std::fs::read_dir(folder.0.path()).unwrap().count(), 0);
    };
    let csv = folder.path("a.csv");
    limited(0, &["stream", "--csv", csv.to_str().unwrap(), "--port", &sim.port]);
    // The picture of a report fits, and its page, which is larger, does not.
    let (one, two) = (file("hapkit-paddle.toml"), file("haply-2diy.toml"));
    let roomy = Folder::new();
    haptic(&["bench", &one, &two, "--report", roomy.0.path().to_str().unwrap()]).assert().success();
    let blocks = |name: &str| std::fs::metadata(roomy.path(name)).unwrap().len().div_ceil(512) as u32;
    let (page, picture) = (blocks("speed-against-error.md"), blocks("speed-against-error.svg"));
    assert!(picture < page, "{picture} and {page} blocks: choose the limit otherwise");
    limited(picture, &["bench", &one, &two, "--report", folder.0.path().to_str().unwrap()]);
}

#[test]
fn rows_that_a_stopped_tool_did_not_take_are_counted_exactly() {
    let sim = Sim::on_pseudo_terminal(&[]);
    let folder = Folder::new();
    let csv = folder.path("gaps.csv");
    let mut tool = sim.spawn(&["stream", "--rate", "20000", "--fields", "all", "--csv", csv.to_str().unwrap()]);
    grown(&csv, 100_000);
    signal(&tool, "STOP");
    sleep(Duration::from_secs(2));
    let before = std::fs::metadata(&csv).unwrap().len();
    signal(&tool, "CONT");
    grown(&csv, before + 3_000_000);
    signal(&tool, "INT");
    let text = said(&mut tool);
    assert_eq!(tool.wait().unwrap().code(), Some(0), "{text}");
    let recording = recording(&csv);
    assert!(gaps(&recording) > 0, "two seconds fit into no buffer");
    assert_eq!(number_before(&text, "lost ("), gaps(&recording), "{text}");
    assert_eq!(number_before(&text, "rows are in"), recording.rows.len() as u64, "{text}");
    assert_eq!(
        number_before(&text, "dropped by the board"),
        gaps(&recording),
        "the board says that it was the board: {text}"
    );
}

#[test]
fn an_interrupted_stream_ends_in_order_and_its_motors_go_off_where_the_rules_say_so() {
    let sim = Sim::start(&[]);
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    let folder = Folder::new();
    let cases = [("ignore", "INT", "Armed"), ("disarm", "INT", "Disarmed"), ("disarm", "KILL", "Fault")];
    for (nth, (rule, how, state)) in cases.into_iter().enumerate() {
        sim.run(&["disarm"]).success();
        sim.run(&["rules", "--host", rule, "--host-seconds", "0.5"]).success();
        let csv = folder.path(&format!("{nth}"));
        let mut stream = vec!["stream", "--csv", csv.to_str().unwrap()];
        if rule == "ignore" {
            sim.run(&["arm"]).success().stdout(contains("nobody is watched"));
        } else {
            stream.push("--arm");
        }
        let mut tool = sim.spawn(&stream);
        grown(&csv, 5_000);
        signal(&tool, how);
        let text = said(&mut tool);
        let code = tool.wait().unwrap().code();
        if how == "INT" {
            assert_eq!(code, Some(0), "{text}");
            assert!(!recording(&csv).torn && text.contains("rows are in"), "{text}");
        }
        sleep(Duration::from_secs(2));
        sim.until(|now| now == state);
    }
    sim.run(&["faults"]).success().stdout(contains("host"));
}

#[test]
fn arming_a_board_that_watches_its_host_lasts_until_ctrl_c() {
    let sim = Sim::start(&[]);
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["rules", "--host", "disarm", "--host-seconds", "0.3"]).success();
    for (how, state) in [("INT", "Disarmed"), ("KILL", "Fault")] {
        let mut tool = sim.spawn(&["arm"]);
        sleep(Duration::from_secs(2));
        assert_eq!(tool.try_wait().unwrap(), None, "it stays for as long as the motors are on");
        signal(&tool, how);
        let text = said(&mut tool);
        let code = tool.wait().unwrap().code();
        assert!(how == "KILL" || code == Some(0), "{text}");
        sim.until(|now| now == state);
        sim.run(&["clear"]).success();
    }
}

#[test]
fn a_fault_while_armed_is_told_with_its_remedy_once() {
    let sim = Sim::start(&["--hand", "loop"]);
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["rules", "--host", "disarm", "--speed", "0.05,0.05"]).success();
    let ended = sim.run(&["arm"]).code(1);
    let text = String::from_utf8_lossy(&ended.get_output().stderr).into_owned();
    assert!(text.contains("SpeedLimit"), "{text}");
    let faults = sim.run(&["faults", "--json"]).success();
    let faults: serde_json::Value = serde_json::from_slice(&faults.get_output().stdout).unwrap();
    let remedy = faults["faults"][0]["remedy"].as_str().unwrap();
    assert_eq!(text.matches(remedy).count(), 1, "{text}");
}

#[test]
fn an_interrupted_measurement_says_that_motors_are_off_and_they_are() {
    let sim = Sim::start(&[]);
    let rules = sim.run(&["rules"]).success().get_output().stdout.clone();
    let folder = Folder::new();
    let progress = folder.path("progress.json");
    let mut tool = sim.spawn(&[
        "measure-range",
        &file("coupled-five-bar.toml"),
        "--normal=0.6,0.8",
        "--kd=15",
        "--rate=1000",
        "--cutoff=20",
        "--torque-limit=0.9",
        "--progress",
        progress.to_str().unwrap(),
    ]);
    sleep(Duration::from_secs(3));
    signal(&tool, "INT");
    let text = said(&mut tool);
    assert_eq!(tool.wait().unwrap().code(), Some(1), "{text}");
    assert!(text.contains("motors are off"), "{text}");
    let told = if progress.exists() { "to go on where it stopped" } else { "nothing was measured yet" };
    assert!(text.contains(told), "{text}");
    sim.run(&["info", "--json"]).success().stdout(contains("\"Disarmed\""));
    assert_eq!(sim.run(&["rules"]).success().get_output().stdout, rules, "and the rules are as they were");
}

#[test]
fn after_a_measurement_that_was_killed_the_next_one_puts_the_scene_back_or_says_that_it_is_gone() {
    let sim = Sim::start(&["--scene", &file("scenes/coupled-five-bar/tracing.toml")]);
    let held = || {
        let info = sim.run(&["info", "--json"]).success().get_output().stdout.clone();
        let info: serde_json::Value = serde_json::from_slice(&info).unwrap();
        ["walls", "rate_hz", "device"].map(|key| info[key].clone())
    };
    let rules = || String::from_utf8(sim.run(&["rules"]).success().get_output().stdout.clone()).unwrap();
    let (before, rules_before) = (held(), rules());
    let folder = Folder::new();
    let measure = |kd: &str, name: &str| -> Vec<String> {
        let fixed = ["measure-range", &file("coupled-five-bar.toml"), "--normal=0.6,0.8", "--repeats=1", "--pull=2"];
        let more =
            ["--feed-forward=off".into(), format!("--kd={kd}"), format!("--progress={}", folder.path(name).display())];
        fixed.into_iter().map(String::from).chain(more).collect()
    };
    let words = |line: &[String]| line.iter().map(String::as_str).collect::<Vec<_>>().join(" ");
    let kill = |name: &str| {
        let mut tool = sim.spawn(&words(&measure("5,15", name)).split(' ').collect::<Vec<_>>());
        // It keeps what was there.
        grown(&folder.path(name), 1);
        sleep(Duration::from_secs(3));
        signal(&tool, "KILL");
        tool.wait().unwrap();
        sim.until(|state| state != "Armed");
        assert_ne!(held(), before, "it was in the middle of it");
        assert_ne!(rules(), rules_before, "its rules are in force");
        sim.run(&["clear"]).success();
    };
    kill("one.json");
    // Another file knows nothing of what was there.
    let other = measure("15", "other.json");
    sim.run(&words(&other).split(' ').collect::<Vec<_>>())
        .success()
        .stderr(contains("left by a measurement").and(contains("load yours again")));
    assert_ne!(held(), before);
    // The same line goes on, and puts it back.
    let same = measure("5,15", "one.json");
    sim.run(&words(&same).split(' ').collect::<Vec<_>>())
        .success()
        .stderr(contains("the one before it is put back").and(contains("rules").not()));
    assert_eq!((held(), rules()), (before, rules_before));
    assert!(!std::fs::read_to_string(folder.path("one.json")).unwrap().contains("before"));
}

#[test]
fn a_measurement_that_was_killed_between_its_rules_and_its_scene_gives_way_to_the_rules_before_it() {
    let sim = Sim::start(&["--fast", "--scene", &file("scenes/coupled-five-bar/wall.toml")]);
    let rules = || String::from_utf8(sim.run(&["rules"]).success().get_output().stdout.clone()).unwrap();
    let before = rules();
    let folder = Folder::new();
    let note = folder.path("note.json");
    {
        let mut board = Board::open(&sim.port.parse().unwrap()).unwrap();
        let held = Before::of(&mut board).unwrap();
        let measuring = rules_for(held.rules(), 1.0);
        let mut progress = Progress::new("any");
        progress.before = held.keep(&board.info().serial, &measuring);
        progress.save(&note).unwrap();
        board.set_rules(&measuring).unwrap();
    }
    assert_ne!(rules(), before);
    // Whatever becomes of the next one; this board holds another device.
    let (device, note) = (file("haply-2diy.toml"), note.display().to_string());
    let next = ["measure-range", &device, "--normal=0.6,0.8", "--anew", "--progress", &note];
    sim.run(&next).code(1).stderr(contains("the rules on the board were left by a measurement that was cut short"));
    assert_eq!(rules(), before);
    sim.run(&next).code(1).stderr(contains("were left").not());
    // Rules that somebody has chosen since stay.
    sim.run(&["rules", "--torque", "0.5,0.5"]).success();
    sim.run(&next).code(1).stderr(contains("were left").not());
    sim.run(&["rules"]).success().stdout(contains("0.5, 0.5 N m"));
}

fn setup() -> MeasurementSetup {
    MeasurementSetup {
        walls: vec![Member::new(vec![0.6, 0.8], 1.0)],
        rate_hz: 1_000.0,
        cutoff_hz: 20.0,
        washout_hz: 2.0,
        law: Law::default(),
        torque_limit: 1.0,
        largest_pull: 2e-3,
    }
}

fn simulated() -> (DeviceFile, SharedBoard, Board) {
    let device = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    let shared = SharedBoard::new(ready_board(&device, BoardOptions::default()).unwrap());
    let board = Board::over(shared.wire(), "sim").unwrap();
    (device, shared, board)
}

#[test]
fn a_measurement_that_ends_anywhere_has_its_motors_off_and_the_rules_as_they_were() {
    let (device, shared, mut board) = simulated();
    let scene = SceneFile::load(Path::new(&file("scenes/coupled-five-bar/wall.toml")), 2).unwrap().scene().unwrap();
    board.set_scene(&scene).unwrap();
    let before = board.rules().unwrap();
    for most in [1, 30, 300, 1000] {
        let asked = std::cell::Cell::new(0);
        let stop = || {
            asked.set(asked.get() + 1);
            asked.get() > most
        };
        let ended = PreparedBoard::new(&mut board, &device, setup(), &stop)
            .and_then(|mut prepared| prepared.oscillates(FeedForward::Off, 100.0, 1.0, 1.0).map(drop));
        assert_eq!(ended.is_err(), asked.get() > most, "{ended:?}");
        assert_eq!(shared.lock().status().state, State::Disarmed, "after {most}");
        assert_eq!(board.rules().unwrap(), before);
        assert_eq!(board.scene().unwrap().as_ref(), Some(&scene));
    }
}

#[test]
fn a_measurement_ends_when_somebody_else_turns_the_motors_off_or_clears_its_fault() {
    let disarm = || {
        let key = VarKey::Key8(Disarm::REQ_KEY);
        encode(&VarHeader { key, seq_no: VarSeq::Seq2(7) }, &[])
    };
    for most in [40, 60] {
        let (device, shared, mut board) = simulated();
        let (asked, other) = (std::cell::Cell::new(0), shared.clone());
        let stop = || {
            asked.set(asked.get() + 1);
            if asked.get() == most {
                other.lock().receive(&disarm());
            }
            false
        };
        let ended = PreparedBoard::new(&mut board, &device, setup(), &stop)
            .and_then(|mut prepared| prepared.oscillates(FeedForward::Off, 100.0, 1.0, 1.0).map(drop));
        assert!(asked.get() >= most, "it was in the middle of it");
        assert!(matches!(ended, Err(MeasureError::Disarmed)), "{ended:?}");
        assert_eq!(shared.lock().status().state, State::Disarmed);
    }
}

#[test]
fn a_measurement_whose_tool_dies_takes_its_motors_with_it() {
    let (device, shared, mut board) = simulated();
    let prepared = PreparedBoard::new(&mut board, &device, setup(), &|| false).unwrap();
    // What a killed process does: nothing more, not even dropping.
    std::mem::forget(prepared);
    assert_eq!(shared.lock().status().state, State::Armed);
    shared.lock().run(1.1);
    let status = shared.lock().status();
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::HostLost)));
}

#[test]
fn the_second_of_two_tools_is_told_that_the_board_is_taken() {
    let folder = Folder::new();
    for (name, sim, told) in
        [("tcp", Sim::start(&[]), "another tool"), ("pseudo-terminal", Sim::on_pseudo_terminal(&[]), "another")]
    {
        let csv = folder.path(name);
        let mut first = sim.spawn(&["stream", "--csv", csv.to_str().unwrap()]);
        grown(&csv, 5_000);
        sim.run(&["arm"]).code(1).stderr(contains(told).and(contains(&sim.port)));
        // The first one did not even notice.
        signal(&first, "INT");
        let text = said(&mut first);
        assert_eq!(first.wait().unwrap().code(), Some(0), "{text}");
        assert!(text.contains("none lost"), "{text}");
    }
}
