//! `--read` reads the same scene bit for bit, the board's values of a device, and their differences from a file.
#![cfg(unix)]

use crate::common::prelude::*;
use crate::common::sim::Sim;
use crate::common::{all_shipped_devices, shipped_path, toml_files};
use haptic_host::read_back::{device_entries, differences, scene, to_toml};
use predicates::prelude::*;
use predicates::str::contains;

#[test]
fn every_shipped_scene_is_read_back_bit_for_bit() {
    let mut normals = Random::new(7);
    let mut count = 0;
    for device in all_shipped_devices() {
        let task = device.spec().task;
        let name = device.path.file_stem().unwrap().to_string_lossy().into_owned();
        for path in toml_files(&format!("scenes/{name}")) {
            let mut scene_of = SceneFile::load(&path, task).unwrap().scene;
            for turned in [false, true] {
                if let (true, Some(wall)) = (turned && task > 1, scene_of.walls.first_mut())
                    && let Surface::Plane(plane) = &mut wall.surface
                {
                    let at: Vec<f64> = (0..task).map(|_| normals.uniform() - 0.5).collect();
                    plane.normal = haptic_host::vectors::padded(&haptic_host::vectors::unit(&at).unwrap());
                }
                let sent: Scene<f32> = scene_of.cast();
                let text = to_toml(&[], &scene(&sent));
                let second_scene = SceneFile::parse(&text, "read back", task).unwrap().scene::<f32>().unwrap();
                assert_eq!(second_scene, sent, "{}\n{text}", path.display());
                count += 1;
            }
        }
    }
    assert!(count > 10, "{count}");
}

#[test]
fn differences_are_listed_by_key_with_units() {
    let [a, b] = [0.012, 0.013].map(|mass| {
        let mut file = DeviceFile::parse(haptic_sim::SHIPPED_DEVICE, "a").unwrap();
        file.description.handle_mass = mass;
        file.description.joints[1].viscous = mass;
        device_entries(&file.device().unwrap())
    });
    let lines: Vec<String> = differences(&a, &b).iter().map(ToString::to_string).collect();
    assert!(differences(&a, &a).is_empty());
    assert!(lines.contains(&"[[joint]] 1 viscous: 0.012 -> 0.013 N m s/rad".to_string()), "{lines:#?}");
    assert!(lines.iter().any(|line| line.starts_with("lumped tip_mass: ") && line.ends_with(" kg")), "{lines:#?}");
    assert_eq!(lines.len(), 3, "{lines:#?}");
}

#[test]
fn a_board_is_read_into_files_and_compared_with_them() {
    let sim = Sim::start(&["--fast"]);
    let (device, wall) = (shipped_path("coupled-five-bar.toml"), shipped_path("scenes/coupled-five-bar/wall.toml"));
    sim.run(&["scene", "--read"]).code(1).stderr(contains("no scene"));
    sim.run(&["device"]).code(2);
    sim.run(&["device", &device]).success();
    sim.run(&["scene", &wall]).success();
    sim.run(&["device", "--read", &device]).success().stdout(contains("the board's device is the same as in"));
    sim.run(&["scene", "--read", &wall]).success();
    let folder = tempfile::tempdir().unwrap();
    let [device, scene] = ["d.toml", "s.toml"].map(|name| folder.path().join(name).display().to_string());
    for (what, path) in [("device", &device), ("scene", &scene)] {
        sim.run(&[what, "--read", "-o", path]).success();
        sim.run(&[what, "--read", "-o", path]).code(1).stderr(contains("--force"));
    }
    let text: toml::Table = std::fs::read_to_string(&device).unwrap().parse().unwrap();
    assert!(text["lumped"]["tip_mass"].is_float(), "{text:?}");
    sim.run(&["device", &device]).code(2).stderr(contains("lumped"));
    sim.run(&["scene", &scene]).success();
    sim.run(&["scene", "--read", &scene]).success();
    sim.run(&["gains", "--stiffness", "321"]).success();
    let difference = contains("[[wall]] 0 stiffness: ").and(contains(" -> 321.0 N/m\n"));
    sim.run(&["scene", "--read", &scene]).code(3).stdout(difference).stderr(contains("1 difference"));
    let json = sim.run(&["scene", "--read", &scene, "--json"]).code(3);
    let json: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!(json["differences"][0]["to"], 321.0);
    assert!(json["differences"][1].is_null(), "{json}");
}

#[test]
fn a_report_checks_the_board_and_contains_nothing_private() {
    let sim = Sim::start(&["--fast"]);
    sim.run(&["device", &shipped_path("coupled-five-bar.toml")]).success();
    sim.run(&["scene", &shipped_path("scenes/coupled-five-bar/wall.toml")]).success();
    sim.run(&["board", "name", "ada-lovelaces-desk"]).success();
    let assert = sim.run(&["board", "report"]).success();
    let page = String::from_utf8_lossy(&assert.get_output().stdout).into_owned();
    for part in ["encoder 0", "encoder 1", "current 0", "current 1", "bus", "flash", "timing", "link", "fault"] {
        assert!(page.contains(&format!("| {part} | OK |")), "{part}\n{page}");
    }
    assert!(page.contains("protocol ") && page.contains("[[wall]]") && page.contains("torque_constant"), "{page}");
    for private in ["SIM0001", "ada-lovelace", "coupled-five-bar", "tcp:", "127.0.0.1", "/home", ".toml"] {
        assert!(!page.contains(private), "{private}\n{page}");
    }
    sim.run(&["arm"]).success();
    sim.run(&["board", "report"]).code(1).stderr(contains("disarm"));
}
