//! Devices with weight on a strict simulated board. The user holds the device until the motors carry the weight.

use crate::common::prelude::*;
use crate::common::{board, shipped_device, toml_files};
use haptic_bridge::control::ARM_SECONDS;
use haptic_bridge::model::catalogue::Kind;
use haptic_predict::template;
use std::time::Duration;

/// Loads the shipped scenes of a device.
fn scenes(name: &str, task: usize) -> Vec<SceneFile> {
    toml_files(&format!("scenes/{name}")).into_iter().map(|path| SceneFile::load(&path, task).unwrap()).collect()
}

/// Returns a strict board with this device, which the user holds. Adds joint limits and verified motors to the file.
fn strict_board(mut file: DeviceFile) -> (SharedBoard, Board) {
    let home = file.description.home.unwrap();
    for (joint, home) in file.description.joints.iter_mut().zip(home) {
        joint.motor.iter_mut().for_each(|motor| motor.verified = true);
        joint.limits.get_or_insert((home - 1.0, home + 1.0));
    }
    let options = BoardOptions { strict: true, support: Support::Held, ..BoardOptions::default() };
    let (shared, mut board) = board(&file, options);
    let rules = board.rules().unwrap();
    board.set_rules(&Rules { host_action: HostAction::Ignore, ..rules }).unwrap();
    (shared, board)
}

/// Like [`strict_board`], homed and with the polarity checked.
fn board_ready_to_arm(file: DeviceFile) -> (SharedBoard, Board) {
    let (name, home) = (file.name.clone(), file.description.home.unwrap());
    let (shared, mut board) = strict_board(file);
    board.home().unwrap();
    board.check_polarity().unwrap();
    shared.lock().run(30.0);
    assert!(board.status().unwrap().polarity, "{name}: {:?}", board.status());
    assert_eq!(shared.lock().device().q(), home, "{name} did not return home");
    (shared, board)
}

#[test]
fn homing_after_a_polarity_check_waits_for_the_device() {
    let file = DeviceFile::parse(&template::device_file(Kind::FiveBar, "mine"), "mine.toml").unwrap();
    let home = file.description.home.unwrap();
    let (shared, mut board) = strict_board(file);
    board.home_at_rest().unwrap();
    board.check_polarity().unwrap();
    assert!(board.wait_for_polarity().unwrap().require_pass().is_ok());
    board.home_at_rest().unwrap();
    assert_eq!(shared.lock().device().q(), home);
    board.rows(Duration::from_millis(20)).unwrap();
    let q = board.status().unwrap().q;
    assert!((f64::from(q[0]) - home[0]).abs() < 1e-3 && (f64::from(q[1]) - home[1]).abs() < 1e-3, "{q:?}");
}

/// Arms the board and checks that the device stays in place during the torque ramp and for 2 s after it.
fn assert_stays_while_armed(shared: &SharedBoard, board: &mut Board, what: &str) {
    let before = shared.lock().device().q();
    board.arm().unwrap_or_else(|error| panic!("{what}: {error}"));
    shared.lock().run(0.98 * f64::from(ARM_SECONDS));
    assert_eq!(shared.lock().device().q(), before, "{what} moved while the torque ramps up");
    shared.lock().run(2.0);
    let status = board.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Armed, None), "{what}");
    let q = shared.lock().device().q();
    let largest_motion = q.iter().zip(before).map(|(q, before)| (q - before).abs()).fold(0.0, f64::max);
    // The motors carry the weight, but a spring of the scene may pull the device a little.
    assert!(largest_motion < 0.1, "{what} moved by {largest_motion} rad");
}

#[test]
fn scenes_of_devices_with_weight_run_on_a_strict_board() {
    for name in ["phantom-premium-1.5", "serial-3r", "woodenhaptics", "fictive-five-bar-turret"] {
        let file = shipped_device(name);
        for scene in scenes(name, file.spec().task) {
            let (shared, mut board) = board_ready_to_arm(file.clone());
            let what = scene.path.display().to_string();
            board.set_scene(&scene.scene::<f32>().unwrap()).unwrap();
            assert_stays_while_armed(&shared, &mut board, &what);
        }
    }
}

#[test]
fn every_template_runs_on_a_strict_board_without_falling() {
    for kind in Kind::ALL {
        let file = DeviceFile::parse(&template::device_file(*kind, "mine"), "mine.toml").unwrap();
        let task = file.spec().task as u8;
        let (shared, mut board) = board_ready_to_arm(file);
        // Homing again must succeed in the same pose.
        board.home().unwrap();
        board.set_scene(&Scene { task, ..Scene::default() }).unwrap();
        assert_stays_while_armed(&shared, &mut board, kind.spec().name);
    }
}

#[test]
fn a_carried_device_stays_in_place_until_and_while_armed() {
    let file = shipped_device("woodenhaptics");
    let room = SceneFile::load(crate::common::shipped_path("scenes/woodenhaptics/room.toml"), 3).unwrap();
    let (shared, mut board) = board(&file, BoardOptions { support: Support::Carried, ..BoardOptions::default() });
    board.set_scene(&room.scene::<f32>().unwrap()).unwrap();
    shared.lock().run(2.0);
    assert_stays_while_armed(&shared, &mut board, "woodenhaptics in a room");
}

#[test]
fn a_device_with_weight_is_held_until_the_board_is_armed() {
    for name in ["phantom-premium-1.5", "serial-3r", "woodenhaptics", "fictive-five-bar-turret"] {
        let file = shipped_device(name);
        let (home, task) = (file.description.home.unwrap(), file.spec().task as u8);
        let (shared, mut board) = strict_board(file);
        board.set_scene(&Scene { task, ..Scene::default() }).unwrap();
        shared.lock().run(2.0);
        assert_eq!(shared.lock().device().q(), home, "{name} is held");
        board.home().unwrap();
        board.check_polarity().unwrap();
        shared.lock().run(30.0);
        let status = board.status().unwrap();
        assert!(status.polarity, "{name}: {status:?}");
        let still = shared.lock().device().q();
        shared.lock().run(1.0);
        assert_eq!(shared.lock().device().q(), still, "{name} is not held after the check");
        board.arm().unwrap();
        shared.lock().run(0.6);
        board.disarm().unwrap();
        shared.lock().run(0.2);
        let fallen =
            shared.lock().device().q().iter().zip(still).map(|(q, still)| (q - still).abs()).fold(0.0, f64::max);
        assert!(fallen > 1e-3, "{name} does not fall after disarming: {fallen} rad");
        // The device falls freely. A turret folds through itself and jams, so check that the angles stay finite.
        shared.lock().run(1.0);
        let q = shared.lock().device().q();
        assert!(q.iter().all(|q| q.is_finite()), "{name}: {q:?}");
        // After a restart the user holds the device at home again.
        board.restart().unwrap();
        shared.lock().run(1.0);
        assert_eq!(shared.lock().device().q(), home, "{name} is held");
        assert_eq!(board.status().unwrap().fault, None, "{name}");
    }
}
