//! What parses but can hardly be meant is said, on standard error and in JSON; what is shipped is not doubted.

use crate::common::{self, file, files};
use serde_json::Value;

/// Exit code, standard output and standard error.
fn haptic(arguments: &[&str]) -> (i32, String, String) {
    let done = common::haptic(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (done.status.code().unwrap(), text(done.stdout), text(done.stderr))
}

/// The shipped device with one thing changed, checked with `--json`: the document and standard error.
fn checked(changes: &[(&str, &str)], scene: Option<&str>) -> (Value, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut text = std::fs::read_to_string(file("haply-2diy.toml")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let device = folder.path().join("device.toml");
    std::fs::write(&device, text).unwrap();
    let mut arguments = vec!["check".to_string(), device.display().to_string(), "--json".into()];
    if let Some(scene) = scene {
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, scene).unwrap();
        arguments.push(path.display().to_string());
    }
    let (code, out, err) = haptic(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code, 0, "{err}");
    (serde_json::from_str(&out).unwrap(), err)
}

#[test]
fn wrong_units_are_doubted_at_their_line() {
    for (changes, key, said) in [
        (
            &[("0.07, 0.07", "70, 70"), ("0.09, 0.09", "90, 90"), ("base = 0.038", "base = 38")][..],
            "base = 38",
            "metres",
        ),
        (&[("mass = 0.018", "mass = 18")], "mass = 18", "18 g are 0.018 kg"),
        (&[("inertia = 9e-06", "inertia = 9000")], "inertia = 9000", "longest link"),
        (&[("inertia = 9e-06", "inertia = 9e-12")], "inertia = 9e-12", "steel ball"),
        (&[("inertia = 1.4e-06", "inertia = 14")], "inertia = 14", "1 g cm² is 1e-7"),
        (&[("q = [2.3, 0.84159265358979]", "q = [132, 48]")], "[132, 48]", "132 degrees are 2.3038 rad"),
        (&[("coulomb = 0.002", "coulomb = 0.002\nlimits = [-180, 180]")], "[-180, 180]", "turns"),
        (&[("torque_constant = 0.033333", "torque_constant = 33.3")], "torque_constant", "mN m/A"),
        (&[("max_current = 3.0", "max_current = 3000.0")], "max_current", "current in A"),
        (&[("inductance = 0.001", "inductance = 1.0")], "inductance", "1 mH is 0.001"),
        (&[("counts_per_turn = 10752", "counts_per_turn = 48")], "counts_per_turn = 48", "gear ratio"),
        (&[("coulomb = 0.002", "coulomb = 0.2")], "coulomb = 0.2", "cannot move itself"),
        (&[("counts_per_turn = 10752", "counts_per_turn = 500")], "counts_per_turn = 500", "500 lines are 2000 counts"),
        // The motor's own, whose rotor is behind a ratio of 15.
        (
            &[("torque_constant = 0.033333", "torque_constant = 0.0022"), ("coulomb = 0.002", "coulomb = 0.0")],
            "torque_constant = 0.0022",
            "the motor's times the ratio",
        ),
        (
            &[("transmission = \"rigid\"\n", "[joint.transmission]\nstiffness = 0.1\n")],
            "stiffness = 0.1",
            "gives by 57 degrees where its motor pushes with all that it has",
        ),
    ] {
        let (json, err) = checked(changes, None);
        let warnings = json["warnings"].as_array().unwrap();
        assert!(!warnings.is_empty(), "{changes:?} is not doubted");
        let found = warnings.iter().find(|w| w["text"].as_str().unwrap().contains(said));
        let found = found.unwrap_or_else(|| panic!("{changes:?}: {err}"));
        assert!(err.contains(found["text"].as_str().unwrap()), "{err}");
        assert!(err.lines().all(|line| line.starts_with("haptic: warning: ")), "{err}");
        // The line that is named is the line that was changed.
        let mut text = std::fs::read_to_string(file("haply-2diy.toml")).unwrap();
        changes.iter().for_each(|(from, to)| text = text.replace(from, to));
        let line = text.lines().nth(found["line"].as_u64().unwrap() as usize - 1).unwrap().to_string();
        assert!(line.contains(key), "{line} is not {key}");
    }
}

#[test]
fn walls_beyond_reach_loop_and_motors_are_doubted() {
    let wall = |point: &str, stiffness: &str, damping: &str| {
        format!("[[wall]]\npoint = {point}\nnormal = [0.0, -1.0]\nstiffness = {stiffness}\ndamping = {damping}\n")
    };
    for (scene, said) in [
        (wall("[0.0, 100.0]", "3000.0", "6.0"), "out of reach"),
        (wall("[0.0, 0.125]", "3.0e9", "6.0"), "times that"),
        (wall("[0.0, 0.125]", "3.0e9", "6.0"), "one encoder count into wall 0"),
        (wall("[0.0, 0.125]", "3000.0", "6.0e4"), "the damping of wall 0"),
        (wall("[0.0, 0.125]", "1.5", "0.01"), "1.5 N/mm are 1500 N/m"),
    ] {
        let (json, err) = checked(&[], Some(&scene));
        assert!(
            json["warnings"].as_array().unwrap().iter().any(|w| w["text"].as_str().unwrap().contains(said)),
            "{err}"
        );
    }
    // A damping that was forgotten leaves nothing stable on a device that has none: not so many times nothing.
    let (_, err) = checked(&[("viscous = 0.0003", "viscous = 0.0")], Some(&wall("[0.0, 0.125]", "3000.0", "0.0")));
    assert!(err.contains("write a damping of up to") && !err.contains("times that"), "{err}");
}

#[test]
fn check_says_how_far_an_encoder_count_moves_the_tip() {
    let path = file("hapkit-paddle.toml");
    let (code, out, _) = haptic(&["check", &path]);
    let (_, json, _) = haptic(&["check", &path, "--json"]);
    let step = serde_json::from_str::<Value>(&json).unwrap()["summary"]["count_at_home"].as_f64().unwrap();
    // 70 mm times a turn, in 60,000 counts.
    assert!((step - 0.07 * core::f64::consts::TAU / 60e3).abs() < 1e-9, "{step}");
    assert!(code == 0 && out.contains("one encoder count moves the tip at home by up to 7.33 µm"), "{out}");
}

#[test]
fn what_a_file_leaves_out_and_what_coarse_encoders_do_is_said() {
    let rigid = "transmission = \"rigid\"\n";
    let (json, err) = checked(&[(rigid, "")], None);
    let [warning] = &json["warnings"].as_array().unwrap()[..] else { panic!("{err}") };
    let text = warning["text"].as_str().unwrap();
    assert!(text.contains("motor and link of joint 0 and 1") && text.contains("[joint.transmission]"), "{text}");
    let soft = "[joint.transmission]\nstiffness = 20.0\n";
    assert!(checked(&[(rigid, soft)], None).0["warnings"].as_array().unwrap().is_empty());

    // The same wall, whose damping is felt in steps at a high rate, and not at a low one.
    let scene = |rate: f64, cutoff: f64| {
        format!(
            "rate_hz = {rate:?}\ncutoff_hz = {cutoff:?}\n[[wall]]\npoint = [0.0, 0.125]\nnormal = [0.0, -1.0]\n\
             stiffness = 500.0\ndamping = 12.0\nfeed_forward = \"off\"\n"
        )
    };
    let of = |rate, cutoff| {
        let (json, err) = checked(&[], Some(&scene(rate, cutoff)));
        let step = json["scenes"][0]["contacts"][0]["step_n"].as_f64().unwrap();
        (step, json["warnings"].as_array().unwrap().iter().any(|w| w["text"].as_str().unwrap().contains("buzz")), err)
    };
    let (fast, slow) = (of(20_000.0, 2_000.0), of(20_000.0, 100.0));
    assert!(fast.0 > 1.0 && fast.1, "{fast:?}");
    assert!(slow.0 < 0.3 && !slow.1, "{slow:?}");
}

#[test]
fn springs_and_fields_that_no_loop_renders_are_doubted() {
    for (scene, said) in [
        ("[[spring]]\npoint = [0, 0.1]\nstiffness = 1e9\n", "the stiffness of spring 0"),
        ("[[spring]]\npoint = [0, 0.1]\nstiffness = 100\ndamping = 1e6\n", "the damping of spring 0"),
        ("[[field]]\ndamping = 1e6\n", "the damping of the fields"),
    ] {
        let (json, err) = checked(&[], Some(scene));
        assert!(err.contains(said) && err.contains("predicted stable at home"), "{scene}: {err}");
        assert!(!json["warnings"].as_array().unwrap().is_empty(), "{scene}");
    }
    let (_, err) =
        checked(&[], Some("[[spring]]\npoint = [0, 0.1]\nstiffness = 100\ndamping = 0.2\n[[field]]\ndamping = 0.5\n"));
    assert!(!err.contains("predicted stable"), "{err}");
}

#[test]
fn a_soft_wall_that_the_device_can_press_in_full_is_not_doubted() {
    for stiffness in ["60.0", "0.0"] {
        let scene =
            format!("[[wall]]\npoint = [0.0, 0.125]\nnormal = [0.0, -1.0]\nstiffness = {stiffness}\ndamping = 1.0\n");
        let (json, err) = checked(&[], Some(&scene));
        assert!(json["warnings"].as_array().unwrap().is_empty(), "{err}");
    }
}

#[test]
fn the_limit_that_is_named_is_that_of_haptic_range() {
    let scene = "[[wall]]\npoint = [0.0, 0.125]\nnormal = [0.0, -1.0]\nstiffness = 3e9\ndamping = 6.0\nfeed_forward = \"off\"\n";
    let (json, _) = checked(&[], Some(scene));
    let contact = &json["scenes"][0]["contacts"][0];
    let q: Vec<String> =
        contact["q"].as_array().unwrap().iter().map(|v| format!("{:e}", v.as_f64().unwrap())).collect();
    let device = file("haply-2diy.toml");
    let q = format!("--q={}", q.join(","));
    let (code, out, err) = haptic(&[
        "range",
        &device,
        &q,
        "--normal",
        "0,-1",
        "--rate",
        "20000",
        "--cutoff",
        "500",
        "--board",
        "odrive-v3",
        "--kd",
        "6",
        "--json",
    ]);
    assert_eq!(code, 0, "{err}");
    let range: Value = serde_json::from_str(&out).unwrap();
    let (named, predicted) =
        (contact["stable_to"].as_f64().unwrap(), range["off"]["boundary"][0]["kp"].as_f64().unwrap());
    assert!((named / predicted - 1.0).abs() < 1e-9, "{named} {predicted}");
}

/// A wheel of 900 degrees and a knob of fifty turns are no mistakes; a Hapkit's limits in degrees are one.
#[test]
fn a_paddle_may_turn_often_and_its_degrees_are_doubted_all_the_same() {
    let shipped = std::fs::read_to_string(file("hapkit-paddle.toml")).unwrap();
    let coulomb = shipped.lines().find(|line| line.starts_with("coulomb")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wheel.toml").display().to_string();
    for (written, doubted) in [("[-7.85, 7.85]", 0), ("[-314.0, 314.0]", 0), ("[-40.0, 40.0]", 1), ("[-90, 90]", 1)] {
        std::fs::write(&path, shipped.replace(coulomb, &format!("{coulomb}\nlimits = {written}"))).unwrap();
        let (code, _, err) = haptic(&["check", &path]);
        assert_eq!((code, err.matches("angles are in radians").count()), (0, doubted), "{written}: {err}");
    }
}

/// With the motors exchanged the tip lies behind the base, and the device is another one.
#[test]
fn arms_that_cross_at_home_are_doubted() {
    let exchanged = [("q = [2.3, 0.84159265358979]", "q = [0.84159265358979, 2.3]")];
    let (_, err) = checked(&exchanged, None);
    assert!(err.contains("the arms cross at home"), "{err}");
    // Motors on one axis have no left and no right.
    let (_, err) = checked(&[exchanged[0], ("base = 0.038", "base = 0.0")], None);
    assert!(!err.contains("the arms cross"), "{err}");
}

/// A wall far within what is stable may rattle: a hand that slides along it feels every encoder step.
#[test]
fn a_wall_that_rattles_is_doubted_and_a_quiet_one_is_not() {
    let wall = |stiffness: f64, damping: f64| {
        let at = "point = [0.0, 0.108]\nnormal = [0.0, 1.0]\nfeed_forward = \"off\"";
        format!("rate_hz = 20000\ncutoff_hz = 500\n[[wall]]\n{at}\nstiffness = {stiffness}\ndamping = {damping}\n")
    };
    let (json, err) = checked(&[], Some(&wall(8_000.0, 12.0)));
    let contact = &json["scenes"][0]["contacts"][0];
    assert!(contact["stable_to"].as_f64().unwrap() > 8_000.0 && contact["step_n"].as_f64().unwrap() < 1.0, "{contact}");
    assert!(contact["ripple_n"].as_f64().unwrap() > 0.1 && err.contains("wall 0 rattles"), "{contact}: {err}");
    let (json, err) = checked(&[], Some(&wall(1_500.0, 3.0)));
    assert!(json["scenes"][0]["contacts"][0]["ripple_n"].as_f64().unwrap() < 0.1 && err.is_empty(), "{err}");
}

#[test]
fn nothing_shipped_is_doubted() {
    let shipped = files("");
    assert!(shipped.len() >= 7);
    for device in shipped {
        let scenes = files(&format!("scenes/{}", device.file_stem().unwrap().display()));
        let mut arguments = vec!["check", device.to_str().unwrap()];
        arguments.extend(scenes.iter().map(|path| path.to_str().unwrap()));
        let (code, out, err) = haptic(&arguments);
        assert_eq!(code, 0, "{err}");
        // Nobody has published how stiff their cables are, and the files do not pretend.
        let cables = ["capstan-pantograph", "hapkit-paddle", "phantom-premium-1.5", "woodenhaptics"];
        // Some scenes are stiff on purpose, to show what the feed-forward is for: they ripple, and `check` says so.
        let said: Vec<&str> = err.lines().filter(|line| !line.contains("rattles: its force ripples")).collect();
        if cables.contains(&device.file_stem().unwrap().to_str().unwrap()) {
            let [line] = said[..] else { panic!("{err}") };
            assert!(line.contains("nothing says what lies between motor and link"), "{err}");
        } else {
            assert_eq!(said, [""; 0], "{out}");
        }
        assert!(out.contains("tip at home") && out.contains("largest force"), "{out}");
    }
}

#[test]
fn reach_and_force_are_the_exact_ones_however_coarse_the_grid() {
    let summary = |name: &str| -> Value {
        let (code, out, err) = haptic(&["check", &file(name), "--json"]);
        assert_eq!(code, 0, "{err}");
        serde_json::from_str::<Value>(&out).unwrap()["summary"].clone()
    };
    // The Phantom's arm is upper + fore long and turns freely about y: x and z reach as far as it does, to either side.
    let phantom = summary("phantom-premium-1.5.toml");
    for axis in [0, 2] {
        for (end, sign) in [("low", -1.0), ("high", 1.0)] {
            let reached = sign * phantom["reach"][axis][end].as_f64().unwrap();
            assert!((reached - 0.379095).abs() < 1e-5, "axis {axis}, {end}: {reached}");
        }
    }
}

/// "up to X N" of the sentence about motors is the largest of "by direction" wherever joints and directions are as
/// many.
#[test]
fn both_largest_forces_are_the_same_number() {
    for name in ["phantom-premium-1.5", "haply-2diy", "coupled-five-bar", "capstan-pantograph", "woodenhaptics"] {
        let path = file(&format!("{name}.toml"));
        let (_, json, _) = haptic(&["check", &path, "--json"]);
        let high = serde_json::from_str::<Value>(&json).unwrap()["summary"]["force_at_home"]["high"].as_f64().unwrap();
        let (_, said, _) = haptic(&["check", &path]);
        let told = said.split("its motors make up to ").nth(1).unwrap().split(' ').next().unwrap();
        assert_eq!(format!("{high:.1}"), told, "{name}\n{said}");
    }
}

#[test]
fn model_doubts_angles_in_degrees() {
    let device = file("haply-2diy.toml");
    let (code, _, err) = haptic(&["model", &device, "--q", "132,48"]);
    assert!(code != 2 && err.contains("132 degrees are 2.3038 rad"), "{code} {err}");
}

#[test]
fn a_scene_given_as_a_device_is_named_so_and_the_other_way_round() {
    let device = file("haply-2diy.toml");
    let scene = file("scenes/haply-2diy/wall-soft.toml");
    let (code, _, err) = haptic(&["check", &scene]);
    assert!(code == 2 && err.contains("looks like a scene file"), "{err}");
    let (code, _, err) = haptic(&["check", &device, &device]);
    assert!(code == 2 && err.contains("looks like a device file"), "{err}");
}

#[test]
fn what_never_ends_or_is_huge_is_not_read() {
    let (code, _, err) = haptic(&["check", "/dev/zero"]);
    assert!(code == 2 && err.contains("a pipe or a device"), "{err}");
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo");
    assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let (code, _, err) = haptic(&["check", fifo.to_str().unwrap()]);
    assert!(code == 2 && err.contains("a pipe or a device"), "{err}");
    let huge = folder.path().join("huge.toml");
    std::fs::write(&huge, "#".repeat((1 << 20) + 1)).unwrap();
    let (code, _, err) = haptic(&["check", huge.to_str().unwrap()]);
    assert!(code == 2 && err.contains("1 MiB") && !err.contains("permissions"), "{err}");
}

#[test]
fn a_new_file_passes_check_and_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["paddle", "five-bar", "five-bar-turret", "parallelogram", "serial-3r"] {
        let path = folder.path().join(format!("{kind}.toml"));
        let path = path.to_str().unwrap();
        assert_eq!(haptic(&["new", kind, "-o", path]).0, 0);
        let drawing = folder.path().join(format!("{kind}.svg"));
        let (code, out, err) = haptic(&["check", path, "--svg", drawing.to_str().unwrap()]);
        assert_eq!((code, err.lines().count()), (0, 1), "{out} {err}");
        assert!(err.contains("nothing says what lies between motor and link"), "{err}");
        assert!(std::fs::read_to_string(&drawing).unwrap().contains("joint "), "{kind}");
        std::fs::write(path, "mine").unwrap();
        assert_eq!(haptic(&["new", kind, "-o", path]).0, 1);
        assert_eq!(std::fs::read_to_string(path).unwrap(), "mine");
        assert_eq!(haptic(&["new", kind, "-o", path, "--force"]).0, 0);
        assert!(std::fs::read_to_string(path).unwrap().contains("[[joint]]"));
    }
    assert_eq!(haptic(&["new", "six-bar"]).0, 2);
}

#[test]
fn doubts_about_what_was_typed_are_in_the_json_document_too() {
    let device = file("haply-2diy.toml");
    let range = ["range", &device, "--normal", "0,1", "--rate", "1000", "--cutoff", "20", "--q=132,48", "--json"];
    for arguments in [&["model", &device, "--q=132,48", "--json"][..], &range] {
        let (code, out, err) = haptic(arguments);
        assert_eq!(code, 0, "{err}");
        let document: Value = serde_json::from_str(&out).unwrap();
        let warnings = document["warnings"].as_array().unwrap();
        assert_eq!(warnings.len(), 2, "{err}");
        assert!(warnings[0]["text"].as_str().unwrap().contains("132 degrees are 2.3038 rad"), "{err}");
    }
    // A document about which nothing is doubted has the keys of docs/files.md and no other.
    let (_, out, _) = haptic(&["model", &device, "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&out).unwrap().get("warnings"), None);
}

#[test]
fn a_drawing_is_not_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let device = file("haply-2diy.toml");
    for (option, name) in [("--svg", "a.svg"), ("--png", "a.png")] {
        let path = folder.path().join(name);
        std::fs::write(&path, "mine").unwrap();
        let drawn = ["check", &device, option, path.to_str().unwrap()];
        let (code, _, err) = haptic(&drawn);
        assert_eq!(code, 1, "{err}");
        assert!(err.contains("exists") && err.contains("--force"), "{err}");
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
        assert_eq!(haptic(&[&drawn[..], &["--force"]].concat()).0, 0);
        assert_ne!(std::fs::read(&path).unwrap(), b"mine");
    }
}

#[test]
fn a_washout_that_costs_stability_is_doubted_with_a_corner_that_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let device = file("capstan-pantograph.toml");
    let said = |corner: &str, feed_forward: &str| {
        let scene = folder.path().join("scene.toml");
        let wall = "[[wall]]\npoint = [0, 0.03]\nnormal = [0.6, 0.8]\nstiffness = 50\ndamping = 2\n";
        let law = format!("feed_forward = \"{feed_forward}\"\nwashout_hz = {corner}\n");
        std::fs::write(&scene, format!("rate_hz = 200\ncutoff_hz = 20\n{wall}{law}")).unwrap();
        let (code, _, err) = haptic(&["check", &device, scene.to_str().unwrap()]);
        assert_eq!(code, 0, "{err}");
        err
    };
    let costs = said("10", "washout");
    assert!(costs.contains("the washout of wall 0, 10 Hz, costs more than it brings"), "{costs}");
    let free = costs.split("a corner of ").nth(1).unwrap().split(' ').next().unwrap();
    assert!(free.parse::<f64>().unwrap() < 10.0, "{costs}");
    for (corner, feed_forward) in [(free, "washout"), ("10", "full"), ("10", "off")] {
        let err = said(corner, feed_forward);
        assert!(!err.contains("the washout of wall"), "{corner} {feed_forward}: {err}");
    }
}
