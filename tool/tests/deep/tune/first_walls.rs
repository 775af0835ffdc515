//! The wall of `haptic new scene` does not rattle under a hand, for every shipped device and twenty random devices.

use crate::common::prelude::*;
use crate::common::tuned::random_device;
use crate::common::{shipped_device, toml_files};
use haptic_bridge::board::telemetry::Field;
use haptic_predict::template::scene_file;
use haptic_sim::{HandLoop, ready_board};
use std::time::Duration;

/// Time until the hand has reached the wall, s.
const SETTLE_SECONDS: f64 = 1.0;
/// Duration of the measurement, s.
const MEASURE_SECONDS: f64 = 4.0;
/// Window of the mean that is subtracted from the force to get the ripple, s. A hand's own force changes more slowly.
const MEAN_SECONDS: f64 = 0.05;

/// Returns the share of time in contact and the ripple: the root mean square of the wall's force minus its mean over
/// [`MEAN_SECONDS`], N. Windows in which a touch begins or ends are left out.
fn share_and_ripple(file: &DeviceFile, scene: Scene<f32>) -> (f64, f64) {
    let weightless = file.description.gravity == [0.0; 3];
    let support = if weightless { Support::None } else { Support::Carried };
    let mut board = ready_board(file, BoardOptions { support, ..BoardOptions::default() }).unwrap();
    let around = HandLoop::find(file, Some(&scene.cast()), board.device().tip());
    assert!(around.on_a_wall, "{}: the hand does not touch the wall", file.name);
    let rate_hz = f64::from(scene.rate_hz);
    board.load(&file.name, &file.description, Some(scene)).unwrap();
    board.set_hand_loop(HandSettings { tremor: 2e-4, ..HandSettings::default() }, around);
    let mut board = Board::over(SharedBoard::new(board).wire(), "sim").unwrap();
    board.keep_alive();
    board.arm().unwrap();
    let run = |board: &mut Board, seconds: f64| {
        let end = board.now() + Duration::from_secs_f64(seconds);
        let mut rows = Vec::new();
        while board.now() < end {
            rows.extend(board.rows(Duration::from_millis(20)).unwrap());
        }
        rows
    };
    run(&mut board, SETTLE_SECONDS);
    let divider = (rate_hz / 5_000.0).ceil() as u32;
    board.start_stream(fields("force").unwrap(), divider).unwrap();
    let rows = run(&mut board, MEASURE_SECONDS);
    let forces: Vec<f64> = rows.iter().flat_map(|row| row.get(Field::WallForce).to_vec()).collect();
    let half = (0.5 * MEAN_SECONDS * rate_hz / f64::from(divider)) as usize;
    let windows = forces.windows(2 * half + 1).filter(|window| window.iter().all(|force| *force > 0.0));
    let off: Vec<f64> = windows.map(|w| w[half] - w.iter().sum::<f64>() / w.len() as f64).collect();
    assert!(board.status().unwrap().fault.is_none(), "{}", file.name);
    let share = off.len() as f64 / forces.len() as f64;
    (share, (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt())
}

#[test]
fn no_wall_of_a_new_scene_rattles() {
    let names = toml_files("").into_iter().map(|path| path.file_stem().unwrap().display().to_string());
    let devices = names.map(|name| shipped_device(&name)).chain((0..20).map(random_device));
    let mut rattle = Vec::new();
    for (number, file) in devices.enumerate() {
        let text = scene_file(&file).unwrap();
        let scene = SceneFile::parse(&text, "wall.toml", file.spec().task).unwrap().scene::<f32>().unwrap();
        let gains = (scene.walls[0].stiffness, scene.walls[0].damping);
        let (share, ripple) = share_and_ripple(&file, scene);
        println!("{number} {}: {gains:?}, in contact {share:.2}, {ripple:.3} N", file.name);
        let is_lowest = text.contains("the least that these encoders allow");
        if ripple > 0.1 && !is_lowest || share < 0.1 {
            rattle.push(format!("{number} {}", file.name));
        }
    }
    assert!(rattle.is_empty(), "{rattle:?}");
}
