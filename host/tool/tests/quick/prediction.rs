//! One prediction, whoever asks: every line that a command prints "to predict the same" predicts the same, and nothing
//! is called passive or stable that is not.

use crate::common::{self, all_shipped, file, json, shipped};
use haptic_bridge::render::scene::FeedForward;
use haptic_show::demo::{Demo, crossing};
use haptic_stability::analysis::control_loop::{Loop, Mode, TorquePath};
use haptic_stability::analysis::passivity::Passivity;
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::stiffness_at;
use haptic_stability::analysis::sampled::LinearEstimator;
use haptic_stability::analysis::several::Member;
use serde_json::Value;

/// With cables, rigid, and redundant.
const DEVICES: [&str; 3] = ["cable-five-bar", "haply-2diy", "serial-3r"];

fn close(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-6 * expected.abs()
}

/// A wall's stiffness as `haptic range DEVICE` predicts it with these options.
fn typed(device: &str, options: &str, feed_forward: &str) -> Value {
    let words: Vec<&str> = options.split(' ').collect();
    json(&[&["range", device], &words[..]].concat())[feed_forward].clone()
}

#[test]
fn what_check_names_to_predict_the_same_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let mut lines = 0;
    for name in DEVICES {
        let device = file(&format!("{name}.toml"));
        let shipped = std::fs::read_to_string(common::files(&format!("scenes/{name}")).last().unwrap()).unwrap();
        let place: Vec<&str> = shipped
            .lines()
            .filter(|line| line.starts_with("point =") || line.starts_with("normal ="))
            .take(2)
            .collect();
        let wall = format!("[[wall]]\n{}\nstiffness = 500.0\ndamping = 2.5\n", place.join("\n"));
        let held = "[posture]\norientation = 2.3\nstiffness = 0.5\ndamping = 0.03\n";
        let posture = if name == "serial-3r" { held } else { "" };
        let compensation = if name == "cable-five-bar" { "" } else { "damping_compensation = true\n" };
        for (feed_forward, law) in [
            ("off", "rate_hz = 5000\ncutoff_hz = 300\n"),
            ("full", "estimator = \"difference\"\ndifference_over = 4\n"),
            ("washout", "admissible = \"consistent\"\nestimator = \"predicted\"\nrate_hz = 20000\ncutoff_hz = 250\n"),
        ] {
            let scene = format!("{law}{wall}feed_forward = \"{feed_forward}\"\n{compensation}{posture}");
            std::fs::write(&path, &scene).unwrap();
            let checked = json(&["check", &device, path.to_str().unwrap()]);
            let contact = &checked["scenes"][0]["contacts"][0];
            let options = contact["options"].as_str().unwrap_or_else(|| panic!("{name}\n{scene}\n{checked}"));
            let found = typed(&device, options, feed_forward);
            let (kp, stable_to) = (&found["boundary"][0]["kp"], contact["stable_to"].as_f64().unwrap());
            assert!(stable_to > 0.0 && close(kp.as_f64().unwrap(), stable_to), "{name} {options}: {kp} {stable_to}");
            assert!(close(found["kd_max"].as_f64().unwrap(), contact["damping_to"].as_f64().unwrap()), "{options}");
            assert_eq!(found["boundary"][0].get("felt").is_some(), name == "cable-five-bar");
            assert_eq!(found["boundary"][0].get("felt"), contact.get("felt_to"), "{options}");
            lines += 1;
        }
    }
    assert_eq!(lines, 9);
}

#[test]
fn what_range_and_measure_range_name_to_predict_the_same_does() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["cable-five-bar", "haply-2diy"] {
        let device = file(&format!("{name}.toml"));
        let asked = ["--normal=0.6,0.8", "--hand", "0.1,2,300", "--washout", "2", "--kd", "3,1", "--rate", "5000"];
        let range = json(&[&["range", &device, "--board", "odrive-v3", "--cutoff", "150"], &asked[..]].concat());
        let again = range["options"].as_str().unwrap().split(' ').collect::<Vec<_>>();
        let again = json(&[&["range", &device], &again[..]].concat());
        assert_eq!((again["rate_hz"].as_f64(), again["drive"].as_str()), (Some(5000.0), Some("current")));
        for mode in ["off", "full", "washout"] {
            for (number, kp) in [("kd_max", None), ("area", None), ("boundary", Some(0)), ("boundary", Some(1))] {
                let of = |range: &Value| match kp {
                    Some(point) => range[mode][number][point]["kp"].as_f64().unwrap(),
                    None => range[mode][number].as_f64().unwrap(),
                };
                assert!(close(of(&again), of(&range)), "{name} {mode} {number}");
            }
        }

        // A point that was measured already: its theory is printed, and no motor moves.
        let progress = folder.path().join(format!("{name}.json"));
        let point = r#"{"mode": "off", "kd": 2.0, "repeats": [3000.0], "vibration_m": null, "open": null}"#;
        let what = "along (0.6, 0.8) at 1000 Hz, cutoff 100 Hz, washout 2 Hz, pull 0.5 mm, 1 N m, friction: none";
        let known = format!(
            "{{\"what\": \"{name} {what}\", \"ends\": [], \"open_ends\": [], \"q\": [], \"points\": [{point}], \"date\": null}}"
        );
        std::fs::write(&progress, known).unwrap();
        let world = ["--port", "sim", "--friction", "none", "--rate", "1000", "--cutoff", "100"];
        let once = ["--repeats", "1", "--kd", "2", "--feed-forward", "off", "--yes"];
        let kept = ["--normal=0.6,0.8", "--progress", progress.to_str().unwrap()];
        let measured = json(&[&["measure-range", &device], &world[..], &once, &kept].concat());
        let point = &measured["points"][0];
        let line = measured["theory"].as_str().unwrap();
        let (_, options) = line.split_once(".toml ").unwrap();
        let theory = typed(&device, options, "off")["boundary"][0]["kp"].as_f64().unwrap();
        assert!(close(theory, point["theory_kp"].as_f64().unwrap()), "{name} {line}: {theory} {point}");
        match point.get("felt") {
            Some(felt) => assert!(
                name == "cable-five-bar"
                    && close(felt.as_f64().unwrap(), {
                        let cables = range["transmissions"].as_f64().unwrap();
                        1.0 / (1.0 / 3000.0 + 1.0 / cables)
                    })
            ),
            None => assert_eq!(name, "haply-2diy"),
        }
    }
}

#[test]
fn a_hand_feels_a_wall_and_its_cables_in_series() {
    let device = file("cable-five-bar.toml");
    let range = json(&["range", &device, "--normal=0.6,0.8", "--kd", "3"]);
    let seen = Prediction::new(
        Subject::new(&shipped("cable-five-bar").description).unwrap(),
        Loop::through(&TorquePath::usual(1e3), 1e3, LinearEstimator::BackwardDifference),
    );
    let home = shipped("cable-five-bar").description.home.unwrap();
    let row = seen.seen(&home[..2], &[0.6, 0.8]).unwrap().row;
    // A force f along n turns each joint's cable by rowⱼ f/k.
    let compliance: f64 = row.iter().map(|lever| lever * lever / 1280.0).sum();
    assert!(close(range["transmissions"].as_f64().unwrap(), 1.0 / compliance));
    let point = &range["off"]["boundary"][0];
    let kp = point["kp"].as_f64().unwrap();
    assert!(close(point["felt"].as_f64().unwrap(), 1.0 / (1.0 / kp + compliance)));
    let said = common::haptic(&["range", &device, "--normal=0.6,0.8"]).output().unwrap();
    let said = String::from_utf8(said.stdout).unwrap();
    assert!(said.contains("felt N/m") && said.contains("stiffness of the transmissions at the tip"), "{said}");
    assert_eq!(json(&["range", &file("haply-2diy.toml"), "--normal=0.6,0.8"]).get("transmissions"), None);
}

/// Every estimator with a bound, every drive of a board, delays within a sample and beyond.
#[test]
fn a_passive_wall_is_stable() {
    let mut bounds = 0;
    for device in all_shipped() {
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
                let prediction =
                    Prediction::new(Subject::new(&device.description).unwrap(), Loop::through(&path, rate, estimator));
                let seen = prediction.seen(q, normal).unwrap();
                let Some(passivity) = Passivity::new(&seen, &device.description, &prediction.around) else {
                    panic!("{}: encoders sit on the motors", device.name)
                };
                let most = passivity.most_damping();
                for share in [0.0, 0.3, 0.7] {
                    let passive = passivity.sampled(share * most);
                    let (stable, _) = stiffness_at(&seen, &prediction.around, Mode::Off, share * most).unwrap();
                    let case = format!("{} {path:?} {rate} {cutoff} {share}", device.name);
                    assert!(passive <= stable, "{case}: passive to {passive}, stable to {stable}");
                    bounds += usize::from(passive > 0.0);
                }
                // What makes it passive is what the textbook says, less what aliases take.
                let late = (0.5 + path.delay_samples) / rate
                    + match path.drive {
                        Drive::Current { bandwidth_hz } => 1.0 / (std::f64::consts::TAU * bandwidth_hz),
                        _ => 0.0,
                    };
                let share = passivity.sampled(0.0) * late / passivity.damping;
                assert!((0.9..1.000001).contains(&share), "{} {path:?} {rate}: {share}", device.name);
            }
        }
    }
    assert!(bounds > 400, "{bounds}");
}

#[test]
fn no_passive_bound_is_named_where_the_encoder_sits_behind_a_cable() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("joint.toml");
    let text = std::fs::read_to_string(file("cable-five-bar.toml")).unwrap();
    std::fs::write(&path, text.replace("damping = 0.0372", "damping = 0.0372\nencoder_at = \"joint\"")).unwrap();
    let said = |device: &str| {
        let said = common::haptic(&["range", device, "--normal=0.6,0.8", "--rate", "5000"]).output().unwrap();
        String::from_utf8(said.stdout).unwrap()
    };
    assert!(said(&file("cable-five-bar.toml")).contains("passive without feed-forward"));
    let behind = said(path.to_str().unwrap());
    assert!(!behind.contains("passive"), "{behind}");
    // What the wall measures behind its cables it renders there: nothing is in series.
    assert!(!behind.contains("felt"), "{behind}");
}

#[test]
fn where_nothing_is_stable_area_and_ratio_are_zero_and_islands_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("joint.toml");
    let text = std::fs::read_to_string(file("cable-five-bar.toml")).unwrap();
    let soft = "stiffness = 40.0\ndamping = 0.0\nencoder_at = \"joint\"";
    let text = text.replace("stiffness = 1280.0\ndamping = 0.0372", soft).replace("viscous = 0.001", "viscous = 0.0");
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap();
    let asked = ["range", path, "--normal=0.6,0.8", "--rate", "20000", "--cutoff", "500"];
    let range = json(&asked);
    for number in [&range["off"]["area"], &range["off"]["kd_max"], &range["full"]["area"], &range["area_ratio"]] {
        assert_eq!(number, 0.0, "{number}");
    }
    let islands = range["off"]["islands"].as_array().unwrap();
    let island = islands.iter().find(|island| island["kd"].as_f64().unwrap() > 0.1);
    let island = island.unwrap_or_else(|| panic!("{islands:?}"));
    assert!(island["kp_low"].as_f64().unwrap() > 1000.0, "{island}");
    let said = String::from_utf8(common::haptic(&asked).output().unwrap().stdout).unwrap();
    assert!(said.contains("Nothing is stable here") && !said.contains("times as large"), "{said}");
}

/// Computed apart, by eigenvalues of the arm's own equations: at home along wall-held.toml's normal at 5 kHz, 200 Hz and 5
/// N s/m, half a carrier period late, N/m.
const WITHOUT_POSTURE: [f64; 2] = [29_835.0, 32_234.0];
const IN_POSTURE: [f64; 2] = [49_640.0, 32_208.0];

#[test]
fn a_posture_is_part_of_the_loop() {
    let device = file("serial-3r.toml");
    let of = |posture: &[&str]| {
        let asked = ["range", &device, "--normal=0.42,-0.91", "--rate", "5000", "--cutoff", "200", "--kd", "5"];
        let range = json(&[&asked[..], &["--delay", "0.125"], posture].concat());
        ["off", "full"].map(|mode| range[mode]["boundary"][0]["kp"].as_f64().unwrap())
    };
    let within =
        |found: [f64; 2], known: [f64; 2]| found.iter().zip(known).all(|(found, known)| (found - known).abs() < 1.0);
    let (free, held) = (of(&[]), of(&["--posture", "0.5,0.03"]));
    assert!(within(free, WITHOUT_POSTURE) && within(held, IN_POSTURE), "{free:?} {held:?}");
    // No spring and no damper hold nothing.
    let nothing = of(&["--posture", "0,0"]);
    assert!(nothing.iter().zip(free).all(|(nothing, free)| close(*nothing, free)), "{nothing:?} {free:?}");
    let refused = ["range", &file("haply-2diy.toml"), "--normal=0,1", "--posture", "0.5,0.03"];
    common::haptic(&refused).assert().code(2);
}

/// Friction, encoder steps, a hand, and a wall that only pushes: what the linear prediction leaves out moves the buzz by
/// 13 % at most: down far above the boundary, where the tip leaves the wall for much of a turn, and up close to it.
#[test]
fn the_wall_of_the_demo_buzzes_at_the_predicted_frequency() {
    for (stiffness, damping) in [(22_000.0, 40.0), (12_000.0, 80.0), (30_000.0, 40.0)] {
        let demo = Demo { stiffness, damping, ..Demo::shipped(1).unwrap() };
        let run = crossing::run(&demo, FeedForward::Off, &mut |_| {}).unwrap();
        let resting: Vec<f64> = run.moments.iter().filter(|m| (0.3..0.8).contains(&m.time)).map(|m| m.force).collect();
        let mean = resting.iter().sum::<f64>() / resting.len() as f64;
        let upward: Vec<usize> = (1..resting.len()).filter(|i| resting[i - 1] < mean && resting[*i] >= mean).collect();
        let measured = demo.rate_hz * (upward.len() - 1) as f64 / (upward[upward.len() - 1] - upward[0]) as f64;
        let around = Loop::through(&TorquePath::usual(demo.rate_hz), demo.rate_hz, LinearEstimator::Butterworth(100.0));
        let prediction = Prediction::new(Subject::new(&demo.file.description).unwrap(), around);
        let wall = Member::new(demo.normal.to_vec(), 1.0);
        let buzz =
            |mode| prediction.buzz(demo.q(), std::slice::from_ref(&wall), mode, stiffness, damping).unwrap().unwrap();
        let (off, washout) = (buzz(Mode::Off), buzz(Mode::Washout(demo.washout_hz)));
        assert!(off.growth_per_s > washout.growth_per_s && off.growth_per_s > 0.0, "{off:?} {washout:?}");
        assert!((measured / off.hz - 1.0).abs() < 0.13, "{stiffness} N/m buzzes at {measured} Hz and not {}", off.hz);
    }
}

#[test]
fn degrees_and_poses_that_are_never_taken_are_doubted_by_whoever_reads_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("device.toml");
    let text = std::fs::read_to_string(file("haply-2diy.toml")).unwrap();
    let with = |limits: &str| {
        let limited = text.replace("transmission = \"rigid\"", &format!("transmission = \"rigid\"\nlimits = {limits}"));
        std::fs::write(&path, limited).unwrap();
        path.to_str().unwrap().to_string()
    };
    let degrees = with("[-180.0, 180.0]");
    for command in ["model", "range", "map", "design"] {
        let points = ["--points", "100"];
        let more = if ["map", "design"].contains(&command) { &points[..] } else { &[] };
        let said = common::haptic(&[&[command, &degrees, "--normal=0,1", "--json"], more].concat()).output().unwrap();
        assert!(said.status.success(), "{command}");
        let document: Value = serde_json::from_slice(&said.stdout).unwrap();
        let text = document["warnings"][0]["text"].as_str().unwrap_or_else(|| panic!("{command}"));
        assert!(text.contains("angles are in radians"), "{command}: {text}");
        assert!(String::from_utf8(said.stderr).unwrap().contains(text), "{command}");
    }
    // Two turns are as good as no limits.
    let mapped = |device: &str| json(&["map", device, "--normal=0,1"])["points"].clone();
    assert_eq!(mapped(&degrees), mapped(&file("haply-2diy.toml")));
    let narrow = with("[0.5, 2.5]");
    for command in ["model", "range"] {
        let document = json(&[command, &narrow, "--q=2.3,0.2", "--normal=0,1"]);
        let text = document["warnings"][0]["text"].as_str().unwrap_or_else(|| panic!("{command}"));
        assert!(text.contains("outside its limits [0.5, 2.5]"), "{command}: {text}");
        assert_eq!(document["q"], serde_json::json!([2.3, 0.2]));
        assert_eq!(document["normals"], serde_json::json!([[0.0, 1.0]]));
    }
}
