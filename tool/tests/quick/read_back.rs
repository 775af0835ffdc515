//! Device and scene are read back from a board to the bit; differences from a file are listed.
#![cfg(unix)]

use crate::common::prelude::*;
use crate::common::sim::Sim;
use crate::common::{Folder, SCENES, all_shipped, files, shipped};
use haptic_host::read_back::{differences, running, scene, to_toml};
use haptic_predict::equivalent::device_file;

fn read(text: &str) -> Device<f32> {
    DeviceFile::parse(text, "read back").unwrap().device().unwrap()
}

#[test]
fn every_shipped_device_is_read_back_to_the_bit() {
    for file in all_shipped() {
        let device = file.device::<f32>().unwrap();
        let alone = device_file(&device, None).unwrap_or_else(|| panic!("{}", file.name));
        assert_eq!(read(&alone), device, "{}", file.name);
        // With its own file as a hint, everything that the board keeps is the same.
        let near = device_file(&device, Some(&file.description)).unwrap();
        let found = DeviceFile::parse(&near, "near").unwrap().description;
        assert_eq!((found.links, found.geometry), (file.description.links, file.description.geometry), "{}", file.name);
        assert_eq!((found.handle_mass, found.gravity), (file.description.handle_mass, file.description.gravity));
    }
}

#[test]
fn devices_with_odd_numbers_are_read_back_to_the_bit() {
    let mut random = Random::new(38);
    let mut odd = |value: &mut f64| *value *= 1.0 + 0.3 * random.uniform();
    let (mut tried, mut found) = (0, 0);
    for file in all_shipped() {
        let mut description = file.description;
        for link in &mut description.links {
            [&mut link.mass, &mut link.com, &mut link.inertia].into_iter().for_each(&mut odd);
        }
        description.joints.iter_mut().for_each(|joint| odd(&mut joint.inertia));
        let Ok(device) = Device::<f32>::new("odd", &description) else { continue };
        tried += 1;
        found += u32::from(device_file(&device, None).is_some_and(|text| read(&text) == device));
    }
    assert!(tried > 5 && found == tried, "{found} of {tried}");
}

#[test]
fn every_shipped_scene_is_read_back_to_the_bit() {
    let mut normals = Random::new(7);
    let mut count = 0;
    for device in all_shipped() {
        let task = device.spec().task;
        let name = device.path.file_stem().unwrap().to_string_lossy().into_owned();
        for path in files(&format!("scenes/{name}")) {
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
                let again = SceneFile::parse(&text, "read back", task).unwrap().scene::<f32>().unwrap();
                assert_eq!(again, sent, "{}\n{text}", path.display());
                count += 1;
            }
        }
    }
    assert!(count > 10, "{count}");
}

#[test]
fn differences_are_listed_by_key_with_units() {
    let [a, b] = [0.012, 0.013].map(|mass| {
        let mut file = shipped("coupled-five-bar");
        file.description.handle_mass = mass;
        file.description.joints[1].viscous = mass;
        running(&file.device().unwrap())
    });
    let told: Vec<String> = differences(&a, &b).iter().map(ToString::to_string).collect();
    assert!(differences(&a, &a).is_empty());
    assert!(told.contains(&"[[joint]] 1 viscous: 0.012 -> 0.013 N m s/rad".to_string()), "{told:#?}");
    assert!(told.iter().any(|line| line.starts_with("lumped tip_mass: ") && line.ends_with(" kg")), "{told:#?}");
    assert_eq!(told.len(), 3, "{told:#?}");
}

#[test]
fn a_board_is_read_into_files_and_compared_with_them() {
    let (sim, folder) = (Sim::start(&["--fast"]), Folder::new());
    let (device, wall) = ("devices/coupled-five-bar.toml", format!("{SCENES}/wall.toml"));
    let (d, s) = (folder.path("d.toml"), folder.path("s.toml"));
    sim.type_lines(&format!(
        "1: scene --read => no scene
        2: device
        device {device}
        scene {wall}
        device --read {device} => the board's device is the same as in
        scene --read {wall}"
    ));
    for (what, path) in [("device", &d), ("scene", &s)] {
        sim.type_lines(&format!(
            "{what} --read -o {path}
            1: {what} --read -o {path} => --force
            {what} {path}
            {what} --read {path}"
        ));
    }
    sim.type_lines(&format!(
        "gains --stiffness 321
        3: scene --read {s} => [[wall]] 0 stiffness:  |  -> 321.0 N/m | 1 difference
        3: scene --read {s} --json => \"to\":321.0"
    ));
}

#[test]
fn a_report_checks_the_board_and_contains_nothing_private() {
    let sim = Sim::start(&["--fast"]);
    sim.type_lines(&format!(
        "device devices/coupled-five-bar.toml
        scene {SCENES}/wall.toml
        board name ada-lovelaces-desk"
    ));
    let page = sim.output(&["board", "report"]);
    for part in ["encoder 0", "encoder 1", "current 0", "current 1", "bus", "flash", "timing", "link", "fault"] {
        assert!(page.contains(&format!("| {part} | OK |")), "{part}\n{page}");
    }
    assert!(page.contains("protocol ") && page.contains("[[wall]]") && page.contains("torque_constant"), "{page}");
    for private in ["SIM0001", "ada-lovelace", "coupled-five-bar", "tcp:", "127.0.0.1", "/home", ".toml"] {
        assert!(!page.contains(private), "{private}\n{page}");
    }
    sim.type_lines("arm\n1: board report => disarm");
}
