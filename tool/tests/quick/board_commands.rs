//! The commands that talk to a board, as a person types them, against a simulated board in another process.

use crate::common::sim::{Sim, until};
use crate::common::{file, haptic};
use haptic_host::link::Board;
use haptic_show::recorder::Recording;
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;
use std::path::Path;

#[test]
fn a_session_from_a_bare_board_to_a_recording() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["device", &file("coupled-five-bar.toml")]).success().stdout(contains("coupled-five-bar is loaded"));
    sim.run(&["arm"]).code(1).stderr(contains("no scene is loaded"));
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success().stdout(contains("1 wall,"));
    sim.run(&["gains", "--stiffness", "300", "--damping", "2"]).success().stdout(contains("stiffness 300 N/m"));
    sim.run(&["gains", "--wall", "4"]).code(2).stderr(contains("there is no wall 4"));
    sim.run(&["arm"]).success();
    sim.run(&["board", "save"]).code(1).stderr(contains("haptic disarm").and(contains("writing flash").not()));

    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("run.csv");
    let csv = csv.to_str().unwrap();
    sim.run(&["record", csv, "--rate", "5000", "--seconds", "0.5", "--fields", "q,force,state"])
        .success()
        .stderr(contains("2500 rows are in").and(contains("none lost")));
    let recording = Recording::parse(&std::fs::read_to_string(csv).unwrap()).unwrap();
    assert_eq!(recording.columns, ["step", "time_s", "q0_rad", "q1_rad", "force_n", "state", "contacts"]);
    assert_eq!(recording.rows.len(), 2500);
    assert_eq!(recording.about.last().unwrap(), "2500 rows, none lost");
    let about = recording.about.join("\n");
    for said in [
        "date 20",
        "protocol ",
        "board simulated SIM0001",
        "device coupled-five-bar",
        "wall 0: plane, 300 N/m, 2 N s/m",
        "scene {",
        "rules {",
    ] {
        assert!(about.contains(said), "{said} in {about}");
    }
    let text = std::fs::read_to_string(csv).unwrap();
    assert!(text.contains(",Armed,0\n"), "states are words");
    let again = ["record", csv, "--seconds", "0.1", "--rate", "1000"];
    sim.run(&again).code(1).stderr(contains("run.csv already exists").and(contains("--force")));
    assert_eq!(std::fs::read_to_string(csv).unwrap(), text, "a recording is not overwritten");
    sim.run(&[&again[..], &["--force"]].concat()).success().stderr(contains("100 rows are in"));
    let piped = sim.run(&["record", "-", "--seconds", "0.1", "--rate", "100"]).success();
    let piped = Recording::parse(&String::from_utf8_lossy(&piped.get_output().stdout)).unwrap();
    assert_eq!((piped.rows.len(), piped.about.last().unwrap().as_str()), (10, "10 rows, none lost"));
    assert!(!std::path::Path::new("-").exists());
    let shown = sim.run(&["stream", "--seconds", "0.5"]).success();
    let (lines, said) = (&shown.get_output().stdout, String::from_utf8_lossy(&shown.get_output().stderr));
    assert_eq!(lines.iter().filter(|byte| **byte == b'\n').count(), 1 + 5, "a head and five rows");
    assert!(said.contains("5 rows, none lost"), "{said}");
    let json = sim.run(&["stream", "--seconds", "0.5", "--json"]).success();
    let json: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!((json["values"].as_array().unwrap().len(), &json["rows"]), (5, &serde_json::json!(5)));
    sim.run(&["stream", "--rate", "1e9", "--seconds", "0.01"]).success().stderr(contains("20000 rows a second"));
    assert!(recording.rows.windows(2).all(|pair| pair[1][0] - pair[0][0] == 4.0), "every fourth step");

    sim.run(&["disarm"]).success();
    sim.run(&["board", "save"]).success().stderr(contains("the board pauses"));
    let info = sim.run(&["info", "--json"]).success();
    let info: serde_json::Value = serde_json::from_slice(&info.get_output().stdout).unwrap();
    assert_eq!(info["device"], "coupled-five-bar");
    assert_eq!(info["walls"], 1);
    assert_eq!(info["state"], "Disarmed");
    sim.run(&["faults"]).success().stdout(contains("no faults"));
}

#[test]
fn numbers_of_the_board_have_the_digits_that_they_mean() {
    let sim = Sim::start(&["--fast"]);
    // The shipped device's home is (2.3, ...) rad, and single precision's nearest number has sixteen digits.
    sim.run(&["info", "--json"]).success().stdout(contains("\"q\":[2.3,"));
    let scene = sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml"), "--json"]).success();
    scene.stdout(contains("\"point\":[-0.108,0.181,0.0]"));
    sim.run(&["rules", "--torque", "0.08,1.1", "--json"]).success().stdout(contains("\"torque\":[0.08,1.1]"));
}

#[test]
fn a_strict_board_asks_for_everything_a_real_one_does() {
    let sim = Sim::start(&["--fast", "--strict"]);
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["arm"]).code(1).stderr(contains("verified"));
    sim.run(&["polarity"]).code(1).stderr(contains("--yes"));
}

#[test]
fn a_device_with_more_joints_than_axes_is_refused_with_file_and_line() {
    let sim = Sim::start(&["--fast", "--axes", "2"]);
    let refused = sim.run(&["device", &file("phantom-premium-1.5.toml")]).code(2);
    let text = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(text.contains("phantom-premium-1.5.toml:") && text.contains("3 joints and the board 2 axes"), "{text}");
}

#[test]
fn a_scene_of_the_wrong_dimension_is_refused_before_it_is_sent() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["scene", &file("scenes/fictive-five-bar-turret/ball.toml")]).code(2).stderr(contains("ball.toml:"));
    sim.run(&["info"]).success().stdout(contains("none; load one with `haptic scene FILE`"));
}

#[test]
fn a_board_that_dies_while_streaming_leaves_a_whole_recording() {
    let mut sim = Sim::start(&[]);
    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("cut.csv");
    let mut stream = sim.spawn(&["record", csv.to_str().unwrap(), "--rate", "20000"]);
    // Pull the plug once there is something on disk.
    until("rows on disk", || std::fs::metadata(&csv).is_ok_and(|about| about.len() >= 100_000));
    sim.child.kill().unwrap();
    assert_eq!(stream.wait().unwrap().code(), Some(1));
    let mut said = String::new();
    std::io::Read::read_to_string(&mut stream.stderr.take().unwrap(), &mut said).unwrap();
    assert!(said.contains("unplugged or the connection was lost") && said.contains("rows are in"), "{said}");
    let recording = Recording::parse(&std::fs::read_to_string(&csv).unwrap()).unwrap();
    assert!(!recording.torn && recording.rows.len() > 100);
    let last = recording.about.last().unwrap();
    assert!(last.starts_with("cut short: the board was lost") && last.contains(" rows"), "{last}");
}

#[test]
fn a_stream_that_the_board_refuses_makes_no_file_and_replaces_none() {
    let sim = Sim::start(&["--fast"]);
    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("run.csv");
    let arguments = ["record", csv.to_str().unwrap(), "--arm"];
    sim.run(&arguments).code(1).stderr(contains("no scene is loaded"));
    assert!(!csv.exists());
    std::fs::write(&csv, "an earlier one").unwrap();
    sim.run(&[&arguments[..], &["--force"]].concat()).code(1);
    assert_eq!(std::fs::read_to_string(&csv).unwrap(), "an earlier one");
}

#[test]
fn a_limit_of_the_tip_force_is_obeyed_on_a_simulated_board_too() {
    let sim = Sim::start(&["--fast"]);
    let device = file("haply-2diy.toml");
    sim.run(&["device", &device]).success().stdout(contains("tip force").not());
    sim.run(&["device", &device, "--tip-force", "2"]).success().stdout(contains("push with at most 2 N"));
    sim.run(&["info"]).success().stdout(contains("push with at most 2 N"));
}

#[test]
fn a_restart_asks_before_it_turns_motors_off_or_forgets() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["board", "restart"]).code(1).stderr(contains("device, scene").and(contains("--yes")));
    sim.run(&["board", "save", "--json"]).success().stdout(contains("\"device\",\"scene\""));
    sim.run(&["arm"]).success();
    sim.run(&["board", "restart"]).code(1).stderr(contains("motors are on").and(contains("forgotten").not()));
    sim.run(&["info", "--json"]).success().stdout(contains("\"Armed\""));
    sim.run(&["board", "restart", "--yes", "--json"]).success().stdout(contains("\"forgotten\":[]"));
    // What is saved is kept, so there is nothing to ask; neither is there after a change that was taken back.
    sim.run(&["board", "restart"]).success();
    sim.run(&["gains", "--stiffness", "321"]).success();
    sim.run(&["board", "restart"]).code(1).stderr(contains("will be lost: scene"));
    sim.run(&["board", "name", "--json"]).success().stdout(contains("\"name\":\"\""));
}

#[test]
fn saving_says_what_there_was_to_save() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["board", "save"]).success().stdout(contains("with this device from now on; it has no scene"));
    sim.run(&["board", "dfu", "--yes"]).success();
    sim.run(&["board", "save"]).success().stdout(contains("with this device"));
    let bare = Sim::start(&["--fast"]);
    bare.run(&["board", "restart", "--yes"]).success();
    bare.run(&["board", "save"]).success().stdout(contains("no device or scene"));
}

#[test]
fn a_simulated_board_needs_no_other_process() {
    haptic(&["--port", "sim", "info"]).assert().success().stdout(contains("coupled-five-bar"));
    haptic(&["info", "--port", &format!("sim:{}", file("hapkit-paddle.toml"))])
        .assert()
        .success()
        .stdout(contains("hapkit-paddle"));
    haptic(&["info", "--port", "sim:no-such.toml"]).assert().code(2).stderr(contains("no-such.toml"));
    // It ends with the command: there is nothing to say "saved" or "armed" of.
    for lasting in [&["board", "save"][..], &["arm"], &["board", "backup", "folder"]] {
        haptic(lasting).args(["--port", "sim"]).assert().code(2).stderr(contains("haptic sim"));
    }
}

#[test]
fn the_port_may_stand_in_the_environment() {
    let sim = Sim::start(&["--fast", &file("hapkit-paddle.toml")]);
    let info = || haptic(&["info"]);
    info().env("HAPTIC_PORT", &sim.port).assert().success().stdout(contains("hapkit-paddle"));
    // What is written goes first.
    info()
        .args(["--port", "sim"])
        .env("HAPTIC_PORT", &sim.port)
        .assert()
        .success()
        .stdout(contains("coupled-five-bar"));
    info().env("HAPTIC_PORT", "tcp:nowhere").assert().code(2).stderr(contains("tcp:HOST:PORT"));
}

#[test]
fn wrong_ports_and_gains_are_refused_by_the_command_line() {
    haptic(&["info", "--port", "tcp:nowhere"]).assert().code(2).stderr(contains("tcp:HOST:PORT"));
    for bad in ["-1", "nan", "inf", "soft"] {
        haptic(&["gains", "--port", "sim", "--stiffness", bad]).assert().code(2);
    }
    haptic(&["stream", "--port", "sim", "--fields", "forse"]).assert().code(2).stderr(contains("`forse` is no field"));
    haptic(&["info", "--port", "/dev/no-such-port"]).assert().code(1).stderr(contains("/dev/no-such-port"));
    haptic(&["board", "list", "--json"]).assert().success();
}

#[test]
fn rules_are_shown_lowered_and_never_raised_above_the_boards_own() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["rules"]).success().stdout(contains("a silent host is ignored"));
    sim.run(&["rules", "--torque", "4,0.1"])
        .success()
        .stderr(contains("the motor of joint 0 gives at most 2 N m").and(contains("joint 1").not()));
    sim.run(&["rules", "--torque", "0.5,0.4", "--host", "disarm", "--passivity", "true"]).success().stdout(
        contains("torque              0.5, 0.4 N m")
            .and(contains("turns the motors off"))
            .and(contains("passivity control   on")),
    );
    sim.run(&["rules", "--power", "1e9"])
        .code(1)
        .stderr(contains("the power into the hand cannot be 1000000000 W").and(contains("at most 20 W")));
    for (given, said) in [("1,1,1,1", "4 numbers"), ("0.05", "1 number, and coupled-five-bar has 2 joints")] {
        sim.run(&["rules", "--torque", given]).code(2).stderr(contains(said));
    }
    sim.run(&["rules", "--speed", "1,1e9"]).code(1).stderr(contains("the speed of joint 1 cannot be 1000000000 rad/s"));
    sim.run(&["rules", "--bus-min", "20", "--bus-max", "12"]).code(1).stderr(contains("supply voltage cannot be 12 V"));
    sim.run(&["rules", "--power", "nan"]).code(2);
    sim.run(&["rules", "--host-seconds", "61"]).code(2).stderr(contains("between 0.01 and 60"));
    sim.run(&["rules"]).success().stdout(contains("0.5, 0.4 N m").and(contains("index pulses        not watched")));
    sim.run(&["rules", "--index-period", "4096,0"]).success().stdout(contains("every 4096, 0 counts"));
    sim.run(&["rules", "--index-period=-1"]).code(2).stderr(contains("-1"));
}

#[test]
fn a_file_that_is_none_is_refused_by_name_with_what_to_do() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().to_str().unwrap();
    let binary = directory.path().join("binary");
    std::fs::write(&binary, b"\xFF\xFE").unwrap();
    let folder_csv = format!("{folder}/folder.csv");
    std::fs::create_dir(&folder_csv).unwrap();
    let (binary, absent) = (binary.to_str().unwrap(), directory.path().join("absent"));
    let sim = Sim::start(&["--fast"]);
    for command in [&["device"][..], &["scene"], &["board", "restore"]] {
        for (path, reason, remedy) in [
            (folder, "Is a directory", "check the path"),
            (binary, "not UTF-8 text", "save the file as UTF-8"),
            (absent.to_str().unwrap(), "No such file", "check the path"),
        ] {
            sim.run(&[command, &[path]].concat())
                .code(2)
                .stderr(contains(path).and(contains(reason)).and(contains(remedy)).and(contains("error:").count(1)));
        }
    }
    sim.run(&["board", "save"]).success();
    for refused in [["board", "backup", folder].as_slice(), &["record", &folder_csv]] {
        sim.run(refused).code(1).stderr(contains(folder).and(contains("is a directory")));
    }
    let kept = directory.path().join("kept.json");
    let backup = ["board", "backup", kept.to_str().unwrap()];
    sim.run(&backup).success();
    sim.run(&backup).code(1).stderr(contains("kept.json already exists"));
    sim.run(&[&backup[..], &["--force"]].concat()).success();
    // As root this once replaced the device node.
    sim.run(&["board", "backup", "/dev/full"]).code(1).stderr(contains("/dev/full cannot be written"));
    assert!(!std::fs::metadata("/dev/full").unwrap().is_file());
    sim.run(&["info"]).success().stdout(contains("none; load one with `haptic scene FILE`"));
}

#[test]
fn a_tip_inside_a_wall_is_not_armed() {
    let sim = Sim::start(&["--fast"]);
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("inside.toml");
    std::fs::write(&scene, "[[wall]]\npoint = [0.0, 5.0]\nnormal = [0.0, 1.0]\nstiffness = 100.0\ndamping = 1.0\n")
        .unwrap();
    sim.run(&["scene", scene.to_str().unwrap()]).success();
    sim.run(&["arm"]).code(1).stderr(contains("the tip is inside a wall: move it out by hand"));
    sim.run(&["info"]).success().stdout(contains("disarmed"));
}

#[test]
fn a_name_lasts_over_a_restart_once_it_is_saved() {
    let sim = Sim::start(&["--fast", "--scene", &file("scenes/coupled-five-bar/wall.toml")]);
    let said = |words: &[&str]| String::from_utf8(sim.run(words).success().get_output().stdout.clone()).unwrap();
    let device = || serde_json::from_str::<Value>(&said(&["info", "--json"])).unwrap()["device"].clone();
    assert_eq!(said(&["board", "name"]), "this board has no name\n");
    sim.run(&["board", "name", &"x".repeat(33)]).code(2).stderr(contains("33 bytes").and(contains("at most 32")));
    sim.run(&["board", "name", "two\nlines"]).code(2).stderr(contains("one line"));
    assert_eq!(said(&["board", "name"]), "this board has no name\n");

    said(&["board", "name", "left hand"]);
    assert_eq!(said(&["board", "name"]), "left hand\n");
    assert_eq!(device(), "coupled-five-bar");
    // Nothing was saved, so nothing is left of it.
    said(&["board", "restart", "--yes"]);
    assert_eq!((said(&["board", "name"]).as_str(), device()), ("this board has no name\n", Value::Null));

    said(&["device", &file("coupled-five-bar.toml")]);
    said(&["board", "name", "left hand"]);
    said(&["board", "save"]);
    said(&["board", "name", "right hand"]);
    said(&["board", "restart", "--yes"]);
    assert_eq!((said(&["board", "name"]).as_str(), device()), ("left hand\n", "coupled-five-bar".into()));
    // Motors that were on are off.
    sim.run(&["scene", &file("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["rules", "--host", "ignore"]).success();
    said(&["arm"]);
    said(&["board", "restart", "--yes"]);
    sim.run(&["info", "--json"]).success().stdout(contains("\"Disarmed\""));
    // A name that another program gave it begins no line of its own, on the screen or in a recording.
    let name = "hand\nstate       armed";
    Board::open(&sim.port.parse().unwrap()).unwrap().set_name(&name.try_into().unwrap()).unwrap();
    for words in [&["info"][..], &["board", "name"], &["record", "-", "--seconds", "0.01"]] {
        let text = said(words);
        let lines = text.lines().filter(|line| line.trim_start_matches("# ").starts_with("state "));
        assert!(text.contains(r"hand\u000astate") && lines.count() == usize::from(words == ["info"]), "{text}");
    }
}

#[test]
fn torque_limits_leave_room_for_the_devices_weight_and_what_was_lower_before_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let heavy = folder.path().join("heavy.toml").display().to_string();
    let light = std::fs::read_to_string(file("coupled-five-bar.toml")).unwrap();
    std::fs::write(&heavy, light.replace("gravity = [0.0, 0.0]", "gravity = [0.0, -9.81]")).unwrap();
    let limits = |sim: &Sim| -> Vec<f64> {
        let rules = sim.run(&["rules", "--json"]).success().get_output().stdout.clone();
        let rules: serde_json::Value = serde_json::from_slice(&rules).unwrap();
        serde_json::from_value(rules["torque"].clone()).unwrap()
    };
    let loaded = |device: &str| {
        let sim = Sim::start(&["--strict"]);
        sim.run(&["device", device]).success();
        limits(&sim)
    };
    let (without, with) = (loaded(&file("coupled-five-bar.toml")), loaded(&heavy));
    let model = haptic(&["model", &heavy, "--json"]).assert().success().get_output().stdout.clone();
    let model: serde_json::Value = serde_json::from_slice(&model).unwrap();
    for joint in 0..2 {
        let weight = model["bias"][joint].as_f64().unwrap().abs();
        assert!(weight > 0.01, "{model}");
        assert!((with[joint] - without[joint] - weight).abs() < 1e-4, "{with:?} {without:?} {weight}");
    }
    let sim = Sim::start(&["--strict"]);
    sim.run(&["device", &file("capstan-pantograph.toml")]).success();
    let lower = sim.run(&["device", &file("coupled-five-bar.toml")]).success();
    lower.stdout(contains("some were lower before").and(contains("`haptic rules --torque` raises them")));
    assert!(limits(&sim)[0] < 0.5 * without[0], "what somebody may have meant stays");

    // Lengths in millimetres take torques that no limit of the board can be raised to, and nobody is told to.
    let long = folder.path().join("long.toml");
    let lengths = [
        ("base = 0.02\n", "base = 20.0\n"),
        ("proximal = [0.1, 0.1]", "proximal = [100.0, 100.0]"),
        ("distal = [0.13, 0.13]", "distal = [130.0, 130.0]"),
    ];
    let in_mm = lengths.iter().fold(light.clone(), |text, (m, mm)| text.replace(m, mm));
    assert!(lengths.iter().all(|(_, mm)| in_mm.contains(mm)), "{in_mm}");
    std::fs::write(&long, in_mm).unwrap();
    let sim = Sim::start(&["--strict"]);
    let said = sim.run(&["device", long.to_str().unwrap()]).success();
    said.stdout(contains("the board allows at most 5: are lengths in the file in m").and(contains("rules").not()));
    assert_eq!(limits(&sim)[0], 5.0);
}

/// A board whose scene pulls joint 0 past its limit as soon as it is armed, and whose friction leaves it there.
fn past_a_limit(folder: &Path) -> Sim {
    let device = folder.join("narrow.toml");
    let text = std::fs::read_to_string(file("coupled-five-bar.toml")).unwrap();
    let narrow = text.replacen("inertia = 0.0008\n", "inertia = 0.0008\nlimits = [2.25, 2.35]\n", 1);
    assert!(narrow != text);
    std::fs::write(&device, narrow).unwrap();
    let scene = folder.join("pull.toml");
    std::fs::write(&scene, "[[spring]]\npoint = [0.3, 0.3]\nstiffness = 30.0\ndamping = 0.0\n").unwrap();
    Sim::start(&["--fast", device.to_str().unwrap(), "--scene", scene.to_str().unwrap()])
}

#[test]
fn clearing_tells_which_joint_is_outside_its_limits() {
    let folder = tempfile::tempdir().unwrap();
    let sim = past_a_limit(folder.path());
    sim.run(&["faults", "--clear", "--json"]).success().stdout(contains("\"outside_limits\":[]"));
    sim.run(&["arm"]).success();
    sim.until(|state| state == "Fault");
    // The remedy is a line of its own, and not a code for a line's end.
    let said = sim.run(&["info"]).success().get_output().stdout.clone();
    let said = String::from_utf8(said).unwrap();
    assert!(said.contains("JointLimit") && said.contains("move the device back") && !said.contains("u000a"), "{said}");
    sim.run(&["faults", "--clear"])
        .success()
        .stdout(contains("cleared JointLimit").and(contains("joint 0 is outside its limits, at 2.")));
    sim.run(&["faults", "--clear", "--json"]).success().stdout(contains("\"outside_limits\":[0]"));
    sim.run(&["arm"]).code(1).stderr(contains("joint 0 is outside its limits"));
}

#[test]
fn a_stream_whose_motors_a_fault_turned_off_ends_with_that_fault() {
    let folder = tempfile::tempdir().unwrap();
    let sim = past_a_limit(folder.path());
    let ended = sim.run(&["stream", "--arm", "--seconds", "2", "--json"]).code(1);
    let output = ended.get_output();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("error: the motors are off: JointLimit (7)"), "{said}");
    let rows: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(rows["values"].as_array().unwrap().len(), 20, "the rows are all there");
    // One that only looks has done what it was asked.
    sim.run(&["stream", "--seconds", "0.5"]).success();
}

#[test]
fn what_weakens_a_protection_is_told_by_whichever_command_does_it() {
    let folder = tempfile::tempdir().unwrap();
    let kept = folder.path().join("kept.json").display().to_string();
    let sim = Sim::start(&["--fast"]);
    let (host, force) = ("the board no longer watches its host", "may now push at the tip with 30 N, before with 4");
    let tighten = || sim.run(&["rules", "--host", "disarm", "--tip-force", "4"]).success().stderr("");
    tighten();
    sim.run(&["rules", "--host", "ignore", "--tip-force", "30"]).success().stderr(contains(host).and(contains(force)));
    sim.run(&["board", "save"]).success();
    sim.run(&["board", "backup", &kept]).success();
    tighten();
    sim.run(&["board", "restore", &kept]).success().stderr(contains(host).and(contains(force)));
    sim.run(&["board", "restore", &kept]).success().stderr(contains(host).or(contains("may now push")).not());
    tighten();
    let device = file("coupled-five-bar.toml");
    sim.run(&["device", &device, "--tip-force", "30"]).success().stderr(contains(host).not().and(contains(force)));
}

#[test]
fn a_backup_of_another_board_is_restored_once_agreed_and_without_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let kept = folder.path().join("kept.json");
    let restore = ["board", "restore", kept.to_str().unwrap()];
    let sim = Sim::start(&["--fast"]);
    sim.run(&["board", "name", "left hand"]).success();
    sim.run(&["board", "save"]).success();
    sim.run(&["board", "backup", kept.to_str().unwrap()]).success();
    let text = std::fs::read_to_string(&kept).unwrap();
    std::fs::write(&kept, text.replace("\"SIM0001\"", "\"OTHER\"")).unwrap();
    sim.run(&["board", "name", "right hand"]).success();
    let tight = ["rules", "--torque", "0.1,0.1"];
    let tightened = sim.run(&tight).success().stderr("").get_output().stdout.clone();
    sim.run(&restore).code(1).stderr(contains("OTHER").and(contains("SIM0001")).and(contains("--yes")));
    sim.run(&["rules"]).success().stdout(tightened);
    sim.run(&[&restore[..], &["--yes"]].concat()).success().stderr(contains("the torque limit of joint 0 is now"));
    sim.run(&["info"]).success().stdout(contains("right hand"));
    sim.run(&tight).success();
    sim.run(&["rules", "--torque", "0.2,0.1"])
        .success()
        .stderr(contains("the torque limit of joint 0 is now 0.2 N m, before 0.1"));
}

#[test]
fn the_limit_of_the_tip_force_goes_as_high_as_the_safety_page_says() {
    let page = std::fs::read_to_string(file("../docs/safety.md")).unwrap();
    assert!(page.contains("at most 100 N; 1000 N on a simulated board without `--strict`"));
    for (options, most) in [(&["--fast", "--strict"][..], "100"), (&["--fast"], "1000")] {
        let sim = Sim::start(options);
        sim.run(&["rules", "--tip-force", most]).success().stdout(contains(format!("force at the tip    {most} N")));
        for command in [&["rules"][..], &["device", &file("coupled-five-bar.toml")]] {
            let refused = sim.run(&[command, &["--tip-force", "1001"]].concat()).code(1);
            refused.stderr(contains(format!("1001 N: this board takes more than 0 and at most {most} N")));
        }
    }
}

/// A board whose firmware is of another protocol version: it understands what never changes.
struct Stranger {
    port: String,
    stopped: std::sync::mpsc::Receiver<()>,
}

impl Stranger {
    fn plugged(protocol: u16) -> Self {
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
                    let mut answers = Vec::new();
                    deframer.feed(&buffer[..count], |frame| {
                        let answer = |key, body: &[u8]| {
                            encode(&VarHeader { key: VarKey::Key8(key), seq_no: frame.header.seq_no }, body)
                        };
                        let (firmware, board) = ("9.9".chars().collect(), "odrive-v3".chars().collect());
                        let info = Info { protocol, firmware, board, serial: "A1".chars().collect() };
                        if frame.header.key == VarKey::Key8(GetInfo::REQ_KEY) {
                            answers.extend(answer(GetInfo::RESP_KEY, &postcard::to_stdvec(&info).unwrap()));
                        } else if frame.header.key == VarKey::Key8(Disarm::REQ_KEY) {
                            stop.send(()).unwrap();
                            // The reasons for a refusal are others there, so the answer has another key.
                            let done: Outcome = Ok(());
                            let another = postcard_rpc::Key::for_path::<u64>("haptic/disarm");
                            answers.extend(answer(another, &postcard::to_stdvec(&done).unwrap()));
                        }
                    });
                    tool.write_all(&answers).unwrap();
                }
            }
        });
        Self { port, stopped }
    }
}

#[test]
fn a_board_of_another_version_is_disarmed_and_nothing_else() {
    use haptic_bridge::board::protocol::PROTOCOL;
    for protocol in [PROTOCOL - 1, PROTOCOL + 1] {
        let board = Stranger::plugged(protocol);
        haptic(&["disarm", "--port", &board.port]).assert().success().stdout(contains("the motors are off"));
        assert!(board.stopped.try_recv().is_ok());
        haptic(&["arm", "--port", &board.port]).assert().code(1).stderr(contains("protocol version"));
    }
}
