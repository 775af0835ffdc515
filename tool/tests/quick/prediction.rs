//! All commands agree on one prediction. Every command line that a command prints "to predict the same" has the same
//! result, and walls that are called passive are stable.

use crate::common::prelude::*;
use crate::common::{
    self, Folder, all_shipped_devices, json, output, read, run, shipped_device, shipped_path, type_lines,
};
use haptic_bridge::model::motor::Motor;
use haptic_predict::boards::torque_at_rest;
use haptic_predict::design::sensitivity::sensitivities;
use haptic_show::demo::{Demo, crossing};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::passivity::Passivity;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::stiffness_at;

/// A device with cables, a rigid device, and a redundant device.
const DEVICES: [&str; 3] = ["cable-five-bar", "haply-2diy", "serial-3r"];

fn is_close(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-6 * expected.abs()
}

/// Returns the prediction of `haptic range DEVICE` with these options for one feed-forward.
fn predict(device: &str, options: &str, feed_forward: &str) -> Value {
    let words: Vec<&str> = options.split(' ').collect();
    json(&[&["range", device], &words[..]].concat())[feed_forward].clone()
}

#[test]
fn the_line_printed_by_check_repeats_its_prediction() {
    let folder = Folder::new();
    let mut lines = 0;
    for name in DEVICES {
        let device = shipped_path(&format!("{name}.toml"));
        let shipped = std::fs::read_to_string(common::toml_files(&format!("scenes/{name}")).last().unwrap()).unwrap();
        let place = shipped.lines().filter(|line| line.starts_with("point =") || line.starts_with("normal ="));
        let place: Vec<&str> = place.take(2).collect();
        let wall = format!("[[wall]]\n{}\nstiffness = 500.0\ndamping = 2.5\n", place.join("\n"));
        let posture_toml = "[posture]\norientation = 2.3\nstiffness = 0.5\ndamping = 0.03\n";
        let posture = if name == "serial-3r" { posture_toml } else { "" };
        let compensation = if name == "cable-five-bar" { "" } else { "damping_compensation = true\n" };
        for (feed_forward, law) in [
            ("off", "rate_hz = 5000\ncutoff_hz = 300\n"),
            ("full", "estimator = \"difference\"\ndifference_over = 4\n"),
            ("washout", "admissible = \"consistent\"\nestimator = \"predicted\"\nrate_hz = 20000\ncutoff_hz = 250\n"),
        ] {
            let scene = format!("{law}{wall}feed_forward = \"{feed_forward}\"\n{compensation}{posture}");
            let report = json(&["check", &device, &folder.write("scene.toml", &scene)]);
            let contact = &report["scenes"][0]["contacts"][0];
            let options = contact["options"].as_str().unwrap_or_else(|| panic!("{name}\n{scene}\n{report}"));
            let found = predict(&device, options, feed_forward);
            let (kp, stable_to) = (&found["boundary"][0]["kp"], contact["stable_to"].as_f64().unwrap());
            assert!(stable_to > 0.0 && is_close(kp.as_f64().unwrap(), stable_to), "{name} {options}: {kp} {stable_to}");
            assert!(is_close(found["kd_max"].as_f64().unwrap(), contact["damping_to"].as_f64().unwrap()), "{options}");
            assert_eq!(found["boundary"][0].get("felt").is_some(), name == "cable-five-bar");
            assert_eq!(found["boundary"][0].get("felt"), contact.get("felt_to"), "{options}");
            // The line also works with options for the wall's ripple.
            if feed_forward == "full" {
                let rippled = predict(&device, &format!("{options} --wall 500,2.5"), "ripple");
                assert!(rippled["wall"]["full"]["rms_n"].as_f64().unwrap() < 1.0, "{options}: {rippled}");
            }
            lines += 1;
        }
    }
    assert_eq!(lines, 9);
}

#[test]
fn lines_of_range_and_measure_range_repeat_their_predictions() {
    let folder = Folder::new();
    for name in ["cable-five-bar", "haply-2diy"] {
        let device = shipped_path(&format!("{name}.toml"));
        let words = ["--normal=0.6,0.8", "--hand", "0.1,2,300", "--washout", "2", "--kd", "3,1", "--rate", "5000"];
        let range = json(&[&["range", &device, "--board", "odrive-v3", "--cutoff", "150"], &words[..]].concat());
        let printed_options = range["options"].as_str().unwrap().split(' ').collect::<Vec<_>>();
        let rerun = json(&[&["range", &device], &printed_options[..]].concat());
        assert_eq!((rerun["rate_hz"].as_f64(), rerun["drive"].as_str()), (Some(5000.0), Some("current")));
        for mode in ["off", "full", "washout"] {
            for (number, kp) in [("kd_max", None), ("area", None), ("boundary", Some(0)), ("boundary", Some(1))] {
                let of = |range: &Value| match kp {
                    Some(point) => range[mode][number][point]["kp"].as_f64().unwrap(),
                    None => range[mode][number].as_f64().unwrap(),
                };
                assert!(is_close(of(&rerun), of(&range)), "{name} {mode} {number}");
            }
        }
        // This point has been measured already, so `measure-range` prints its theory without moving a motor.
        let point = r#"{"mode": "off", "kd": 2.0, "repeats": [3000.0], "vibration_m": null, "open": null}"#;
        let what = "along (0.6, 0.8) at 1000 Hz, cutoff 100 Hz, washout 2 Hz, pull 0.5 mm, 1 N m, friction: none";
        let known = format!(
            "{{\"what\": \"{name} {what}\", \"ends\": [], \"open_ends\": [], \"q\": [], \"points\": [{point}], \"date\": null}}"
        );
        let progress = folder.write("progress.json", known);
        let world = ["--port", "sim", "--friction", "none", "--rate", "1000", "--cutoff", "100"];
        let once = ["--repeats", "1", "--kd", "2", "--feed-forward", "off", "--yes"];
        let progress_options = ["--normal=0.6,0.8", "--progress", &progress];
        let measured = json(&[&["measure-range", &device], &world[..], &once, &progress_options].concat());
        let point = &measured["points"][0];
        let line = measured["theory"].as_str().unwrap();
        let (_, options) = line.split_once(".toml ").unwrap();
        let theory = predict(&device, options, "off")["boundary"][0]["kp"].as_f64().unwrap();
        assert!(is_close(theory, point["theory_kp"].as_f64().unwrap()), "{name} {line}: {theory} {point}");
        match point.get("felt") {
            Some(stiffness) => {
                let cables = range["transmissions"].as_f64().unwrap();
                let in_series = 1.0 / (1.0 / 3000.0 + 1.0 / cables);
                assert!(name == "cable-five-bar" && is_close(stiffness.as_f64().unwrap(), in_series), "{stiffness}");
            }
            None => assert_eq!(name, "haply-2diy"),
        }
    }
}

#[test]
fn design_and_range_agree_on_devices_with_cables() {
    let device = shipped_path("cable-five-bar.toml");
    let q = ["--q=2.6,1.75", "--normal=0.94,-0.34", "--points", "40"];
    let found = json(&[&["design", &device], &q[..]].concat());
    for mode in ["off", "full"] {
        let here = &found["here"][mode];
        let options = format!("{} --kd {}", found["options"].as_str().unwrap(), here["kd"]);
        let range = &predict(&device, &options, mode)["boundary"][0];
        assert!(is_close(here["kp"].as_f64().unwrap(), range["kp"].as_f64().unwrap()), "{options}: {here} {range}");
        assert!(is_close(here["felt"].as_f64().unwrap(), range["felt"].as_f64().unwrap()), "{options}: {here} {range}");
        let full_prediction = predict(&device, found["options"].as_str().unwrap(), mode);
        let points = full_prediction["boundary"].as_array().unwrap().iter();
        let largest_kp = points.map(|point| point["kp"].as_f64().unwrap()).fold(0.0, f64::max);
        assert!((0.0..3e-3).contains(&(here["kp"].as_f64().unwrap() / largest_kp - 1.0)), "{largest_kp} {here}");
    }
}

/// A gear ratio larger by a tenth adds 21 % to the inertia of the motor, but nothing to the inertia of the link.
#[test]
fn a_gear_ratio_changes_only_the_motors_inertia() {
    let mut description = shipped_device("cable-five-bar").description;
    let motor = 5e-5;
    for joint in &mut description.joints[..2] {
        joint.transmission.as_mut().unwrap().motor_inertia = motor;
    }
    let (q, n) = ([2.6, 1.75], [0.94, -0.34]);
    let around = Loop::with_torque_path(&TorquePath::usual(2e4), 2e4, LinearEstimator::Butterworth(500.0));
    let found = sensitivities(&description, &q, &n, Admissible::default(), &around).unwrap();
    let gear = found.iter().find(|one| one.part == "gear ratio of joint 0").unwrap().more.unwrap();
    let model = Linearised::at(&description, &q, &n).unwrap();
    let expected = 1.0 + 0.21 * motor * model.unit_motion[0].powi(2) / model.w_rr();
    assert!((gear.w_rr / expected - 1.0).abs() < 1e-9, "{gear:?} {expected}");
}

/// Solves the equations at rest: the wall's torques twist the cables while a hand holds the tip in the wall.
#[test]
fn a_hand_at_rest_feels_a_wall_in_series_with_its_cables() {
    let text = read("devices/cable-five-bar.toml");
    let text = text.replacen("stiffness = 1280.0", "stiffness = 120.0", 1).replacen("mass = 0.06", "mass = 0.2", 1);
    let folder = Folder::new();
    let device = folder.write("device.toml", &text);
    let options = ["--q=2.6,1.75", "--normal=0.94,-0.34", "--kd", "3", "--washout", "2"];
    let range = json(&[&["range", &device], &options[..]].concat());
    let model = Linearised::at(&DeviceFile::load(&device).unwrap().description, &[2.6, 1.75], &[0.94, -0.34]).unwrap();
    let cables = DMatrix::from_diagonal(&DVector::from_vec(vec![120.0, 1280.0]));
    let shaped = &model.mass * &model.unit_motion / model.w_rr();
    let mut compliances = Vec::new();
    for (mode, torque) in [("off", &model.row), ("washout", &model.row), ("full", &shaped)] {
        let point = &range[mode]["boundary"][0];
        let kp = point["kp"].as_f64().unwrap();
        // The motor angles θ at the joint angles q = E solve K (θ - q) = -kp (Jr θ) torque.
        let motors =
            (&cables + torque * model.row.transpose() * kp).lu().solve(&(&cables * &model.unit_motion)).unwrap();
        let static_stiffness = kp * model.row.dot(&motors);
        assert!(is_close(point["felt"].as_f64().unwrap(), static_stiffness), "{mode}: {point} {static_stiffness}");
        compliances.push(1.0 / static_stiffness - 1.0 / kp);
    }
    assert!(is_close(range["transmissions"].as_f64().unwrap(), 1.0 / compliances[0]));
    assert!((compliances[2] / compliances[0] - 1.0).abs() > 0.05, "{compliances:?}");
    assert_eq!(json(&["range", &shipped_path("haply-2diy.toml"), "--normal=0.6,0.8"]).get("transmissions"), None);
}

#[test]
fn check_predicts_walls_in_the_hand_that_it_names() {
    let folder = Folder::new();
    let device = shipped_path("cable-five-bar.toml");
    let shipped = read("devices/scenes/cable-five-bar/wall.toml");
    let check_wall = |stiffness: f64| {
        let lines = shipped.lines().map(|line| match line.starts_with("stiffness =") {
            true => format!("stiffness = {stiffness:?}"),
            false => line.to_string(),
        });
        let scene = folder.write("scene.toml", lines.collect::<Vec<_>>().join("\n"));
        let report = json(&["check", &device, &scene]);
        (report["scenes"][0]["contacts"][0].clone(), report["warnings"].to_string())
    };
    let (contact, _) = check_wall(1000.0);
    let alone = contact["stable_to"].as_f64().unwrap();
    let limit_in_hand = contact["in_hand"]["stable_to"].as_f64().unwrap();
    let options = contact["options"].as_str().unwrap();
    let mode = if options.contains("--washout") { "washout" } else { "off" };
    let range = predict(&device, &format!("{options} --hand 0.12,6,1200"), mode);
    assert!(is_close(range["boundary"][0]["kp"].as_f64().unwrap(), limit_in_hand), "{range} {limit_in_hand}");
    // With cables the hand reduces the range, so a wall between the two limits buzzes only in the hand.
    assert!(limit_in_hand < 0.95 * alone, "{limit_in_hand} {alone}");
    let (contact, warnings) = check_wall((0.5 * (alone + limit_in_hand)).round());
    let wall = format!("{},{}", contact["stiffness"], options.rsplit(' ').next().unwrap());
    let swings = predict(&device, &format!("{options} --hand 0.12,6,1200 --wall {wall}"), "ripple");
    let swing = &swings["wall"]["swings"][mode];
    assert!(swing["growth_per_s"].as_f64().unwrap() > 0.0, "{swing}");
    for hz in [&contact["hz"], &contact["buzz"]["hz"]] {
        assert!(is_close(hz.as_f64().unwrap(), swing["hz"].as_f64().unwrap()), "{contact} {swing}");
    }
    assert!(warnings.contains("a hand of 0.12 kg, 6 N s/m and 1200 N/m"), "{warnings}");
    // Below both limits the wall is quiet.
    assert!(!check_wall((0.9 * limit_in_hand).round()).1.contains("a hand of"));
}

#[test]
fn the_supply_bounds_the_motors_force() {
    let folder = Folder::new();
    let check_supply = |supply: &str| {
        let supply = format!("{supply}[geometry]");
        let changes = [("resistance = 2.0", "resistance = 15.0"), ("[geometry]", &supply)];
        let path = folder.write_changed("haply-2diy", &changes);
        let report = json(&["check", &path, "devices/scenes/haply-2diy/wall-soft.toml"]);
        let force = report["scenes"][0]["contacts"][0]["force"].as_f64().unwrap();
        let limit = DeviceFile::load(&path).unwrap().description.joints[0].motor.unwrap().max_current;
        (force, report["summary"]["force_at_home"]["low"].as_f64().unwrap(), limit, report["warnings"].to_string())
    };
    // 3 A through 15 ohm need 45 V, more than a simulated board has.
    let unlimited = check_supply("");
    assert!(unlimited.3.contains("the file names no supply"), "{}", unlimited.3);
    let bound = check_supply("supply = 12.0\n");
    let share = 12.0 * 0.92 / 15.0 / 3.0;
    assert!(bound.3.contains("the supply of 12 V"), "{}", bound.3);
    for (bound, unlimited) in [(bound.0, unlimited.0), (bound.1, unlimited.1), (bound.2, unlimited.2)] {
        assert!(is_close(bound, share * unlimited), "{bound} {unlimited} {share}");
    }
    let device = folder.path("haply-2diy.toml");
    let info = json(&["info", "--port", &format!("sim:{device}")]);
    assert!((info["bus_voltage"].as_f64().unwrap() - 12.0).abs() < 1e-3, "{info}");
    // A high supply causes no warning.
    assert!(!check_supply("supply = 56.0\n").3.contains("supply"));
    let device = DeviceFile::load(&device).unwrap();
    let (_, mut board) = common::board(&device, BoardOptions::default());
    let scene = SceneFile::load(shipped_path("scenes/haply-2diy/wall-soft.toml"), 2).unwrap().scene().unwrap();
    board.set_scene(&scene).unwrap();
    board.arm().unwrap();
    // No board supplies 25 A.
    let strong = Motor { torque_constant: -0.1, max_current: 25.0, ..Motor::default() };
    assert_eq!([2, 3].map(|joints| torque_at_rest(&strong, joints)), [2.0, 0.1 * 12.0]);
}

/// Checks several rates, cutoffs and drives, with delays below and above one sample.
#[test]
fn a_passive_wall_is_stable() {
    let mut bounds = 0;
    for device in all_shipped_devices() {
        let spec = device.spec();
        let q = &device.description.home.unwrap()[..spec.joints];
        let normal = &[0.6, 0.8, 0.1][..spec.task];
        for (rate, cutoff) in [(500.0, 40.0), (1e3, 20.0), (5e3, 200.0), (2e4, 300.0), (2e4, 5e3)] {
            for path in [
                TorquePath::usual(rate),
                TorquePath { delay_samples: 0.0, drive: Drive::Ideal },
                TorquePath { delay_samples: 0.5, drive: Drive::Ideal },
                TorquePath { delay_samples: 1.3, drive: Drive::Current { bandwidth_hz: 500.0 } },
            ] {
                let estimator = LinearEstimator::Butterworth(cutoff);
                let prediction = Prediction::new(
                    Subject::new(&device.description).unwrap(),
                    Loop::with_torque_path(&path, rate, estimator),
                );
                let model = prediction.linearise(q, normal).unwrap();
                let Some(passivity) = Passivity::new(&model, &device.description, &prediction.around) else {
                    panic!("{}: encoders sit on the motors", device.name)
                };
                let max_damping = passivity.largest_damping();
                for share in [0.0, 0.3, 0.7] {
                    let passive = passivity.largest_stiffness(share * max_damping);
                    let (stable, _) = stiffness_at(&model, &prediction.around, Mode::Off, share * max_damping).unwrap();
                    let case = format!("{} {path:?} {rate} {cutoff} {share}", device.name);
                    assert!(passive <= stable, "{case}: passive to {passive}, stable to {stable}");
                    bounds += usize::from(passive > 0.0);
                }
                // The passive limit equals the textbook's limit or, because of aliasing, is up to 10 % lower.
                let late = (0.5 + path.delay_samples) / rate
                    + match path.drive {
                        Drive::Current { bandwidth_hz } => 1.0 / (std::f64::consts::TAU * bandwidth_hz),
                        _ => 0.0,
                    };
                let share = passivity.largest_stiffness(0.0) * late / passivity.damping;
                assert!((0.9..1.000001).contains(&share), "{} {path:?} {rate}: {share}", device.name);
            }
        }
    }
    assert!(bounds > 400, "{bounds}");
}

#[test]
fn no_passive_bound_is_named_for_encoders_behind_cables() {
    let folder = Folder::new();
    let at_joint = ("damping = 0.0372", "damping = 0.0372\nencoder_at = \"joint\"");
    // The wall is measured behind the cables, so no cable is in series with it.
    type_lines(
        &format!(
            "range devices/cable-five-bar.toml --normal=0.6,0.8 --rate 5000 => passive without feed-forward
            range {} --normal=0.6,0.8 --rate 5000 => !passive | !felt",
            folder.write_changed("cable-five-bar", &[at_joint])
        ),
        &[],
    );
}

#[test]
fn stable_islands_are_reported_without_a_stable_range() {
    let folder = Folder::new();
    let soft_cable = "stiffness = 40.0\ndamping = 0.0\nencoder_at = \"joint\"";
    let soft_changes = [("stiffness = 1280.0\ndamping = 0.0372", soft_cable), ("viscous = 0.001", "viscous = 0.0")];
    let path = folder.write_changed("cable-five-bar", &soft_changes);
    let command = ["range", &path, "--normal=0.6,0.8", "--rate", "20000", "--cutoff", "500"];
    let range = json(&command);
    for number in [&range["off"]["area"], &range["off"]["kd_max"], &range["full"]["area"], &range["area_ratio"]] {
        assert_eq!(number, 0.0, "{number}");
    }
    let islands = range["off"]["islands"].as_array().unwrap();
    let island = islands.iter().find(|island| island["kd"].as_f64().unwrap() > 0.1);
    let island = island.unwrap_or_else(|| panic!("{islands:?}"));
    assert!(island["kp_low"].as_f64().unwrap() > 1000.0, "{island}");
    let printed = output(&command);
    assert!(printed.contains("Nothing is stable here") && !printed.contains("times as large"), "{printed}");
}

/// Largest stable stiffness of the serial-3r's wall without and with the feed-forward, N/m, from independent
/// eigenvalues at home, for the normal (0.42, -0.91), 5 kHz, a cutoff of 200 Hz, 5 N s/m and a delay of 0.125 samples.
const LIMITS_WITHOUT_POSTURE: [f64; 2] = [29_835.0, 32_234.0];
/// The limits of [`LIMITS_WITHOUT_POSTURE`] with a posture of 0.5 N m/rad and 0.03 N m s/rad, N/m.
const LIMITS_WITH_POSTURE: [f64; 2] = [49_640.0, 32_208.0];

#[test]
fn a_posture_is_part_of_the_loop() {
    let device = shipped_path("serial-3r.toml");
    let of = |posture: &[&str]| {
        let command = ["range", &device, "--normal=0.42,-0.91", "--rate", "5000", "--cutoff", "200", "--kd", "5"];
        let range = json(&[&command[..], &["--delay", "0.125"], posture].concat());
        ["off", "full"].map(|mode| range[mode]["boundary"][0]["kp"].as_f64().unwrap())
    };
    let within = |found: [f64; 2], known: [f64; 2]| (0..2).all(|i| (found[i] - known[i]).abs() < 1.0);
    let (free, posture) = (of(&[]), of(&["--posture", "0.5,0.03"]));
    assert!(within(free, LIMITS_WITHOUT_POSTURE) && within(posture, LIMITS_WITH_POSTURE), "{free:?} {posture:?}");
    // A posture without spring and damper changes nothing.
    let nothing = of(&["--posture", "0,0"]);
    assert!(nothing.iter().zip(free).all(|(nothing, free)| is_close(*nothing, free)), "{nothing:?} {free:?}");
    type_lines("2: range devices/haply-2diy.toml --normal=0,1 --posture 0.5,0.03", &[]);
}

/// The linear prediction leaves out friction, encoder steps, hand and unilateral contact. These change the frequency by
/// at most 13 %: down far above the boundary, where the tip often leaves the wall, and up close to the boundary.
#[test]
fn the_demos_wall_buzzes_at_the_predicted_frequency() {
    for (stiffness, damping) in [(22_000.0, 40.0), (12_000.0, 80.0), (30_000.0, 40.0)] {
        let demo = Demo { stiffness, damping, ..Demo::shipped(1).unwrap() };
        let run = crossing::run(&demo, FeedForward::Off, &mut |_| {}).unwrap();
        let resting: Vec<f64> = run.moments.iter().filter(|m| (0.3..0.8).contains(&m.time)).map(|m| m.force).collect();
        let mean = resting.iter().sum::<f64>() / resting.len() as f64;
        let upward: Vec<usize> = (1..resting.len()).filter(|i| resting[i - 1] < mean && resting[*i] >= mean).collect();
        let measured = demo.rate_hz * (upward.len() - 1) as f64 / (upward[upward.len() - 1] - upward[0]) as f64;
        let around =
            Loop::with_torque_path(&TorquePath::usual(demo.rate_hz), demo.rate_hz, LinearEstimator::Butterworth(100.0));
        let prediction = Prediction::new(Subject::new(&demo.file.description).unwrap(), around);
        let wall = Member::new(demo.normal.to_vec(), 1.0);
        let walls = [wall];
        let buzz = |mode| prediction.buzz(demo.q(), &walls, mode, stiffness, damping).unwrap().unwrap();
        let (off, washout) = (buzz(Mode::Off), buzz(Mode::Washout(demo.washout_hz)));
        assert!(off.growth_per_s > washout.growth_per_s && off.growth_per_s > 0.0, "{off:?} {washout:?}");
        assert!((measured / off.hz - 1.0).abs() < 0.13, "{stiffness} N/m: {measured} Hz, not {} Hz", off.hz);
    }
}

#[test]
fn all_commands_warn_of_degrees_and_of_poses_beyond_limits() {
    let folder = Folder::new();
    let rigid = "transmission = \"rigid\"";
    let with = |limits: &str| folder.write_changed("haply-2diy", &[(rigid, &format!("{rigid}\nlimits = {limits}"))]);
    let degrees = with("[-180.0, 180.0]");
    for command in ["model", "range", "map", "design"] {
        let points = ["--points", "100"];
        let more = if ["map", "design"].contains(&command) { &points[..] } else { &[] };
        let (code, out, err) = run(&[&[command, &degrees, "--normal=0,1", "--json"], more].concat());
        assert_eq!(code, 0, "{command}: {err}");
        let document: Value = serde_json::from_str(&out).unwrap();
        let text = document["warnings"][0]["text"].as_str().unwrap_or_else(|| panic!("{command}"));
        assert!(text.contains("angles are in radians") && err.contains(text), "{command}: {text}");
    }
    // Limits wider than a turn do not change the map.
    let mapped = |device: &str| json(&["map", device, "--normal=0,1"])["points"].clone();
    assert_eq!(mapped(&degrees), mapped(&shipped_path("haply-2diy.toml")));
    let narrow_range = with("[0.5, 2.5]");
    for command in ["model", "range"] {
        let document = json(&[command, &narrow_range, "--q=2.3,0.2", "--normal=0,1"]);
        let text = document["warnings"][0]["text"].as_str().unwrap_or_else(|| panic!("{command}"));
        assert!(text.contains("outside its limits [0.5, 2.5]"), "{command}: {text}");
        assert_eq!(document["q"], serde_json::json!([2.3, 0.2]));
        assert_eq!(document["normals"], serde_json::json!([[0.0, 1.0]]));
    }
}
