//! Command lines for a board, typed as a user types them, on a simulated board in another process.

use crate::common::sim::Sim;
use crate::common::{Folder, SCENES, haptic, json, read, shipped_path, type_lines};
use haptic_host::link::Board;
use haptic_show::recorder::Recording;
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;
use std::path::Path;

const DEVICE: &str = "devices/coupled-five-bar.toml";

#[test]
fn a_bare_board_is_set_up_and_recorded() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let csv = folder.path("run.csv");
    sim.type_lines(&format!(
        "device {DEVICE} => coupled-five-bar is loaded
        1: arm => no scene is loaded
        scene {SCENES}/wall.toml => 1 wall,
        gains --stiffness 300 --damping 2 => stiffness 300 N/m
        2: gains --wall 4 => there is no wall 4
        arm
        1: board save => haptic disarm | !writing flash
        record {csv} --rate 5000 --seconds 0.5 --fields q,force,state => 2500 rows are in | none lost"
    ));
    let recording = Recording::load(Path::new(&csv)).unwrap();
    assert_eq!(recording.columns, ["step", "time_s", "q0_rad", "q1_rad", "force_n", "state", "contacts"]);
    assert_eq!((recording.rows.len(), recording.about.last().unwrap().as_str()), (2500, "2500 rows, none lost"));
    let wall = |line: &String| line.starts_with("wall 0: plane, 300 N/m, 2 N s/m");
    assert!(recording.about.iter().any(wall), "{:?}", recording.about);
    assert!(recording.rows.windows(2).all(|pair| pair[1][0] - pair[0][0] == 4.0), "one row per four steps");
    let text = std::fs::read_to_string(&csv).unwrap();
    assert!(text.contains(",Armed,0\n"), "states are written as words");
    let second_recording = format!("record {csv} --seconds 0.1 --rate 1000");
    sim.type_lines(&format!("1: {second_recording} => run.csv already exists | --force"));
    assert_eq!(std::fs::read_to_string(&csv).unwrap(), text, "the recording was overwritten");
    sim.type_lines(&format!("{second_recording} --force => 100 rows are in"));
    let piped = Recording::parse(&sim.output(&["record", "-", "--seconds", "0.1", "--rate", "100"])).unwrap();
    assert_eq!((piped.rows.len(), piped.about.last().unwrap().as_str()), (10, "10 rows, none lost"));
    assert!(!Path::new("-").exists());
    assert_eq!(sim.output(&["stream", "--seconds", "0.5"]).lines().count(), 1 + 5, "header and rows of 0.5 s");
    let streamed = sim.json(&["stream", "--seconds", "0.5"]);
    assert_eq!((streamed["values"].as_array().unwrap().len(), &streamed["rows"]), (5, &5.into()));
    sim.type_lines(
        "stream --seconds 0.5 => 5 rows, none lost
        stream --rate 1e9 --seconds 0.01 => 20000 rows a second
        disarm
        board save => the board pauses
        faults => no faults",
    );
    let info = sim.json(&["info"]);
    assert_eq!((&info["device"], &info["walls"]), (&"coupled-five-bar".into(), &1.into()));
    assert_eq!(info["state"], "Disarmed");
}

/// The shipped device's home is at 2.3 rad. Printed in double precision, the nearest f32 has sixteen digits.
#[test]
fn numbers_of_the_board_have_their_significant_digits() {
    Sim::start(&["--fast"]).type_lines(&format!(
        r#"info --json => "q":[2.3,
        scene {SCENES}/wall.toml --json => "point":[-0.108,0.181,0.0]
        rules --torque 0.08,1.1 --json => "torque":[0.08,1.1]"#
    ));
}

#[test]
fn boards_refuse_requests_that_they_are_not_ready_for() {
    Sim::start(&["--fast", "--strict"]).type_lines(&format!(
        "scene {SCENES}/wall.toml
        1: arm => verified
        1: polarity => --yes"
    ));
    Sim::start(&["--fast", "--axes", "2"]).type_lines(
        "2: device devices/phantom-premium-1.5.toml => phantom-premium-1.5.toml: | 3 joints and the board 2 axes",
    );
    let inside = "[[wall]]\npoint = [0.0, 5.0]\nnormal = [0.0, 1.0]\nstiffness = 100.0\ndamping = 1.0\n";
    let folder = Folder::new();
    Sim::start(&["--fast"]).type_lines(&format!(
        "2: scene devices/scenes/fictive-five-bar-turret/ball.toml => ball.toml:
        info => none; load one with `haptic scene FILE`
        scene {}
        1: arm => the tip is inside a wall: move it out by hand
        info => disarmed",
        folder.write("inside.toml", inside)
    ));
}

#[test]
fn a_refused_recording_creates_or_replaces_no_file() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let csv = folder.path("run.csv");
    sim.type_lines(&format!("1: record {csv} --arm => no scene is loaded"));
    assert!(!Path::new(&csv).exists());
    folder.write("run.csv", "an earlier recording");
    sim.type_lines(&format!("1: record {csv} --arm --force"));
    assert_eq!(std::fs::read_to_string(&csv).unwrap(), "an earlier recording");
}

#[test]
fn the_limit_of_the_tip_force_is_loaded_and_shown() {
    Sim::start(&["--fast"]).type_lines(
        "device devices/haply-2diy.toml => !tip force
        device devices/haply-2diy.toml --tip-force 2 => push with at most 2 N
        info => push with at most 2 N",
    );
}

/// Saved settings survive a restart, so the command does not ask after `board save`.
#[test]
fn a_restart_asks_before_it_stops_motors_or_loses_settings() {
    Sim::start(&["--fast"]).type_lines(&format!(
        r#"scene {SCENES}/wall.toml
        1: board restart => device, scene | --yes
        board save --json => "device","scene"
        arm
        1: board restart => motors are on | !forgotten
        info --json => "Armed"
        board restart --yes --json => "forgotten":[]
        board restart
        gains --stiffness 321
        1: board restart => will be lost: scene
        board name --json => "name":"""#
    ));
}

#[test]
fn saving_lists_the_settings_that_are_saved() {
    Sim::start(&["--fast"]).type_lines(
        "board save => with this device from now on; it has no scene
        board dfu --yes
        board save => with this device",
    );
    Sim::start(&["--fast"]).type_lines(
        "board restart --yes
        board save => no device or scene",
    );
}

/// A board simulated by the command itself ends with the command, so it can be neither saved nor armed.
#[test]
fn a_board_can_be_simulated_within_the_command() {
    type_lines(
        "--port sim info => coupled-five-bar
        info --port sim:devices/hapkit-paddle.toml => hapkit-paddle
        2: info --port sim:no-such.toml => no-such.toml
        2: board save --port sim => haptic sim
        2: arm --port sim => haptic sim
        2: board backup folder --port sim => haptic sim",
        &[],
    );
}

/// HAPTIC_PORT names the port, but `--port` takes precedence.
#[test]
fn the_environment_may_name_the_port() {
    let sim = Sim::start(&["--fast", &shipped_path("hapkit-paddle.toml")]);
    let info = |port: &str, more: &[&str]| haptic(&["info"]).args(more).env("HAPTIC_PORT", port).assert();
    info(&sim.port, &[]).success().stdout(contains("hapkit-paddle"));
    info(&sim.port, &["--port", "sim"]).success().stdout(contains("coupled-five-bar"));
    info("tcp:nowhere", &[]).code(2).stderr(contains("tcp:HOST:PORT"));
}

#[test]
fn wrong_ports_gains_fields_and_names_are_refused() {
    type_lines(
        "2: info --port tcp:nowhere => tcp:HOST:PORT
        1: info --port SIM0001 => serial number
        2: gains --port sim --stiffness -1
        2: gains --port sim --stiffness nan
        2: gains --port sim --stiffness inf
        2: gains --port sim --stiffness soft
        2: stream --port sim --fields forse => `forse` is no field
        2: stream --port sim --seconds -5 => greater than zero
        2: rules --port sim --torque -1,2 => greater than zero
        2: sim --axes 1 => 2 joints
        help stream => rendered | N m
        2: help modle => modle
        board list --json",
        &[],
    );
}

#[test]
fn rules_are_never_raised_above_the_boards_own() {
    Sim::start(&["--fast"]).type_lines(
        "rules => a silent host is ignored
        rules --torque 4,0.1 => the motor of joint 0 gives at most 2 N m | !joint 1
        rules --torque 0.5,0.4 --host disarm --passivity true => torque              0.5, 0.4 N m | \
            turns the motors off | passivity control   on
        1: rules --power 1e9 => the power into the hand cannot be 1000000000 W | at most 20 W
        2: rules --torque 1,1,1,1 => 4 numbers
        2: rules --torque 0.05 => 1 number, and coupled-five-bar has 2 joints
        1: rules --speed 1,1e9 => the speed of joint 1 cannot be 1000000000 rad/s
        1: rules --bus-min 20 --bus-max 12 => supply voltage cannot be 12 V
        2: rules --power nan
        2: rules --host-seconds 61 => between 0.01 and 60
        rules => 0.5, 0.4 N m | index pulses        not watched
        rules --index-period 4096,0 => every 4096, 0 counts
        2: rules --index-period=-1 => -1",
    );
}

/// A backup by root once replaced the device node /dev/full.
#[test]
fn unreadable_and_unwritable_files_are_named_in_refusals() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let (here, binary, absent) = (folder.path("."), folder.write("binary", b"\xFF\xFE"), folder.path("absent"));
    let (csv, json_path) = (folder.path("folder.csv"), folder.path("kept.json"));
    std::fs::create_dir(&csv).unwrap();
    for command in ["device", "scene", "board restore"] {
        sim.type_lines(&format!(
            "2: {command} {here} => {here} | Is a directory | check the path
            2: {command} {binary} => {binary} | not UTF-8 text | save the file as UTF-8
            2: {command} {absent} => {absent} | No such file | check the path"
        ));
    }
    sim.type_lines(&format!(
        "board save
        1: board backup {here} => {here} | is a directory
        1: record {csv} => {csv} | is a directory
        board backup {json_path}
        1: board backup {json_path} => kept.json already exists
        board backup {json_path} --force
        1: board backup /dev/full => /dev/full cannot be written
        info => none; load one with `haptic scene FILE`"
    ));
    assert!(!std::fs::metadata("/dev/full").unwrap().is_file());
}

#[test]
fn a_name_survives_a_restart_once_it_is_saved() {
    let sim = Sim::start(&["--fast", "--scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]);
    let name = || (sim.output(&["board", "name"]), sim.json(&["info"])["device"].clone());
    let (five_bar, none) = (Value::from("coupled-five-bar"), "this board has no name\n");
    sim.type_lines(&format!("2: board name {} => 33 bytes | at most 32", "x".repeat(33)));
    sim.run(&["board", "name", "two\nlines"]).code(2).stderr(contains("one line"));
    assert_eq!(name(), (none.into(), five_bar.clone()));
    sim.type_lines("board name left␣hand");
    assert_eq!(name(), ("left hand\n".into(), five_bar.clone()));
    sim.type_lines("board restart --yes");
    assert_eq!(name(), (none.into(), Value::Null), "an unsaved name survived");
    sim.type_lines(&format!(
        "device {DEVICE}
        board name left␣hand
        board save
        board name right␣hand
        board restart --yes"
    ));
    assert_eq!(name(), ("left hand\n".into(), five_bar));
    sim.type_lines(&format!(
        r#"scene {SCENES}/wall.toml
        rules --host ignore
        arm
        board restart --yes
        info --json => "Disarmed""#
    ));
    // Line breaks in a name that another program set are escaped on the screen and in a recording.
    let name = "hand\nstate       armed";
    Board::open(&sim.port.parse().unwrap()).unwrap().set_name(&name.try_into().unwrap()).unwrap();
    for words in [&["info"][..], &["board", "name"], &["record", "-", "--seconds", "0.01"]] {
        let text = sim.output(words);
        let lines = text.lines().filter(|line| line.trim_start_matches("# ").starts_with("state "));
        assert!(text.contains(r"hand\u000astate") && lines.count() == usize::from(words == ["info"]), "{text}");
    }
}

#[test]
fn torque_limits_leave_room_for_the_devices_weight() {
    let folder = Folder::new();
    let heavy = folder.write_changed("coupled-five-bar", &[("gravity = [0.0, 0.0]", "gravity = [0.0, -9.81]")]);
    let limits = |sim: &Sim| serde_json::from_value::<Vec<f64>>(sim.json(&["rules"])["torque"].clone()).unwrap();
    let loaded = |device: &str| {
        let sim = Sim::start(&["--strict"]);
        sim.run(&["device", device]).success();
        limits(&sim)
    };
    let (without, with) = (loaded(&shipped_path("coupled-five-bar.toml")), loaded(&heavy));
    let model = json(&["model", &heavy]);
    for joint in 0..2 {
        let weight = model["bias"][joint].as_f64().unwrap().abs();
        assert!(weight > 0.01, "{model}");
        assert!((with[joint] - without[joint] - weight).abs() < 1e-4, "{with:?} {without:?} {weight}");
    }
    let sim = Sim::start(&["--strict"]);
    sim.type_lines(&format!(
        "device devices/capstan-pantograph.toml
        device {DEVICE} => some were lower before | `haptic rules --torque` raises them"
    ));
    assert!(limits(&sim)[0] < 0.5 * without[0], "the lower limits were not kept");
    // Lengths in millimetres need torques beyond all limits of the board, so the message must not advise higher limits.
    let in_mm = [
        ("base = 0.02\n", "base = 20.0\n"),
        ("proximal = [0.1, 0.1]", "proximal = [100.0, 100.0]"),
        ("distal = [0.13, 0.13]", "distal = [130.0, 130.0]"),
    ];
    let sim = Sim::start(&["--strict"]);
    let assert = sim.run(&["device", &folder.write_changed("coupled-five-bar", &in_mm)]).success();
    assert.stdout(contains("the board allows at most 5: are lengths in the file in m").and(contains("rules").not()));
    assert_eq!(limits(&sim)[0], 5.0);
}

/// Returns a board whose scene pulls joint 0 past its limit when the board is armed. Friction keeps the joint there.
fn board_past_a_limit(folder: &Folder) -> Sim {
    let limited = ("inertia = 0.0008\n", "inertia = 0.0008\nlimits = [2.25, 2.35]\n");
    let device = folder.write_changed("coupled-five-bar", &[limited]);
    let scene = folder.write("pull.toml", "[[spring]]\npoint = [0.3, 0.3]\nstiffness = 30.0\ndamping = 0.0\n");
    Sim::start(&["--fast", &device, "--scene", &scene])
}

/// The remedy of a fault is printed on a separate line, not after an escaped line break.
#[test]
fn clearing_names_the_joint_outside_its_limits() {
    let folder = Folder::new();
    let sim = board_past_a_limit(&folder);
    sim.type_lines(
        r#"faults --clear --json => "outside_limits":[]
        arm"#,
    );
    sim.wait_for_state(|state| state == "Fault");
    sim.type_lines(
        r#"info => JointLimit | move the device back | !u000a
        faults --clear => cleared JointLimit | joint 0 is outside its limits, at 2.
        faults --clear --json => "outside_limits":[0]
        1: arm => joint 0 is outside its limits"#,
    );
}

#[test]
fn a_stream_interrupted_by_a_fault_reports_the_fault() {
    let folder = Folder::new();
    let sim = board_past_a_limit(&folder);
    let ended = sim.run(&["stream", "--arm", "--seconds", "2", "--json"]).code(1);
    let ended = ended.stderr(contains("error: the motors are off: JointLimit (7)"));
    let rows: Value = serde_json::from_slice(&ended.get_output().stdout).unwrap();
    assert_eq!(rows["values"].as_array().unwrap().len(), 20, "rows are missing");
    // A stream that does not arm succeeds.
    sim.type_lines("stream --seconds 0.5");
}

#[test]
fn every_command_that_weakens_a_protection_warns() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let json_path = folder.path("kept.json");
    let (host, force) = ("the board no longer watches its host", "may now push at the tip with 30 N, before with 4");
    let tighten = || sim.run(&["rules", "--host", "disarm", "--tip-force", "4"]).success().stderr("");
    tighten();
    sim.type_lines(&format!(
        "rules --host ignore --tip-force 30 => {host} | {force}
        board save
        board backup {json_path}"
    ));
    tighten();
    sim.type_lines(&format!(
        "board restore {json_path} => {host} | {force}
        board restore {json_path} => !{host} | !may now push"
    ));
    tighten();
    sim.type_lines(&format!("device {DEVICE} --tip-force 30 => !{host} | {force}"));
}

#[test]
fn a_backup_of_another_board_is_restored_without_its_name() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let json_path = folder.path("kept.json");
    sim.type_lines(&format!(
        "board name left␣hand
        board save
        board backup {json_path}
        board name right␣hand"
    ));
    folder.write("kept.json", std::fs::read_to_string(&json_path).unwrap().replace("\"SIM0001\"", "\"OTHER\""));
    let tighten = || sim.run(&["rules", "--torque", "0.1,0.1"]).success().stderr("").get_output().stdout.clone();
    let tightened = tighten();
    sim.type_lines(&format!("1: board restore {json_path} => OTHER | SIM0001 | --yes"));
    sim.run(&["rules"]).success().stdout(tightened);
    sim.type_lines(&format!(
        "board restore {json_path} --yes => the torque limit of joint 0 is now
        info => right hand"
    ));
    tighten();
    sim.type_lines("rules --torque 0.2,0.1 => the torque limit of joint 0 is now 0.2 N m, before 0.1");
}

#[test]
fn the_tip_force_limit_has_the_documented_maximum() {
    assert!(read("docs/safety.md").contains("at most 100 N; 1000 N on a simulated board without `--strict`"));
    for (options, most) in [(&["--fast", "--strict"][..], "100"), (&["--fast"], "1000")] {
        Sim::start(options).type_lines(&format!(
            "rules --tip-force {most} => force at the tip    {most} N
            1: rules --tip-force 1001 => 1001 N: this board accepts more than 0 and at most {most} N
            1: device {DEVICE} --tip-force 1001 => 1001 N: this board accepts more than 0 and at most {most} N"
        ));
    }
}

#[test]
fn a_device_with_more_encoders_than_inputs_is_refused_before_the_board_is_asked() {
    let options = haptic_sim::BoardOptions { encoders: 3, ..haptic_sim::BoardOptions::default() };
    let mut board = haptic_sim::ready_board(&crate::common::shipped_device("coupled-five-bar"), options).unwrap();
    let listener = haptic_sim::door::tcp(([127, 0, 0, 1], 0).into(), haptic_sim::door::Patience::default()).unwrap();
    let port = listener.port.clone();
    std::thread::spawn(move || {
        let stop = std::sync::atomic::AtomicBool::new(false);
        haptic_sim::server::serve(&mut board, &listener, haptic_sim::server::Pace::AsFastAsItCan, &stop);
    });
    haptic(&["device", &shipped_path("touch.toml"), "--port", &port])
        .assert()
        .code(2)
        .stderr(contains("touch.toml:109: the board has 3 encoder inputs, of which 3 joints leave 0 for 3 [[sensed]]"));
    let lack = "a board has 3 encoder inputs, 3 too few for the joints and 3 [[sensed]]: remove 3 of them";
    haptic(&["check", &shipped_path("touch.toml")]).assert().success().stdout(contains(lack));
}

/// A board with another protocol version. The board understands only the requests that never change.
struct OtherVersionBoard {
    port: String,
    stopped: std::sync::mpsc::Receiver<()>,
}

impl OtherVersionBoard {
    fn start(protocol: u16) -> Self {
        use haptic_bridge::board::protocol::{Disarm, GetInfo, Info, Outcome};
        use haptic_host::link::{Deframer, encode};
        use postcard_rpc::Endpoint as _;
        use postcard_rpc::header::{VarHeader, VarKey};
        use std::io::{Read, Write};
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = format!("tcp:{}", listener.local_addr().unwrap());
        let (stop, stopped) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for mut tool in listener.incoming().map(Result::unwrap) {
                let (mut deframer, mut buffer) = (Deframer::default(), [0; 4096]);
                while let Ok(count @ 1..) = tool.read(&mut buffer) {
                    let mut replies = Vec::new();
                    deframer.feed(&buffer[..count], |frame| {
                        let reply = |key, body: &[u8]| {
                            encode(&VarHeader { key: VarKey::Key8(key), seq_no: frame.header.seq_no }, body)
                        };
                        let (firmware, board) = ("9.9".chars().collect(), "odrive-v3".chars().collect());
                        let info = Info { protocol, firmware, board, serial: "A1".chars().collect() };
                        if frame.header.key == VarKey::Key8(GetInfo::REQ_KEY) {
                            replies.extend(reply(GetInfo::RESP_KEY, &postcard::to_stdvec(&info).unwrap()));
                        } else if frame.header.key == VarKey::Key8(Disarm::REQ_KEY) {
                            stop.send(()).unwrap();
                            // In the other version the refusal type differs, so the reply has another key.
                            let done: Outcome = Ok(());
                            let another = postcard_rpc::Key::for_path::<u64>("haptic/disarm");
                            replies.extend(reply(another, &postcard::to_stdvec(&done).unwrap()));
                        }
                    });
                    tool.write_all(&replies).unwrap();
                }
            }
        });
        Self { port, stopped }
    }
}

#[test]
fn a_board_of_another_version_accepts_only_disarm() {
    use haptic_bridge::board::protocol::PROTOCOL;
    for protocol in [PROTOCOL - 1, PROTOCOL + 1] {
        let board = OtherVersionBoard::start(protocol);
        haptic(&["disarm", "--port", &board.port]).assert().success().stdout(contains("the motors are off"));
        assert!(board.stopped.try_recv().is_ok());
        haptic(&["arm", "--port", &board.port]).assert().code(1).stderr(contains("protocol version"));
    }
}
