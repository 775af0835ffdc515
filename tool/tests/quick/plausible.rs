//! Valid but implausible values cause warnings on standard error and in JSON. Shipped files cause no warnings.

use crate::common::{Folder, json, output, pose_option, read, run, shipped_path, toml_files, type_lines};
use serde_json::Value;

/// Checks haply-2diy with these changes. Returns the JSON document and standard error.
fn check_changed(changes: &[(&str, &str)], scene: Option<&str>) -> (Value, String) {
    let folder = Folder::new();
    let device = folder.write_changed("haply-2diy", changes);
    let scene = scene.map(|scene| folder.write("scene.toml", scene));
    let arguments = ["check", &device, "--json"].into_iter().chain(scene.as_deref());
    let (code, out, err) = run(&arguments.collect::<Vec<_>>());
    assert_eq!(code, 0, "{err}");
    (serde_json::from_str(&out).unwrap(), err)
}

/// Returns the warning that contains these words.
fn find_warning<'a>(document: &'a Value, words: &str) -> Option<&'a Value> {
    document["warnings"].as_array().unwrap().iter().find(|warning| warning["text"].as_str().unwrap().contains(words))
}

fn no_warnings(document: &Value) -> bool {
    document["warnings"].as_array().unwrap().is_empty()
}

fn wall_toml(point: &str, stiffness: &str, damping: &str) -> String {
    format!("[[wall]]\npoint = {point}\nnormal = [0.0, -1.0]\nstiffness = {stiffness}\ndamping = {damping}\n")
}

#[test]
fn wrong_units_cause_a_warning_at_their_line() {
    let in_mm = [("0.07, 0.07", "70, 70"), ("0.09, 0.09", "90, 90"), ("base = 0.038", "base = 38")];
    // The torque constant of a bare motor, although its gear has a ratio of 15.
    let without_gear =
        [("torque_constant = 0.033333", "torque_constant = 0.0022"), ("coulomb = 0.002", "coulomb = 0.0")];
    let soft_transmission = ("transmission = \"rigid\"\n", "[joint.transmission]\nstiffness = 0.1\n");
    for (changes, key, warning) in [
        (&in_mm[..], "base = 38", "metres"),
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
        (&[("coulomb = 0.002", "coulomb = 0.2")], "coulomb = 0.2", "the joint cannot move"),
        (&[("counts_per_turn = 10752", "counts_per_turn = 500")], "counts_per_turn = 500", "500 lines are 2000 counts"),
        (&without_gear, "torque_constant = 0.0022", "the motor's constant times the gear ratio"),
        (&[soft_transmission], "stiffness = 0.1", "winds up by 57 degrees at the largest torque of its motor"),
    ] {
        let (json, err) = check_changed(changes, None);
        let found = find_warning(&json, warning).unwrap_or_else(|| panic!("{changes:?}: {err}"));
        assert!(err.contains(found["text"].as_str().unwrap()), "{err}");
        assert!(err.lines().all(|line| line.starts_with("haptic: warning: ")), "{err}");
        let text = changes.iter().fold(read("devices/haply-2diy.toml"), |text, (from, to)| text.replace(from, to));
        let line = text.lines().nth(found["line"].as_u64().unwrap() as usize - 1).unwrap();
        assert!(line.contains(key), "{line} is not the changed line, {key}");
    }
}

#[test]
fn scenes_beyond_reach_loop_or_motors_cause_warnings() {
    let at = "[0.0, 0.125]";
    for (scene, warning) in [
        (wall_toml("[0.0, 100.0]", "3000.0", "6.0"), "out of reach"),
        (wall_toml(at, "3.0e9", "6.0"), "times that"),
        (wall_toml(at, "3.0e9", "6.0"), "one encoder count into wall 0"),
        (wall_toml(at, "3000.0", "6.0e4"), "the damping of wall 0"),
        (wall_toml(at, "1.5", "0.01"), "1.5 N/mm are 1500 N/m"),
        ("[[spring]]\npoint = [0, 0.1]\nstiffness = 1e9\n".into(), "the stiffness of spring 0"),
        ("[[spring]]\npoint = [0, 0.1]\nstiffness = 100\ndamping = 1e6\n".into(), "the damping of spring 0"),
        ("[[field]]\ndamping = 1e6\n".into(), "the damping of the fields"),
    ] {
        let (json, err) = check_changed(&[], Some(&scene));
        assert!(find_warning(&json, warning).is_some() && err.contains(warning), "{scene}: {err}");
    }
    let gentle = "[[spring]]\npoint = [0, 0.1]\nstiffness = 100\ndamping = 0.2\n[[field]]\ndamping = 0.5\n";
    let (_, err) = check_changed(&[], Some(gentle));
    assert!(!err.contains("predicted stable"), "{err}");
    // Walls so soft that the motors can render them in full cause no warning.
    assert!(["60.0", "0.0"].iter().all(|soft| no_warnings(&check_changed(&[], Some(&wall_toml(at, soft, "1.0"))).0)));
    // Without damping no stiffness is stable, so the warning must not compare the stiffness with a limit.
    let (_, err) = check_changed(&[("viscous = 0.0003", "viscous = 0.0")], Some(&wall_toml(at, "3000.0", "0.0")));
    assert!(err.contains("write a damping of up to") && !err.contains("times that"), "{err}");
}

#[test]
fn check_prints_how_far_an_encoder_count_moves_the_tip() {
    let device = "devices/hapkit-paddle.toml";
    let step = json(&["check", device])["summary"]["count_at_home"].as_f64().unwrap();
    // One count is 70 mm times a turn (in rad) / 60,000.
    assert!((step - 0.07 * core::f64::consts::TAU / 60e3).abs() < 1e-9, "{step}");
    type_lines(&format!("check {device} => one encoder count moves the tip at home by up to 7.33 µm"), &[]);
}

#[test]
fn missing_transmissions_and_coarse_encoders_cause_warnings() {
    let rigid = "transmission = \"rigid\"\n";
    let (json, err) = check_changed(&[(rigid, "")], None);
    let [warning] = &json["warnings"].as_array().unwrap()[..] else { panic!("{err}") };
    let text = warning["text"].as_str().unwrap();
    assert!(text.contains("the transmission of joint 0 and 1") && text.contains("[joint.transmission]"), "{text}");
    assert!(no_warnings(&check_changed(&[(rigid, "[joint.transmission]\nstiffness = 20.0\n")], None).0));
    // At a high cutoff a hand feels the encoder steps in the damping of a wall, at a low cutoff it does not.
    let of = |cutoff: f64| {
        let wall = wall_toml("[0.0, 0.125]", "500.0", "12.0");
        let scene = format!("rate_hz = 20000\ncutoff_hz = {cutoff:?}\n{wall}feed_forward = \"off\"\n");
        let (json, _) = check_changed(&[], Some(&scene));
        (json["scenes"][0]["contacts"][0]["step_n"].as_f64().unwrap(), find_warning(&json, "buzz").is_some())
    };
    let (fast, slow) = (of(2_000.0), of(100.0));
    assert!(fast.0 > 1.0 && fast.1, "{fast:?}");
    assert!(slow.0 < 0.3 && !slow.1, "{slow:?}");
}

#[test]
fn check_names_the_limit_of_haptic_range() {
    let scene = wall_toml("[0.0, 0.125]", "3e9", "6.0") + "feed_forward = \"off\"\n";
    let (checked, _) = check_changed(&[], Some(&scene));
    let contact = &checked["scenes"][0]["contacts"][0];
    let q = pose_option(&contact["q"]);
    let wall = ["--normal", "0,-1", "--rate", "20000", "--cutoff", "500", "--board", "odrive-v3", "--kd", "6"];
    let range = json(&[&["range", "devices/haply-2diy.toml", &q], &wall[..]].concat());
    let (stable_to, predicted) = (contact["stable_to"].as_f64(), range["off"]["boundary"][0]["kp"].as_f64().unwrap());
    assert!((stable_to.unwrap() / predicted - 1.0).abs() < 1e-9, "{stable_to:?} {predicted}");
}

/// Limits of a wheel of 900 degrees and of a knob of fifty turns are plausible, limits of a Hapkit in degrees are not.
#[test]
fn a_paddle_may_turn_often_but_limits_in_degrees_warn() {
    let shipped = read("devices/hapkit-paddle.toml");
    let coulomb = shipped.lines().find(|line| line.starts_with("coulomb")).unwrap();
    for (limits, warnings) in [("[-7.85, 7.85]", 0), ("[-314.0, 314.0]", 0), ("[-40.0, 40.0]", 1), ("[-90, 90]", 1)] {
        let folder = Folder::new();
        let limited = format!("{coulomb}\nlimits = {limits}");
        let (code, _, err) = run(&["check", &folder.write_changed("hapkit-paddle", &[(coulomb, &limited)])]);
        assert_eq!((code, err.matches("angles are in radians").count()), (0, warnings), "{limits}: {err}");
    }
}

/// Exchanged motors place the tip behind the base. Motors on one axis have no left and right, so the arms never cross.
#[test]
fn arms_that_cross_at_home_cause_a_warning() {
    let exchanged = ("q = [2.3, 0.84159265358979]", "q = [0.84159265358979, 2.3]");
    assert!(check_changed(&[exchanged], None).1.contains("the arms cross at home"));
    assert!(!check_changed(&[exchanged, ("base = 0.038", "base = 0.0")], None).1.contains("the arms cross"));
}

/// A wall far below the stability limit may rattle: a hand that slides along the wall feels every encoder step.
#[test]
fn a_wall_that_rattles_causes_a_warning() {
    let contact = |stiffness: f64, damping: f64| {
        let at = "point = [0.0, 0.108]\nnormal = [0.0, 1.0]\nfeed_forward = \"off\"";
        let wall = format!("[[wall]]\n{at}\nstiffness = {stiffness}\ndamping = {damping}\n");
        let (json, err) = check_changed(&[], Some(&format!("rate_hz = 20000\ncutoff_hz = 500\n{wall}")));
        let contact = &json["scenes"][0]["contacts"][0];
        (["stable_to", "step_n", "ripple_n"].map(|key| contact[key].as_f64().unwrap()), err)
    };
    let ([stable_to, step, ripple], err) = contact(8_000.0, 12.0);
    assert!(stable_to > 8_000.0 && step < 1.0 && ripple > 0.1 && err.contains("wall 0 rattles"), "{ripple}: {err}");
    let ([.., ripple], err) = contact(1_500.0, 3.0);
    assert!(ripple < 0.1 && err.is_empty(), "{ripple}: {err}");
}

#[test]
fn shipped_files_cause_no_warnings() {
    let shipped = toml_files("");
    assert!(shipped.len() >= 7);
    for device in shipped {
        let name = device.file_stem().unwrap().to_str().unwrap();
        let scenes = toml_files(&format!("scenes/{name}"));
        let scenes = scenes.iter().map(|path| path.to_str().unwrap());
        let (code, out, err) = run(&["check", device.to_str().unwrap()].into_iter().chain(scenes).collect::<Vec<_>>());
        assert_eq!(code, 0, "{err}");
        // Some scenes are stiff on purpose, to show the feed-forward, so `check` may warn that they rattle.
        let lines: Vec<&str> = err.lines().filter(|line| !line.contains("rattles: its force ripples")).collect();
        // The cable stiffness of these devices is not published, so their files leave it out, with one warning.
        if ["capstan-pantograph", "hapkit-paddle", "phantom-premium-1.5", "woodenhaptics"].contains(&name) {
            let [line] = lines[..] else { panic!("{err}") };
            assert!(line.contains("the file does not describe the transmission of joint"), "{err}");
        } else {
            assert_eq!(lines, [""; 0], "{out}");
        }
        assert!(out.contains("tip at home") && out.contains("largest force"), "{out}");
    }
}

/// The Phantom's arm has the length upper + fore and turns freely about y, so this is the reach in ±x and ±z.
#[test]
fn the_reach_is_exact_although_the_grid_is_coarse() {
    let reach = json(&["check", "devices/phantom-premium-1.5.toml"])["summary"]["reach"].clone();
    for (axis, end, sign) in [(0, "low", -1.0), (0, "high", 1.0), (2, "low", -1.0), (2, "high", 1.0)] {
        let reached = sign * reach[axis][end].as_f64().unwrap();
        assert!((reached - 0.379095).abs() < 1e-5, "axis {axis}, {end}: {reached}");
    }
}

/// The text and the JSON have the same largest force, on devices with as many joints as directions or more.
#[test]
fn text_and_json_have_the_same_largest_force() {
    for name in ["phantom-premium-1.5", "haply-2diy", "coupled-five-bar", "capstan-pantograph", "woodenhaptics"] {
        let path = shipped_path(&format!("{name}.toml"));
        let high = json(&["check", &path])["summary"]["force_at_home"]["high"].as_f64().unwrap();
        let printed = output(&["check", &path]);
        let printed_force = printed.split("its motors make up to ").nth(1).unwrap().split(' ').next().unwrap();
        assert_eq!(format!("{high:.1}"), printed_force, "{name}\n{printed}");
    }
}

#[test]
fn swapped_device_and_scene_files_are_reported() {
    let (device, scene) = ("devices/haply-2diy.toml", "devices/scenes/haply-2diy/wall-soft.toml");
    let table = "2: check SCENE => looks like a scene file\n2: check DEVICE DEVICE => looks like a device file";
    type_lines(&table.replace("SCENE", scene).replace("DEVICE", device), &[]);
}

#[test]
fn a_new_file_passes_check() {
    let folder = Folder::new();
    for kind in ["paddle", "paddles", "five-bar", "five-bar-turret", "parallelogram", "serial-3r", "chain", "delta"] {
        let (path, drawing) = (folder.path(&format!("{kind}.toml")), folder.path(&format!("{kind}.svg")));
        type_lines(&format!("new {kind} -o {path}"), &[]);
        let (code, out, err) = run(&["check", &path, "--svg", &drawing]);
        assert_eq!((code, err.lines().count()), (0, 1), "{out} {err}");
        assert!(err.contains("the file does not describe the transmission of joint"), "{err}");
        assert!(std::fs::read_to_string(&drawing).unwrap().contains("joint "), "{kind}");
    }
    type_lines("2: new six-bar", &[]);
}

/// If there are no warnings, the document has no key `warnings`.
#[test]
fn warnings_about_arguments_are_in_the_json_document() {
    let model = ["model", "devices/haply-2diy.toml"];
    let range = ["range", model[1], "--normal", "0,1", "--rate", "1000", "--cutoff", "20"];
    for arguments in [&model[..], &range] {
        let document = json(&[arguments, &["--q=132,48"]].concat());
        let warnings = document["warnings"].as_array().unwrap();
        assert_eq!(warnings.len(), 2, "{document}");
        assert!(warnings[0]["text"].as_str().unwrap().contains("132 degrees are 2.3038 rad"), "{document}");
    }
    assert_eq!(json(&model).get("warnings"), None);
    let (code, _, err) = run(&[&model[..], &["--q", "132,48"]].concat());
    assert!(code != 2 && err.contains("132 degrees are 2.3038 rad"), "{code} {err}");
}

#[test]
fn a_washout_that_costs_stability_causes_a_warning() {
    let print_warnings = |corner: &str, feed_forward: &str| {
        let wall = "[[wall]]\npoint = [0, 0.03]\nnormal = [0.6, 0.8]\nstiffness = 50\ndamping = 2\n";
        let law = format!("feed_forward = \"{feed_forward}\"\nwashout_hz = {corner}\n");
        let folder = Folder::new();
        let scene = folder.write("scene.toml", format!("rate_hz = 200\ncutoff_hz = 20\n{wall}{law}"));
        let (code, _, err) = run(&["check", "devices/capstan-pantograph.toml", &scene]);
        assert_eq!(code, 0, "{err}");
        err
    };
    let costs = print_warnings("10", "washout");
    assert!(costs.contains("the washout of wall 0, 10 Hz, costs more than it brings"), "{costs}");
    let harmless_corner = costs.split("a corner of ").nth(1).unwrap().split(' ').next().unwrap();
    assert!(harmless_corner.parse::<f64>().unwrap() < 10.0, "{costs}");
    for (corner, feed_forward) in [(harmless_corner, "washout"), ("10", "full"), ("10", "off")] {
        let err = print_warnings(corner, feed_forward);
        assert!(!err.contains("the washout of wall"), "{corner} {feed_forward}: {err}");
    }
}
